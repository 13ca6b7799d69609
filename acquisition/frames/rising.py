"""Which of some frames in doubt keep one line of rising times, and where a step divides it."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_OF_IRREGULAR: Final = 0.6
"""Weight of an interval that is none of the camera's, of a frame: one that is out of line spoils two of them
and is left out, one between two gaps is kept."""
_NOT_ALIKE: Final = 0.5
"""Part of an interval by which another one differs wholly."""
_NEWEST: Final = 9


class RisingTimes(NamedTuple):
    """Places of the frames that are in the line, and of the first one after the step."""

    kept: list[int]
    first_after_step: int | None = None


def rising_times(
    times_ns: Sequence[float], numbers: Sequence[int], interval_ns: float, step_ns: float = 0.0
) -> RisingTimes:
    """The most frames whose times rise from the last sure one on, in intervals like the camera's.

    Times and numbers are counted from the last sure frame. The camera may keep another interval by now, which
    the newest frames show; frames without numbers may be missing anywhere. With a step, times behind one
    place are later by it, which is where the intervals are most regular without it.
    """
    time = np.concatenate(([0.0], np.asarray(times_ns, dtype=np.float64)))
    number = np.concatenate(([0], np.asarray(numbers, dtype=np.int64)))
    newest = (np.diff(time) / np.maximum(np.diff(number), 1))[-_NEWEST:]
    newest = newest[newest > 0]
    usual = [one for one in (interval_ns, float(np.median(newest)) if len(newest) else 0.0) if one > 0]
    # of the best line to each frame, before the step and behind it: its worth, and the frame before
    worth = np.full((2, len(time)), -np.inf)
    worth[0, 0] = 0.0
    came = np.zeros((2, len(time)), np.int64)
    steps_at = np.zeros(len(time), np.bool_)
    for i in range(1, len(time)):
        passed_ns, between = time[i] - time[:i], np.maximum(number[i] - number[:i], 1)
        onwards = worth[:, :i] + _worth(passed_ns, between, usual)
        came[:, i] = np.argmax(onwards, axis=1)
        worth[:, i] = np.max(onwards, axis=1)
        if step_ns:
            stepping = worth[0, :i] + _worth(passed_ns - step_ns, between, usual)
            at = int(np.argmax(stepping))
            if stepping[at] > worth[1, i]:
                worth[1, i], came[1, i], steps_at[i] = stepping[at], at, True
    after = 1 if step_ns else 0
    i = int(np.argmax(worth[after]))
    if worth[after, i] == -np.inf:
        return RisingTimes([])
    kept: list[int] = []
    first_after: int | None = None
    while i:
        kept.append(i - 1)
        before = int(came[after, i])
        if after and steps_at[i]:
            first_after, after = i - 1, 0
        i = before
    return RisingTimes(kept[::-1], first_after)


def _worth(passed_ns: Array, numbers: NDArray[np.int64], usual: list[float]) -> Array:
    """Of a frame with the interval before it; none where its time does not rise."""
    each_ns = passed_ns / numbers
    off = np.ones(len(each_ns))
    for one in usual:
        off = np.minimum(off, np.abs(each_ns - one) / (_NOT_ALIKE * one))
    return np.where(passed_ns > 0, 1.0 - _OF_IRREGULAR * off, -np.inf)
