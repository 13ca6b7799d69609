"""When the samples of a recorded witness were taken, by how they arrived and by its own clock."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.analysis.seismometer import taken

RATE_HZ, COUNT = 20.0, 12_000
EPOCH_S = 1_790_000_000.0


def off(late_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Errors of the times that are found of samples that arrive so late, in s."""
    own_s = EPOCH_S + np.arange(COUNT) / RATE_HZ
    true_s = 100.0 + (own_s - EPOCH_S)
    return np.asarray(taken(np.rint(1e9 * (true_s + late_s)).astype(np.int64), own_s) * 1e-9 - true_s)


def test_lateness_that_comes_and_goes_moves_no_time() -> None:
    rng = np.random.default_rng(3)
    steady = 0.05 + 2e-4 * np.arange(COUNT) / RATE_HZ
    late = 0.05 * rng.exponential(size=COUNT) + steady - 0.05
    # a thread waited for four seconds, and then all came at once
    late[5000:5080] += np.arange(80)[::-1] / RATE_HZ
    assert off(late) == pytest.approx(steady, abs=0.02)


@pytest.mark.parametrize(("count", "speed"), [(1200, np.inf), (2500, np.inf), (6000, np.inf), (2500, 4.0)])
def test_a_stall_of_arrivals_moves_no_time(count: int, speed: float) -> None:
    """A host that hung for minutes reads at once, or some times as fast, what waited meanwhile."""
    late = 1e-3 * np.random.default_rng(4).standard_normal(COUNT)
    waited = np.maximum(count / RATE_HZ - np.arange(COUNT - 3000) / RATE_HZ * (1 - 1 / speed), 0.0)
    late[3000:] += waited
    assert off(late) == pytest.approx(0.0, abs=0.01)
