"""Buffer of the samples that are still needed, check of new ones, search for rough turning points."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.kernel import kernel
from processing.swing.arc import HalfCycleSamples
from processing.units import seconds

_FINE, _BACKWARDS, _UNCERTAINTY = 0, 1, 2
_FIRST_SIZE = 4096


@kernel
def _fault(times_ns: Ints, deflection: Floats, u_deflection: Floats, last: int) -> tuple[int, int]:
    for i in range(len(times_ns)):
        if times_ns[i] < last:
            return _BACKWARDS, i
        last = times_ns[i]
        if deflection[i] == deflection[i] and not (u_deflection[i] > 0.0 and u_deflection[i] < math.inf):
            return _UNCERTAINTY, i
    return _FINE, 0


class SampleBuffer:
    """Samples in order of time, without the old ones. Positions are indices into its arrays."""

    def __init__(self) -> None:
        self.times_ns = np.empty(_FIRST_SIZE, dtype=np.int64)
        self.deflection = np.empty(_FIRST_SIZE)
        self.u_deflection = np.empty(_FIRST_SIZE)
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
        fault, where = _fault(times, values, u_values, self.last_ns)
        if fault == _BACKWARDS:
            before = self.last_ns if where == 0 else int(times[where - 1])
            raise DataError(
                f"times run backwards at sample {where} of the block: "
                f"{int(times[where])} ns after {before} ns; sort the samples or start a new detector"
            )
        if fault == _UNCERTAINTY:
            raise DataError(
                f"uncertainty of sample {where} of the block is {u_values[where]}: "
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
        kept = self.tail - self.head
        size = len(self.times_ns)
        while kept + n > size // 2:
            size *= 2
        for name in ("times_ns", "deflection", "u_deflection"):
            old = getattr(self, name)
            new = old if size == len(old) else np.empty(size, dtype=old.dtype)
            new[:kept] = old[self.head : self.tail]
            setattr(self, name, new)
        self.dropped += self.head
        self.head, self.tail = 0, kept

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


REVERSAL = 0.25
"""A turning point is accepted once the deflection has returned by this fraction of the last range ..."""

NOISE_REVERSAL = 8.0
"""... and by this many standard uncertainties of a sample, so that noise makes no turning points."""

DIRECTION, HIGHEST, LOWEST, LAST_PIVOT, LAST_RANGE, FOUND, BEFORE_LAST, LAST, SEEN, HAS_PIVOT = range(10)
"""Indices of the state of the search: direction of the motion (+1, -1; 0 unknown), running maximum and
minimum, deflection of the last pivot, range between the last two, deflection of the pivot just found, the
previous two samples and their number, and whether a pivot was found before (1.0)."""

SEARCH_STATE = 10

HIGHEST_TIME, LOWEST_TIME, FOUND_TIME = range(3)
"""Indices of the marks: times in ns of the running maximum and minimum and of the pivot just found."""


class Pivot(NamedTuple):
    """A rough turning point: its time and the deflection there."""

    time_ns: int
    deflection: float


@kernel
def _middle(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


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

    Returns
    -------
    int
        Index of the sample after the one at which the turning point was accepted; -1 if there was none.
    """
    for i in range(first, last):
        raw = deflection[i]
        if raw != raw:
            continue
        if state[SEEN] < 2.0:
            if state[SEEN] == 0.0:
                state[HIGHEST], state[LOWEST] = -math.inf, math.inf
            state[BEFORE_LAST], state[LAST] = state[LAST], raw
            state[SEEN] += 1.0
            continue
        value = _middle(state[BEFORE_LAST], state[LAST], raw)
        state[BEFORE_LAST], state[LAST] = state[LAST], raw
        if value > state[HIGHEST]:
            state[HIGHEST] = value
            marks[HIGHEST_TIME] = times_ns[i]
        if value < state[LOWEST]:
            state[LOWEST] = value
            marks[LOWEST_TIME] = times_ns[i]
        threshold = max(REVERSAL * state[LAST_RANGE], NOISE_REVERSAL * u_deflection[i])
        found = False
        if state[DIRECTION] >= 0.0 and state[HIGHEST] - value > threshold:
            state[FOUND], marks[FOUND_TIME] = state[HIGHEST], marks[HIGHEST_TIME]
            state[DIRECTION] = -1.0
            state[LOWEST], marks[LOWEST_TIME] = value, times_ns[i]
            found = True
        elif state[DIRECTION] <= 0.0 and value - state[LOWEST] > threshold:
            state[FOUND], marks[FOUND_TIME] = state[LOWEST], marks[LOWEST_TIME]
            state[DIRECTION] = 1.0
            state[HIGHEST], marks[HIGHEST_TIME] = value, times_ns[i]
            found = True
        if found:
            if state[HAS_PIVOT] > 0.0:
                state[LAST_RANGE] = abs(state[FOUND] - state[LAST_PIVOT])
            state[LAST_PIVOT] = state[FOUND]
            state[HAS_PIVOT] = 1.0
            return i + 1
    return -1


def is_regular(pivots: list[Pivot]) -> bool:
    """Whether turning points may belong to one oscillation: their spacings and ranges are similar."""
    spacing = np.diff([p.time_ns for p in pivots]).astype(float)
    span = np.abs(np.diff([p.deflection for p in pivots]))
    if np.any(spacing <= 0) or np.any(span <= 0):
        return False
    return bool(spacing.max() < 1.5 * spacing.min() and np.all(np.abs(np.log(span[1:] / span[:-1])) < 0.9))
