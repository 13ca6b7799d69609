"""Rough turning points of a deflection of unknown amplitude, period and centre, sample by sample."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

REVERSAL = 0.25
"""A turning point is believed once the deflection has come back by this part of the last swing."""

NOISE_REVERSAL = 8.0
"""... and by this many standard uncertainties of a sample."""

SEARCH_STATE = 10


class Pivot(NamedTuple):
    """A rough turning point: its time and the deflection there."""

    time_ns: int
    deflection: float


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True, nogil=True, error_model="numpy")
def search(
    times_ns: NDArray[np.int64],
    deflection: NDArray[np.float64],
    u_deflection: NDArray[np.float64],
    first: int,
    last: int,
    state: NDArray[np.float64],
    marks: NDArray[np.int64],
) -> int:
    """Go through samples `first` to `last` until a turning point is certain.

    Returns the number of the sample after the one that made it certain, or ``-1`` when none was.
    `state` (SEARCH_STATE floats, zeros to start with) and `marks` (times of the two running extremes, then
    time of the turning point found) carry the search from one block to the next; ``state[5]`` is the
    deflection there. A median of three takes single wild samples out.
    """
    # 0 direction, 1 running maximum, 2 running minimum, 3 last pivot, 4 last swing's range, 5 found
    # 6, 7 the two samples before, 8 how many of them there are, 9 whether there was a pivot
    for i in range(first, last):
        raw = deflection[i]
        if raw != raw:
            continue
        if state[8] < 2.0:
            if state[8] == 0.0:
                state[1], state[2] = -math.inf, math.inf
            state[6], state[7] = state[7], raw
            state[8] += 1.0
            continue
        value = _middle(state[6], state[7], raw)
        state[6], state[7] = state[7], raw
        if value > state[1]:
            state[1] = value
            marks[0] = times_ns[i]
        if value < state[2]:
            state[2] = value
            marks[1] = times_ns[i]
        threshold = max(REVERSAL * state[4], NOISE_REVERSAL * u_deflection[i])
        found = False
        if state[0] >= 0.0 and state[1] - value > threshold:
            state[5], marks[2] = state[1], marks[0]
            state[0] = -1.0
            state[2], marks[1] = value, times_ns[i]
            found = True
        elif state[0] <= 0.0 and value - state[2] > threshold:
            state[5], marks[2] = state[2], marks[1]
            state[0] = 1.0
            state[1], marks[0] = value, times_ns[i]
            found = True
        if found:
            if state[9] > 0.0:
                state[4] = abs(state[5] - state[3])
            state[3] = state[5]
            state[9] = 1.0
            return i + 1
    return -1


def regular(pivots: list[Pivot]) -> bool:
    """Whether the turning points look like one oscillation: alike in spacing and in range."""
    spacing = np.diff([p.time_ns for p in pivots]).astype(float)
    span = np.abs(np.diff([p.deflection for p in pivots]))
    if np.any(spacing <= 0) or np.any(span <= 0):
        return False
    return bool(spacing.max() < 1.5 * spacing.min() and np.all(np.abs(np.log(span[1:] / span[:-1])) < 0.9))
