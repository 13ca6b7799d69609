"""Two modes in the plane: values, correct uncertainties, and samples without an oscillation."""

import math

import numpy as np
import pytest
import scipy

from processing.balance.estimate import _without_harmonic
from processing.swing import mode_fit
from processing.swing.mode_fit import (
    ALL_TERMS,
    FAST_COSINE,
    FAST_SINE,
    FIRST_X_TERM,
    FIRST_Y_TERM,
    SLOW_TERMS,
    TERMS,
    ModeFit,
    _step,
    fast_mode_is_significant,
)
from processing.swing.modes import TwoModes, separate_modes

RATE, FAST_RATE, TURNING = 1.55, 7.5, 1e-4
ANGLE, WIDTH, AMPLITUDE, FAST, FAST_ANGLE = 0.03, 0.01, 200.0, 5.0, 1.5
SECONDS, NOISE = 8.0, 0.02

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


def motion(rng: np.random.Generator, frames_per_s: float = 100.0, fast: float = FAST) -> Arrays:
    """Slow ellipse about a turning line, fast line across, rest position that drifts; reference at t = 0."""
    t = np.arange(round(SECONDS * frames_per_s)) / frames_per_s - SECONDS / 2.0
    phase = 0.7
    long = AMPLITUDE * np.exp(-0.003 * t) * np.cos(RATE * t + phase)
    short = WIDTH * AMPLITUDE * np.exp(-0.003 * t) * np.sin(RATE * t + phase)
    angle = ANGLE + TURNING * t
    swift = fast * np.exp(-0.02 * t) * np.cos(FAST_RATE * t + 2.0)
    x = long * np.sin(angle) + short * np.cos(angle) + swift * math.sin(FAST_ANGLE) + 3.0 + 0.01 * t
    y = long * np.cos(angle) - short * np.sin(angle) + swift * math.cos(FAST_ANGLE) - 2.0 + 0.02 * t
    n = len(t)
    times_ns = np.round((t - t[0]) * 1e9).astype(np.int64)
    return times_ns, x + NOISE * rng.standard_normal(n), y + NOISE * rng.standard_normal(n)


def separated(times_ns: np.ndarray, x: np.ndarray, y: np.ndarray, noise: float = NOISE) -> TwoModes | None:
    u = np.full(len(x), noise)
    return separate_modes(times_ns, x, y, u, u)


def deviations(modes: TwoModes) -> list[float]:
    """(estimate - truth) / u of everything, the truth taken at the reference time."""
    t = modes.time_ns * 1e-9 - SECONDS / 2.0
    slow, fast = modes.slow, modes.fast
    here = AMPLITUDE * math.exp(-0.003 * t)
    swift = FAST * math.exp(-0.02 * t)
    return [
        (slow.period_s - 2 * math.pi / RATE) / slow.u_period_s,
        (slow.amplitude - here) / slow.u_amplitude,
        (slow.width - WIDTH * here) / slow.u_width,
        (slow.direction_rad - ANGLE - TURNING * t) / slow.u_direction_rad,
        (modes.rest_x - 3.0 - 0.01 * t) / modes.u_rest_x,
        (fast.period_s - 2 * math.pi / FAST_RATE) / fast.u_period_s,
        (fast.amplitude - swift) / fast.u_amplitude,
        (fast.direction_rad - FAST_ANGLE) / fast.u_direction_rad,
        (fast.x_amplitude - swift * math.sin(FAST_ANGLE)) / fast.u_x_amplitude,
    ]


def test_values_and_uncertainties() -> None:
    runs = 40
    # twelve frames a second are ten in a period of the fast mode
    rows = [
        deviations(separated(*motion(np.random.default_rng([seed, 41]), 12.0 if seed % 4 == 0 else 100.0)))
        for seed in range(runs)
    ]
    table = np.array(rows)
    # rms of 40 normal deviates: 1 +- 0.11
    assert np.sqrt((table**2).mean(axis=0)) == pytest.approx(np.ones(table.shape[1]), abs=4.5 * 0.11)
    assert np.abs(table.mean(axis=0)).max() < 4.5 / math.sqrt(runs)


def test_sense_of_the_ellipse() -> None:
    """Positive width: from +Y towards +X."""
    t = np.arange(800) * 0.01
    times_ns = np.round(t * 1e9).astype(np.int64)
    noise = 0.001 * np.random.default_rng(1).standard_normal((2, 800))
    for way in (1.0, -1.0):
        x, y = way * np.sin(1.5 * t) + noise[0], 10 * np.cos(1.5 * t) + noise[1]
        modes = separated(times_ns, x, y, 0.001)
        assert modes.slow.width == pytest.approx(way, abs=0.01)
        assert modes.slow.amplitude == pytest.approx(10.0, abs=0.01)


def test_no_fast_mode_is_no_fast_mode() -> None:
    times_ns, x, y = motion(np.random.default_rng(2), fast=0.0)
    modes = separated(times_ns, x, y)
    assert modes.fast is None
    assert 0.0 < modes.fast_limit < 5 * NOISE * math.sqrt(2 / len(x))


