"""Buffer of the samples that are still needed, check of new samples, search for rough turning points."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.kernel import kernel
from processing.swing.arc import HalfCycleSamples
from processing.units import seconds

_NO_FAULT, _BACKWARDS, _UNCERTAINTY = 0, 1, 2
_INITIAL_SIZE = 4096


@kernel
def _fault(times_ns: Ints, deflection: Floats, u_deflection: Floats, last: int) -> tuple[int, int]:
    """Kind of the first fault and index of its sample."""
    for i in range(len(times_ns)):
        if times_ns[i] < last:
            return _BACKWARDS, i
        last = times_ns[i]
        if deflection[i] == deflection[i] and not (u_deflection[i] > 0.0 and u_deflection[i] < math.inf):
            return _UNCERTAINTY, i
    return _NO_FAULT, 0


class SampleBuffer:
    """Samples in order of time, without the old ones. Positions are indices into its arrays."""

    def __init__(self) -> None:
        self.times_ns = np.empty(_INITIAL_SIZE, dtype=np.int64)
        self.deflection = np.empty(_INITIAL_SIZE)
        self.u_deflection = np.empty(_INITIAL_SIZE)
        self.head = 0
        self.tail = 0
        self.last_ns = -(1 << 63)
        self.dropped = 0
        """Number of samples dropped before position 0. When it grows, positions become smaller by as much."""

    def append(self, times_ns: ArrayLike, deflection: ArrayLike, u_deflection: ArrayLike) -> None:
        """Check a block of samples and add it; raises `DataError` and adds nothing if it is not valid."""
        times = np.ascontiguousarray(times_ns, dtype=np.int64)
        values = np.ascontiguousarray(deflection, dtype=np.float64)
        u_values = np.ascontiguousarray(u_deflection, dtype=np.float64)
        if times.ndim != 1 or values.shape != times.shape or u_values.shape != times.shape:
            raise DataError(
                "times, deflections and uncertainties must be of one length: "
                f"got {times.shape}, {values.shape} and {u_values.shape}"
            )
        n = len(times)
        if n == 0:
            return
        fault, index = _fault(times, values, u_values, self.last_ns)
        if fault == _BACKWARDS:
            previous_ns = self.last_ns if index == 0 else int(times[index - 1])
            raise DataError(
                f"times run backwards at sample {index} of the block: "
                f"{int(times[index])} ns after {previous_ns} ns; sort the samples or start a new detector"
            )
        if fault == _UNCERTAINTY:
            raise DataError(
                f"uncertainty of sample {index} of the block is {u_values[index]}: "
                "it must be positive and finite where there is a deflection"
            )
        if self.tail + n > len(self.times_ns):
            self._pack(n)
        end = self.tail + n
        self.times_ns[self.tail : end] = times
        self.deflection[self.tail : end] = values
        self.u_deflection[self.tail : end] = u_values
        self.tail = end
        self.last_ns = int(times[-1])

    def _pack(self, n: int) -> None:
        """Move the samples to the start of the arrays, enlarged if there is no room for `n` more."""
        count = self.tail - self.head
        size = len(self.times_ns)
        while count + n > size // 2:
            size *= 2
        for name in ("times_ns", "deflection", "u_deflection"):
            old = getattr(self, name)
            new = old if size == len(old) else np.empty(size, dtype=old.dtype)
            new[:count] = old[self.head : self.tail]
            setattr(self, name, new)
        self.dropped += self.head
        self.head, self.tail = 0, count

    def position(self, time_ns: int) -> int:
        """Position of the first sample at or after a time."""
        return self.head + int(np.searchsorted(self.times_ns[self.head : self.tail], time_ns))

    def forget_before(self, position: int) -> None:
        """Allow the samples before `position` to be dropped."""
        self.head = max(self.head, min(position, self.tail))

    def between(self, reference_ns: int, side: int, start_ns: int, end_ns: int) -> HalfCycleSamples:
        """Copy of the samples from `start_ns` to before `end_ns`, with times relative to `reference_ns`."""
        i, j = self.position(start_ns), self.position(end_ns)
        return HalfCycleSamples(
            reference_ns,
            side,
            seconds(self.times_ns[i:j] - reference_ns),
            self.deflection[i:j].copy(),
            self.u_deflection[i:j].copy(),
        )


_MIN_REVERSAL = 0.25
"""Fraction of the last range by which the deflection has returned when a turning point is accepted."""
_MIN_REVERSAL_U = 8.0
"""The same limit in standard uncertainties of a sample, so that noise makes no turning points; the larger one
applies."""
_DIRECTION, _HIGHEST, _LOWEST, _LAST_PIVOT, _LAST_RANGE, PIVOT, _BEFORE_LAST, _LAST, _COUNT, _HAS_PIVOT = (
    range(10)
)
"""Indices of the state of the search: direction of the motion (+1, -1; 0 unknown), running maximum and
minimum, deflection of the last pivot, range between the last two, deflection of the new pivot, the previous
two samples and their number, and whether a pivot was found before (1.0)."""
SEARCH_STATE = 10
_HIGHEST_TIME, _LOWEST_TIME, PIVOT_TIME = range(3)
"""Indices of the marks: times in ns of the running maximum and minimum and of the new pivot."""


class Pivot(NamedTuple):
    """A rough turning point: its time and the deflection there."""

    time_ns: int
    deflection: float


@kernel
def search(
    times_ns: Ints,
    deflection: Floats,
    u_deflection: Floats,
    first: int,
    last: int,
    state: Floats,
    marks: Ints,
) -> int:
    """Search samples `first` to `last` (not included) for the next turning point.

    `state` (SEARCH_STATE,) and `marks` (three times in ns), zeros at the start, hold the state of the search
    from one call to the next. A running median of three removes single outliers; NaN samples are skipped.
    Returns the index of the sample after the one at which the turning point was accepted; -1 without one.
    """
    for i in range(first, last):
        raw = deflection[i]
        if raw != raw:
            continue
        if state[_COUNT] < 2.0:
            if state[_COUNT] == 0.0:
                state[_HIGHEST], state[_LOWEST] = -math.inf, math.inf
            state[_BEFORE_LAST], state[_LAST] = state[_LAST], raw
            state[_COUNT] += 1.0
            continue
        low, high = min(state[_BEFORE_LAST], state[_LAST]), max(state[_BEFORE_LAST], state[_LAST])
        value = max(low, min(high, raw))
        state[_BEFORE_LAST], state[_LAST] = state[_LAST], raw
        if value > state[_HIGHEST]:
            state[_HIGHEST] = value
            marks[_HIGHEST_TIME] = times_ns[i]
        if value < state[_LOWEST]:
            state[_LOWEST] = value
            marks[_LOWEST_TIME] = times_ns[i]
        threshold = max(_MIN_REVERSAL * state[_LAST_RANGE], _MIN_REVERSAL_U * u_deflection[i])
        is_pivot = False
        if state[_DIRECTION] >= 0.0 and state[_HIGHEST] - value > threshold:
            state[PIVOT], marks[PIVOT_TIME] = state[_HIGHEST], marks[_HIGHEST_TIME]
            state[_DIRECTION] = -1.0
            state[_LOWEST], marks[_LOWEST_TIME] = value, times_ns[i]
            is_pivot = True
        elif state[_DIRECTION] <= 0.0 and value - state[_LOWEST] > threshold:
            state[PIVOT], marks[PIVOT_TIME] = state[_LOWEST], marks[_LOWEST_TIME]
            state[_DIRECTION] = 1.0
            state[_HIGHEST], marks[_HIGHEST_TIME] = value, times_ns[i]
            is_pivot = True
        if is_pivot:
            if state[_HAS_PIVOT] > 0.0:
                state[_LAST_RANGE] = abs(state[PIVOT] - state[_LAST_PIVOT])
            state[_LAST_PIVOT] = state[PIVOT]
            state[_HAS_PIVOT] = 1.0
            return i + 1
    return -1


def is_regular(pivots: list[Pivot]) -> bool:
    """Whether turning points may belong to one oscillation: their spacings and ranges are similar."""
    spacing = np.diff([p.time_ns for p in pivots]).astype(float)
    span = np.abs(np.diff([p.deflection for p in pivots]))
    if np.any(spacing <= 0) or np.any(span <= 0):
        return False
    return bool(spacing.max() < 1.5 * spacing.min() and np.all(np.abs(np.log(span[1:] / span[:-1])) < 0.9))
