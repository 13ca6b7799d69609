"""Reduction of the samples that are drawn to a largest rate; flagged samples are all kept."""

import numpy as np
from numpy.typing import NDArray

from rig.rerun.messages import Floats


class Decimator:
    """Chooses the samples to be drawn: the first of each interval ``1 / rate_hz``, and all with a flag.

    This concerns the display only: the record contains every sample.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last_interval = -(2**62)

    def choose(self, time_s: Floats, flags: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of the samples (n,), in order of time, are drawn; intervals continue from call to call."""
        # Rounding must not move a sample at the beginning of an interval into the one before.
        interval = np.floor(time_s * self._rate_hz + 1e-3).astype(np.int64)
        before = np.concatenate(([self._last_interval], interval[:-1]))
        if len(interval):
            self._last_interval = int(interval[-1])
        chosen: NDArray[np.bool_] = (interval != before) | (flags != 0)
        return chosen