def test_a_fast_mode_that_stops_is_in_the_uncertainties() -> None:
    """Too short to be seen it moved line and rest position by up to 7 u, most of all where noise hid it."""
    period_s, fast_period_s, noise = 4.17, 0.826, 0.0027
    t = np.arange(0.0, 2 * period_s, 0.01)
    u = np.full(len(t), noise)
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        left = 0.0145 * np.maximum(rng.uniform(0.2, 2.2) - t, 0.0)
        fast = left * np.cos(2 * np.pi * t / fast_period_s + rng.uniform(0, 6.28))
        slow = 107.0 * np.exp(-t / 300) * np.cos(2 * np.pi * t / period_s + rng.uniform(0, 6.28))
        x, y = 0.002 * slow + fast + rng.normal(0, noise, len(t)), slow + rng.normal(0, noise, len(t))
        found = separate_modes(np.round(t * 1e9).astype(np.int64), x, y, u, u, period_s, fast_period_s)
        if found.fast is None:
            off = found.slow.direction_rad - np.arctan(0.002)
            pulls.append((off / found.slow.u_direction_rad, found.rest_x / found.u_rest_x))
    assert len(pulls) > 12
    assert np.all(np.sqrt(np.mean(np.square(pulls), axis=0)) < 1.4)
    assert np.max(np.abs(pulls)) < 4


def test_a_line_beside_a_harmonic_of_the_waveform_is_no_fast_mode() -> None:
    """T_V/T_U of 2.956 +- 0.012 was reported from what the noise had made of the third harmonic."""
    rng = np.random.default_rng(6)
    t = np.arange(2400) * 0.01
    times_ns = np.round(1e9 * t).astype(np.int64)
    y = 20.0 * np.cos(RATE * t) + 0.005 * np.cos(2.956 * RATE * t) + NOISE * rng.standard_normal(2400)
    modes = separated(times_ns, NOISE * rng.standard_normal(2400), y)
    assert modes.fast is not None
    assert _without_harmonic(modes).fast is None


def test_lost_spots_and_uneven_steps() -> None:
    rng = np.random.default_rng(3)
    times_ns, x, y = motion(rng, 200.0)
    kept = rng.random(len(x)) > 0.3
    x[rng.random(len(x)) < 0.1] = np.nan
    modes = separated(times_ns[kept], x[kept], y[kept])
    assert np.abs(deviations(modes)).max() < 4.5


@pytest.mark.parametrize("kind", ["noise", "still", "short", "few"])
def test_no_oscillation(kind: str) -> None:
    rng = np.random.default_rng(4)
    n = 10 if kind == "few" else 400
    times_ns = np.arange(n, dtype=np.int64) * 10_000_000
    t = times_ns * 1e-9
    x, y = 0.02 * rng.standard_normal((2, n))
    if kind == "still":
        x, y = np.zeros(n), np.ones(n)
    elif kind == "short":
        y = 100.0 * np.sin(0.7 * t)
    assert separated(times_ns, x, y) is None


@pytest.mark.parametrize("frequencies", [1, 300])
def test_noise_is_taken_for_a_fast_mode_once_in_ten_million_looks(frequencies: int) -> None:
    """Four amplitudes of noise of unit variance: the sum of their squares has a known distribution."""
    limit = scipy.stats.chi2.isf(1e-7 / frequencies, 4)
    for factor, seen in ((0.999, False), (1.001, True)):
        p = np.zeros(TERMS)
        p[[FIRST_X_TERM + FAST_COSINE, FIRST_Y_TERM + FAST_SINE]] = np.sqrt(0.5 * factor * limit)
        fit = ModeFit(p, np.eye(TERMS), ALL_TERMS, 0.0, np.zeros(50), np.zeros(50))
        assert fast_mode_is_significant(fit, frequencies) is seen


@pytest.mark.parametrize("active", [ALL_TERMS, SLOW_TERMS])
def test_a_step_solves_the_normal_equations_of_terms_with_information(active: list[int]) -> None:
    rng = np.random.default_rng(9)
    design = rng.standard_normal((60, TERMS)) * np.geomspace(1e-6, 1e6, TERMS)
    design[:, mode_fit.FAST_RATE] = 0.0  # as long as the fast mode has no amplitude
    information, score = design.T @ design, rng.standard_normal(TERMS)
    change, covariance = _step(information, score, np.array(active))
    known = [place for place in active if place != mode_fit.FAST_RATE]
    part = np.ix_(known, known)
    size = np.sqrt(np.diag(information)[known])
    scaled = size[:, None] * covariance[part] @ information[part] / size
    np.testing.assert_allclose(scaled, np.eye(len(known)), atol=1e-12)
    np.testing.assert_allclose(change[known], covariance[part] @ score[known], rtol=1e-9)
    others = [place for place in range(TERMS) if place not in known]
    assert not change[others].any()
    assert not covariance[others].any()
    assert not covariance[:, others].any()


def test_a_step_leaves_out_a_combination_that_samples_do_not_determine() -> None:
    rng = np.random.default_rng(10)
    design = rng.standard_normal((60, TERMS))
    design[:, FIRST_Y_TERM] = design[:, FIRST_X_TERM]
    information, score = design.T @ design, design.T @ rng.standard_normal(60)
    change, _ = _step(information, score, np.array(ALL_TERMS))
    np.testing.assert_allclose(information @ change, score, rtol=1e-9, atol=1e-9)
    assert change[FIRST_X_TERM] == pytest.approx(change[FIRST_Y_TERM])
