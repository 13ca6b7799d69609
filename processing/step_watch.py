"""Notices a lasting step of a value that otherwise changes slowly."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from processing.robust import robust_scatter

_HALF = 6
_SIGNIFICANCE = 8.0
"""In white noise one of 1,100 values exceeds it by chance, since six values tell their scatter badly (5: one
of 150; simulated). The least step that is reported is meant to lie above the noise."""


@dataclass(frozen=True, slots=True)
class Step:
    """A change by `size` (unit of the values) that began at `time_ns`."""

    time_ns: int
    size: float


class StepWatch:
    """Compares the median of the last six values with that of the six before.

    Parameters
    ----------
    least
        Smaller steps are not reported (unit of the values).
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._values: deque[tuple[int, float]] = deque(maxlen=2 * _HALF)

    def take(self, time_ns: int, value: float) -> Step | None:
        """Take the next value; NaN is left out. Returns a step once, six values after it happened."""
        if not math.isfinite(value):
            return None
        self._values.append((time_ns, value))
        if len(self._values) < 2 * _HALF:
            return None
        values = np.array([found for _, found in self._values])
        before, after = values[:_HALF], values[_HALF:]
        size = float(np.median(after) - np.median(before))
        scatter = math.hypot(robust_scatter(before), robust_scatter(after))
        # a step within one half makes that half scatter; so one is seen only when it lies between them
        if abs(size) < max(self._least, _SIGNIFICANCE * scatter / math.sqrt(_HALF)):
            return None
        time_ns = self._values[_HALF][0]
        for _ in range(_HALF):
            self._values.popleft()
        return Step(time_ns, size)
