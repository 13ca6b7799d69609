"""X(t) in two parts, what the slow mode leaks across and what is left: the fast mode."""

from bisect import bisect_right, insort
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from rig.view.values import Floats

_WAITS_S = 20.0
"""Samples from before the first balance of a run are kept for so long."""
_FORGETS_S = 60.0
"""A balance of so long ago says nothing of a sample."""


class Across(NamedTuple):
    """Times, the fast mode and the leakage of the slow mode in X, arrays (n,) in the unit of the samples."""

    time_s: Floats
    fast: Floats
    leakage: Floats


class _Line(NamedTuple):
    """The line on which the slow mode moves: a balance's numbers, at rest at (x, y) as shown."""

    time_s: float
    angle_rad: float
    turning_rad_per_s: float
    rest_x: float
    rest_y: float


class AcrossTheSwing:
    """Separates X of one run by the line that its balances give.

    Samples that come before the first balance are kept, some seconds of them, and are separated with it.
    """

    def __init__(self) -> None:
        self._lines: list[_Line] = []
        self._waiting: list[tuple[Floats, Floats, Floats]] = []

    def balance(self, time_s: float, numbers: Mapping[str, tuple[float, float]], shown_size: float) -> None:
        """Add a balance; its lengths are in units of which `shown_size` are one of the samples' unit."""

        def number(name: str) -> float:
            return numbers.get(name, (np.nan, np.nan))[0]

        line = _Line(
            time_s,
            number("line_angle_rad"),
            float(np.nan_to_num(number("rotation_rad_per_s"))),
            number("rest_x") / shown_size,
            number("rest_y") / shown_size,
        )
        if np.isfinite([line.angle_rad, line.rest_x, line.rest_y]).all():
            insort(self._lines, line)

    def samples(self, time_s: Floats, x: Floats, y: Floats) -> Across | None:
        """Separate samples, and those that have waited; None while no balance is known."""
        if len(time_s):
            self._waiting.append((time_s, x, y))
        if not self._lines or not self._waiting:
            while self._waiting and len(time_s) and time_s[-1] - self._waiting[0][0][-1] > _WAITS_S:
                self._waiting.pop(0)
            return None
        waiting, self._waiting = self._waiting, []
        time_s, x, y = (np.concatenate(columns) for columns in zip(*waiting, strict=True))
        line = self._line_at(float(time_s[len(time_s) // 2]))
        angle = line.angle_rad + line.turning_rad_per_s * (time_s - line.time_s)
        sine, cosine = np.sin(angle), np.cos(angle)
        along = (x - line.rest_x) * sine + (y - line.rest_y) * cosine
        fast = (x - line.rest_x) * cosine - (y - line.rest_y) * sine
        known = np.abs(time_s - line.time_s) < _FORGETS_S
        return Across(time_s, np.where(known, fast, np.nan), np.where(known, along * sine, np.nan))

    def _line_at(self, time_s: float) -> _Line:
        """The line nearest in time to a sample."""
        after = bisect_right(self._lines, time_s, key=lambda line: line.time_s)
        near = self._lines[max(after - 1, 0) : after + 1]
        return min(near, key=lambda line: abs(line.time_s - time_s))
