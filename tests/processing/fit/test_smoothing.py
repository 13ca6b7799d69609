"""The super-smoother gives T(alpha) without a model."""

import numpy as np
import pytest

from processing.contact.asymptotic import period
from processing.errors import DataError
from processing.fit.exact import fit_exact
from processing.fit.smoothing import super_smooth
from processing.periods import full_periods
from tests.processing.fit.decays import decay, paper_pair


def test_a_straight_line_is_kept() -> None:
    x = np.sort(np.random.default_rng(0).uniform(0, 1, 60))
    np.testing.assert_allclose(super_smooth(x, 3 - 2 * x, np.ones_like(x)), 3 - 2 * x, atol=1e-12)


def test_noise_falls_and_the_curve_stays() -> None:
    """Friedman's own example: a sine that slows down, noise that grows."""
    rng = np.random.default_rng(4)
    x = np.sort(rng.uniform(0, 1, 400))
    curve = np.sin(2 * np.pi * (1 - x) ** 2)
    noise = 0.3 * x
    smooth = super_smooth(x, curve + noise * rng.standard_normal(400), np.maximum(noise, 0.02))
    assert np.sqrt(np.mean((smooth - curve) ** 2)) < 0.3 * np.sqrt(np.mean(noise**2))


def test_order_does_not_matter_and_equal_x_are_allowed() -> None:
    rng = np.random.default_rng(1)
    x = np.round(rng.uniform(0, 1, 100), 2)
    y = x**2 + 0.1 * rng.standard_normal(100)
    x = np.unique(x)
    y, u = y[: len(x)], np.ones_like(x)
    order = rng.permutation(len(x))
    np.testing.assert_allclose(super_smooth(x[order], y[order], u), super_smooth(x, y, u)[order])
    assert np.all(np.isfinite(super_smooth(np.repeat(x, 2), np.repeat(y, 2), np.repeat(u, 2))))


def test_both_ends_are_treated_alike() -> None:
    """A decay read backwards is the same curve, read backwards."""
    rng = np.random.default_rng(6)
    for count in (8, 31, 200):
        x = np.sort(rng.uniform(0, 1, count))
        y, u = rng.standard_normal(count), rng.uniform(0.5, 2, count)
        backwards = super_smooth(-x[::-1], y[::-1].copy(), u[::-1])[::-1]
        np.testing.assert_allclose(super_smooth(x, y, u), backwards, rtol=1e-9)


def test_the_smallest_span_follows_a_bend_that_a_line_cannot() -> None:
    """Without noise the nearest neighbours win: seven of a hundred points, at the ends as in the middle."""
    x = np.linspace(0, 1, 100)
    bend = np.sin(10 * x)
    # the lines through 7 points, twice, leave out terms of the second order
    assert np.max(np.abs(super_smooth(x, bend, np.ones_like(x)) - bend)) < 0.05
    # one point hardly moves what lies beyond two smallest spans of it, though the choice of span may
    moved = bend.copy()
    moved[50] += 0.1
    change = np.abs(super_smooth(x, moved, np.ones_like(x)) - super_smooth(x, bend, np.ones_like(x)))
    assert 0.005 < change[50] < 0.05
    assert np.max(change[:40]) < 1e-3
    assert np.max(change[61:]) < 1e-3


def test_weights_hold_a_bad_stretch_down() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0, 1, 200)
    u = np.where((x > 0.4) & (x < 0.6) & (np.arange(200) % 2 == 0), 5.0, 0.05)
    y = x + u * rng.standard_normal(200)
    weighted = np.sqrt(np.mean((super_smooth(x, y, u) - x) ** 2))
    assert weighted < 0.2 * np.sqrt(np.mean((super_smooth(x, y, np.ones_like(x)) - x) ** 2))


def test_the_smooth_confirms_the_model_of_the_period() -> None:
    """Fig. 14: no physics in one curve, Eq. 3 in the other."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=5)
    periods = full_periods(points)
    alpha = points.amplitude[periods.where]
    smooth = super_smooth(alpha, periods.period_s, periods.u_period_s)
    fitted = fit_exact(points, pendulum)
    model = period(alpha, fitted.parameters, pendulum)
    # Eq. 6 leaves out terms of second order in the drop of 2 %; noise is smoothed below that
    assert np.max(np.abs(smooth / model - 1)) < 1e-3


@pytest.mark.parametrize(
    ("x", "y", "u", "word"),
    [
        (np.arange(5.0), np.arange(5.0), np.ones(9), "at least 8"),
        (np.arange(9.0), np.arange(8.0), np.ones(9), "equally long"),
        (np.arange(9.0), np.full(9, np.nan), np.ones(9), "finite"),
        (np.arange(9.0), np.arange(9.0), np.zeros(9), "positive uncertainty"),
    ],
)
def test_bad_input(x: np.ndarray, y: np.ndarray, u: np.ndarray, word: str) -> None:
    with pytest.raises(DataError, match=word):
        super_smooth(x, y, u)
