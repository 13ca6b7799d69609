"""The drive of a pendulum at rest, against an integration of the driven oscillator made here."""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.errors import DataError
from processing.pendulum_at_rest import drive_at_rest
from processing.units import ARCSEC_RAD

PERIOD_S, FRAMES_PER_S, STEPS = 4.08, 25.0, 4
Q = 2e-8


def at_rest(q: float, seconds: float, seeds: int, noise_rad: float) -> tuple[NDArray[np.float64], ...]:
    """Times and (seeds, times) deflections of pendulums that have been driven long enough to be steady."""
    rng = np.random.default_rng(8)
    dt = 1 / (FRAMES_PER_S * STEPS)
    omega, damping = 2 * np.pi / PERIOD_S, 0.005 * 2 * np.pi / PERIOD_S
    kick = q / np.sqrt(2) * np.sqrt(dt)
    # steady state of x'' + 2 damping x' + omega^2 x = a
    speed_rms = q / np.sqrt(2) / np.sqrt(4 * damping)
    speed = speed_rms * rng.standard_normal(seeds)
    angle = speed_rms / omega * rng.standard_normal(seeds)
    frames = round(seconds * FRAMES_PER_S)
    seen = np.empty((seeds, frames))
    for k in range(frames):
        for _ in range(STEPS):
            speed += dt * (-(omega**2) * angle - 2 * damping * speed) + kick * rng.standard_normal(seeds)
            angle += dt * speed
        seen[:, k] = angle
    seen += noise_rad * rng.standard_normal(seen.shape) + 3e-5
    return np.arange(frames) / FRAMES_PER_S, seen


def test_the_drive_comes_out_within_what_is_stated() -> None:
    times_s, seen = at_rest(Q, 60.0, 40, 0.005 * ARCSEC_RAD)
    found = [drive_at_rest(times_s, one) for one in seen]
    value = np.array([one.density.value for one in found])
    u = np.array([one.density.standard_uncertainty for one in found])
    seen_to_move = value > 0
    assert np.mean(seen_to_move) >= 0.9
    assert np.median(value) == pytest.approx(Q, rel=0.1)
    # 14 periods give 28 steps, 1/sqrt(56) of the drive, and the reading takes its part
    assert np.std(value[seen_to_move]) < 0.3 * Q
    assert 0.6 < np.sqrt(np.mean(((value - Q) / u)[seen_to_move] ** 2)) < 1.6
    assert np.mean([one.upper_95 > Q for one in found]) >= 0.85
    assert np.median([one.period_s for one in found]) == pytest.approx(PERIOD_S, rel=0.02)


def test_a_drive_below_the_reading_is_a_bound() -> None:
    times_s, seen = at_rest(1e-11, 60.0, 10, 0.02 * ARCSEC_RAD)
    found = [drive_at_rest(times_s, one) for one in seen]
    assert sum(one.density.value == 0 for one in found) >= 9
    assert all(1e-11 < one.upper_95 < 1e-7 for one in found)


def test_too_short_a_look_says_so() -> None:
    with pytest.raises(DataError, match="s of the pendulum at rest are too short"):
        drive_at_rest(np.linspace(0.0, 4.0, 100), np.zeros(100))
