"""Fewer samples for the eye: at most so many a second, every flagged one kept."""

import numpy as np
from numpy.typing import NDArray

from rig.rerun.messages import Floats


class Decimator:
    """Chooses the samples that are drawn: the first of each interval, and all with a flag.

    The record holds every sample; what is left out here is not lost.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last_interval = -(2**62)

    def choose(self, time_s: Floats, flags: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of the samples, in order of time, are drawn."""
        # A sample that falls on an interval's edge must not fall before it by rounding.
        interval = np.floor(time_s * self._rate_hz + 1e-3).astype(np.int64)
        before = np.concatenate(([self._last_interval], interval[:-1]))
        if len(interval):
            self._last_interval = int(interval[-1])
        chosen: NDArray[np.bool_] = (interval != before) | (flags != 0)
        return chosen
