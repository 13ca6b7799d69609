"""Eqs. 5 and 6 agree with direct quadrature, their limits, and each other."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad

from processing.contact import turning_points_of
from processing.contact.asymptotic import PRINTED_CURVATURE, cosine_moment, curvature, decay_path, period
from processing.contact.law import ContactParameters
from processing.errors import DataError
from tests.processing.contact.eq5_closed_form import decay_amplitude, decay_time
from tests.processing.fit.decays import ARCSEC, PAIRS, paper_pair


def by_quadrature(low: float, high: float, b: float, p: float, c: float, period_s: float) -> float:
    """Eq. 5 by Gauss-Legendre in the logarithm of the amplitude, 40 panels of 60 nodes."""
    x, w = np.polynomial.legendre.leggauss(60)
    edges = np.linspace(np.log(low), np.log(high), 41)
    half = np.diff(edges)[:, None] / 2
    u = (edges[:-1, None] + edges[1:, None]) / 2 + half * x
    return float(period_s / 4 * np.sum(half * w * np.exp(u) / (c + b / (p + 1) * np.exp(p * u))))


EXPONENTS = (
    0.0,
    1e-12,
    1e-6,
    1e-3,
    0.1,
    0.25,
    1 / 3,
    0.5,
    0.815,
    0.944,
    1 - 1e-12,
    1.0,
    1 + 1e-9,
    1.5,
    2.0,
    3.0,
)


@pytest.mark.slow
@pytest.mark.parametrize("p", EXPONENTS)
def test_closed_form_is_the_integral_over_the_whole_range(p: float) -> None:
    for c in (0.0, 1e-30, 1e-12, 1e-9, 1e-8, 1e-6, 1e-3):
        for b in (0.0, 1e-9, 1e-4, 37e-4, 1.0):
            if b + c == 0:
                continue
            for low, high in ((1e-5, 6e-4), (1e-8, 6e-4), (5.9e-4, 6e-4)):
                time = decay_time(low, high, b=b, p=p, c=c, period_s=4.0)
                np.testing.assert_allclose(time, by_quadrature(low, high, b, p, c, 4.0), rtol=1e-11)


@settings(max_examples=200, deadline=None)
@given(
    p=st.floats(0, 3),
    log_c=st.floats(-12, -4),
    log_b=st.floats(-7, 0),
    share=st.floats(1e-4, 0.999),
)
def test_closed_form_is_the_integral_anywhere(p: float, log_c: float, log_b: float, share: float) -> None:
    b, c = 10**log_b, 10**log_c
    time = decay_time(6e-4 * share, 6e-4, b=b, p=p, c=c, period_s=4.0)
    np.testing.assert_allclose(time, by_quadrature(6e-4 * share, 6e-4, b, p, c, 4.0), rtol=1e-10)


def test_closed_form_agrees_with_scipy_quad() -> None:
    parameters, _ = paper_pair("glass_k8")
    b, p, c = parameters.b, parameters.p, parameters.c
    for low in (2 * ARCSEC, 30 * ARCSEC):
        expected, error = quad(
            lambda phi: 1 / (c + b * phi**p / (p + 1)), low, 124 * ARCSEC, epsabs=0, epsrel=1e-13, limit=200
        )
        time = decay_time(low, 124 * ARCSEC, b=b, p=p, c=c, period_s=4.0)
        assert abs(float(time) - expected) <= max(1e-12 * expected, 2 * error)


def test_limits_are_numbers() -> None:
    def end(b: float, p: float, c: float) -> float:
        return float(decay_time(0.0, 1.0, b=b, p=p, c=c, period_s=4.0))

    assert end(0.0, 0.5, 2.0) == pytest.approx(0.5, rel=1e-15)  # constant friction alone
    assert end(3.0, 0.0, 2.0) == pytest.approx(0.2, rel=1e-15)  # p = 0: two constants
    assert end(1.5, 0.5, 0.0) == pytest.approx(2.0, rel=1e-14)  # dies in finite time
    assert end(2.0, 1.0, 0.0) == np.inf  # exponential decay never ends
    assert end(2.0, 1.0, 1.0) == pytest.approx(np.log(2.0), rel=1e-14)


def test_amplitude_inverts_time() -> None:
    parameters, _ = paper_pair("silicon")
    kind = {"b": parameters.b, "p": parameters.p, "c": parameters.c, "period_s": 4.07}
    amplitude = np.geomspace(1e-6, 6e-4, 300)
    time = decay_time(amplitude, 6e-4, **kind)
    np.testing.assert_allclose(decay_amplitude(time, 6e-4, **kind), amplitude, rtol=1e-12)
    earlier = decay_time(9e-4, 6e-4, **kind)
    assert earlier < 0
    np.testing.assert_allclose(decay_amplitude(earlier, 6e-4, **kind), 9e-4, rtol=1e-12)
    end = float(decay_time(0.0, 6e-4, **kind))
    assert decay_amplitude(end, 6e-4, **kind) == 0
    assert np.isnan(decay_amplitude(1.001 * end, 6e-4, **kind))


def test_path_with_drag_follows_the_rate_and_without_it_the_closed_form() -> None:
    b, p, c, start = 4e-3, 0.9, 1e-3, 3.0
    s = np.concatenate([np.linspace(0, 200, 60), [400.0]])
    path, gradient = decay_path(s, start, b / (p + 1), p, c, 0.0)
    time = decay_time(path, start, b=b, p=p, c=c, period_s=4.0)
    np.testing.assert_allclose(time[1:], s[1:], rtol=1e-11)
    values = np.array([start, b, p, c, 2e-3])
    _, gradient = decay_path(s, *values)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6 * values[i]
        up = decay_path(s, *(values + step))[0]
        down = decay_path(s, *(values - step))[0]
        np.testing.assert_allclose(
            gradient[:, i], (up - down) / (2 * step[i]), rtol=1e-6, atol=1e-7 * np.abs(gradient[:, i]).max()
        )


def test_constant_friction_ends_the_path_at_rest() -> None:
    """In finite time, and there the computation ends, too; in a thread, which can be given up."""
    start, c = 3.0, 1e-3
    s = np.array([0.0, 0.5, 0.9, 1.001, 2.0]) * start / c
    found: list[NDArray[np.float64]] = []

    def follow() -> None:
        found.append(decay_path(s, start, 0.0, 1.0, c, 0.0)[0])

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    thread.join(20.0)
    assert found, "the amplitude falls for ever"
    np.testing.assert_allclose(found[0], [3.0, 1.5, 0.3, np.nan, np.nan], rtol=1e-12)


@pytest.mark.parametrize(("b", "c"), [(-1e-3, 1e-8), (1e-3, -1e-8), (0.0, 0.0)])
def test_friction_that_gives_energy_is_refused(b: float, c: float) -> None:
    with pytest.raises(DataError, match=r"Eq\. 5"):
        decay_time(1e-5, 6e-4, b=b, p=0.9, c=c, period_s=4.0)
    with pytest.raises(DataError, match=r"Eq\. 5"):
        decay_amplitude(1.0, 6e-4, b=b, p=0.9, c=c, period_s=4.0)


def averaged_frequency_drop(
    alpha: NDArray[np.float64], n: float, kappa: float, rho: float
) -> NDArray[np.float64]:
    """First average of Eq. 3 over a swing, by quadrature: what Eq. 6 has in closed form."""
    theta, w = np.polynomial.legendre.leggauss(400)
    theta, w = np.pi / 4 * (theta + 1), np.pi / 4 * w
    out = []
    for a in alpha:
        phi = a * np.cos(theta)
        moment = kappa * phi ** (n + 1) * (np.pi / 2 - rho * phi)
        # 4 quarters, of which 1/(2 pi a) times moment cos is the relative fall of w0^2, halved
        out.append(0.5 * (4 / (np.pi * a)) * np.sum(w * moment * np.cos(theta)))
    return np.array(out)


@pytest.mark.parametrize("n", [0.0, 1e-9, 0.092, 0.552, 1.0])
def test_eq6_is_the_average_of_eq3(n: float) -> None:
    _, pendulum = paper_pair("glass_k8")
    parameters = ContactParameters(1e-3, 0.9, 1e-8, n, 4.0, 3e6)
    alpha = np.geomspace(2, 124, 9) * ARCSEC
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2
    kappa = 2 * parameters.gamma_pa * pendulum.contact_radius_m**2 / weight
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    expected = 4.0 / (1 - averaged_frequency_drop(alpha, n, kappa, rho))
    np.testing.assert_allclose(period(alpha, parameters, pendulum), expected, rtol=1e-10)


def test_curvature_is_computed_and_the_printed_one_an_option() -> None:
    assert curvature(0.0) == pytest.approx(2 / np.pi * (2 / 3) / (np.pi / 4), rel=1e-14)
    assert curvature(0.0) == pytest.approx(0.5404, abs=5e-5)
    assert PRINTED_CURVATURE == 0.55
    assert cosine_moment(0.0) == pytest.approx(np.pi / 2, rel=1e-15)
    parameters, pendulum = paper_pair("glass_k8")
    computed = period(124 * ARCSEC, parameters, pendulum)
    printed = period(124 * ARCSEC, parameters, pendulum, printed_curvature=True)
    assert computed != printed
    assert abs(float(computed / printed) - 1) < 1e-4


@pytest.mark.parametrize("flat", PAIRS)
def test_eq6_approaches_the_exact_period_at_small_amplitude(flat: str) -> None:
    """The terms that Eq. 6 leaves out are of second order in friction and elasticity."""
    parameters, pendulum = paper_pair(flat)
    for alpha in (5 * ARCSEC, 50 * ARCSEC):
        amplitude, time = turning_points_of(parameters, pendulum, alpha, 2)
        expected = float(period(amplitude[1], parameters, pendulum))
        drop = 1 - parameters.period0_s / expected
        loss = 1 - amplitude[2] / amplitude[0]
        assert abs(time[2] / expected - 1) < 2 * drop**2 + loss**2
