"""When the samples of a recorded witness were taken, by how they arrived and by its own clock."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.analysis.seismometer import sample_times

RATE_HZ, COUNT = 20.0, 12_000
EPOCH_S = 1_790_000_000.0


def arrived(
    late_s: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Arrivals in ns, own times in s, and when samples were taken, in s, on the clock of the arrivals."""
    own_s = EPOCH_S + np.arange(COUNT) / RATE_HZ
    true_s = 100.0 + (own_s - EPOCH_S)
    return np.rint(1e9 * (true_s + late_s)).astype(np.int64), own_s, true_s


def off(late_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """Errors of the times that are found, in s, and the steps that are said."""
    arrived_ns, own_s, true_s = arrived(late_s)
    found = sample_times(arrived_ns, own_s)
    return found.times_ns * 1e-9 - true_s, found.steps_s


@pytest.mark.parametrize("step_s", [-10.0, 0.7, 40.0])
@pytest.mark.parametrize("at", [600, 7000])
def test_where_a_clock_was_set_the_later_holds_and_it_is_said(step_s: float, at: int) -> None:
    """The instrument's clock was wrong until somebody or a satellite receiver set it."""
    rng = np.random.default_rng(1)
    late = 1e-3 * rng.standard_normal(COUNT)
    late[:at] -= step_s
    error, said = off(late)
    assert error == pytest.approx(0.0, abs=0.01)
    assert said == pytest.approx((step_s,), abs=0.01)


def test_lateness_that_comes_and_goes_and_a_clock_that_drifts_are_no_step() -> None:
    rng = np.random.default_rng(3)
    late = 0.05 * rng.exponential(size=COUNT) + 2e-4 * np.arange(COUNT) / RATE_HZ
    # a thread waited for four seconds, and then all came at once
    waited = np.arange(80)[::-1] / RATE_HZ
    late[5000:5080] += waited
    error, said = off(late)
    assert said == ()
    steady = 0.05 + 2e-4 * np.arange(COUNT) / RATE_HZ
    assert error == pytest.approx(steady, abs=0.02)


@pytest.mark.parametrize(("count", "speed"), [(1200, np.inf), (2500, np.inf), (6000, np.inf), (2500, 4.0)])
def test_a_stall_of_arrivals_is_no_clock_that_was_set(count: int, speed: float) -> None:
    """A host that hung for minutes reads at once, or some times as fast, what waited meanwhile."""
    late = 1e-3 * np.random.default_rng(4).standard_normal(COUNT)
    waited = np.maximum(count / RATE_HZ - np.arange(COUNT - 3000) / RATE_HZ * (1 - 1 / speed), 0.0)
    late[3000:] += waited
    error, said = off(late)
    assert said == ()
    assert error == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("late_by", "steps_s"),
    [
        ([(0, 3000, 2.0), (3000, 5000, -5.0)], (-7.0, 5.0)),
        ([(2000, 3500, np.arange(1500)[::-1] / RATE_HZ), (0, 6000, -3.0)], (3.0,)),
    ],
    ids=["two steps", "after a stall"],
)
def test_all_steps_are_taken_off(
    late_by: list[tuple[int, int, NDArray[np.float64]]], steps_s: tuple[float, ...]
) -> None:
    late = 1e-3 * np.random.default_rng(2).standard_normal(COUNT)
    for first, last, by_s in late_by:
        late[first:last] += by_s
    error, said = off(late)
    assert error == pytest.approx(0.0, abs=0.01)
    assert said == pytest.approx(steps_s, abs=0.01)
