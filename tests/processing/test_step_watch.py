"""A step is noticed once, where it happened; drift and noise are none."""

import numpy as np
import pytest

from processing.slope_uncertainty import Step, StepWatch


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
        assert abs(step.time_ns - 120) <= 3


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
