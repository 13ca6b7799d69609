"""A step is noticed once, where it happened; drift and noise are none."""

import math

import numpy as np
import pytest

from processing.slope_uncertainty import KickWatch, Step, StepWatch


def steps_in(values: np.ndarray, min_size: float = 3.0) -> list[Step]:
    watch = StepWatch(min_size)
    return [step for k, value in enumerate(values) if (step := watch.take(k, float(value))) is not None]


@pytest.mark.parametrize("size", [10.0, -10.0, 4.0])
@pytest.mark.parametrize("noise", [1e-3, 0.2])
def test_a_step_is_noticed_once_with_its_size_and_place(size: float, noise: float) -> None:
    for seed in range(4):
        values = np.random.default_rng(seed).normal(0.0, noise, 200)
        values[120:] += size
        (step,) = steps_in(values)
        assert step.size == pytest.approx(size, abs=6 * noise)
        # noticed at the earliest when four of the six later values have it
        assert 118 <= step.time_ns <= 120


def test_noise_drift_and_lost_values_are_no_steps() -> None:
    rng = np.random.default_rng(1)
    for noise in (0.1, 1.0, 10.0):
        values = rng.normal(0.0, noise, 1200) + 0.003 * np.arange(1200)
        values[rng.random(1200) < 0.2] = np.nan
        assert steps_in(values, min_size=3.0 * noise) == []


def test_one_odd_value_is_no_step() -> None:
    values = np.random.default_rng(2).normal(0.0, 0.1, 300)
    values[::37] += 50.0
    assert steps_in(values) == []


def kicks_in(growth: float, delay_s: float, missing: range) -> list[Step]:
    """At the 30th turning point of an amplitude of 100, half a period of 2 s."""
    rng, watch = np.random.default_rng(1), KickWatch(1.0)
    index = np.delete(np.arange(60), missing)
    later = index >= 30
    amplitude = 100 + growth * later + rng.normal(0, 0.05, len(index))
    time_s = 2.0 * index + delay_s * later + rng.normal(0, 5e-4, len(index))
    rows = zip(index.tolist(), time_s, amplitude, strict=True)
    return [kick for i, s, a in rows if (kick := watch.take(i, round(1e9 * s), float(a))) is not None]


@pytest.mark.parametrize(("growth", "delay_s"), [(3.0, 0.0), (0.0, 0.02), (-3.0, 0.02)])
def test_a_kick_is_the_amplitude_that_it_would_have_given_at_rest(growth: float, delay_s: float) -> None:
    """A delay is a phase, of pi in half a period."""
    (kick,) = kicks_in(growth, delay_s, range(33, 37))
    assert kick.size == pytest.approx(math.hypot(growth, 100 * math.pi * delay_s / 2.0), abs=0.5)
    assert kick.time_ns == pytest.approx(60e9 + 1e9 * delay_s, abs=1e9)
    # beyond four missing ones no line reaches back
    assert kicks_in(growth, delay_s, range(33, 38)) == []
