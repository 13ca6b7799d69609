"""Rough turning points (pivots) of a deflection of unknown amplitude, period and centre, sample by sample."""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.kernel import kernel

REVERSAL = 0.25
"""A turning point is accepted once the deflection has returned by this fraction of the last swing's range
..."""

NOISE_REVERSAL = 8.0
"""... and by this many standard uncertainties of a sample, so that noise makes no turning points."""

DIRECTION, HIGHEST, LOWEST, LAST_PIVOT, LAST_RANGE, FOUND, BEFORE_LAST, LAST, SEEN, HAS_PIVOT = range(10)
"""Indices of the state of the search: direction of the motion (+1, -1; 0 unknown), running maximum and
minimum, deflection of the last pivot, range of the last swing, deflection of the pivot just found, the
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

    `state` (SEARCH_STATE,), zeros at the start, and `marks` (three times) keep the state of the search from
    one call to the next. A running median of three removes single outliers; NaN samples are skipped.

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


def regular(pivots: list[Pivot]) -> bool:
    """Whether the turning points may belong to one oscillation: similar spacing and similar range."""
    spacing = np.diff([p.time_ns for p in pivots]).astype(float)
    span = np.abs(np.diff([p.deflection for p in pivots]))
    if np.any(spacing <= 0) or np.any(span <= 0):
        return False
    return bool(spacing.max() < 1.5 * spacing.min() and np.all(np.abs(np.log(span[1:] / span[:-1])) < 0.9))
