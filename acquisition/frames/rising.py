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
    usual = _usual_intervals(time, number, interval_ns)
    count = len(time)
    before, after = np.full(count, -np.inf), np.full(count, -np.inf)
    before[0] = 0.0
    came_before, came_after = np.zeros(count, np.int64), np.zeros(count, np.int64)
    steps_at = np.zeros(count, np.bool_)
    for i in range(1, count):
        passed_ns, numbers_between = time[i] - time[:i], np.maximum(number[i] - number[:i], 1)
        link = _worth(passed_ns, numbers_between, usual)
        scores = before[:i] + link
        came_before[i] = np.argmax(scores)
        before[i] = scores[came_before[i]]
        if step_ns:
            onwards = after[:i] + link
            stepping = before[:i] + _worth(passed_ns - step_ns, numbers_between, usual)
            on, at = int(np.argmax(onwards)), int(np.argmax(stepping))
            steps_at[i] = stepping[at] > onwards[on]
            came_after[i] = at if steps_at[i] else on
            after[i] = max(stepping[at], onwards[on])
    best = after if step_ns else before
    i = int(np.argmax(best))
    if not i or best[i] == -np.inf:
        return RisingTimes([])
    kept: list[int] = []
    first_after: int | None = None
    while i:
        kept.append(i - 1)
        if step_ns and first_after is None:
            if steps_at[i]:
                first_after = i - 1
            i = int(came_after[i])
        else:
            i = int(came_before[i])
    return RisingTimes(kept[::-1], first_after)


def _usual_intervals(time: Array, number: NDArray[np.int64], interval_ns: float) -> list[float]:
    each_ns = np.diff(time) / np.maximum(np.diff(number), 1)
    newest = each_ns[-_NEWEST:]
    rising = newest[newest > 0]
    return [one for one in (interval_ns, float(np.median(rising)) if len(rising) else 0.0) if one > 0]


def _worth(passed_ns: Array, numbers: NDArray[np.int64], usual: list[float]) -> Array:
    """Of a frame with the interval before it; none where its time does not rise."""
    each_ns = passed_ns / numbers
    off = np.ones(len(each_ns))
    for one in usual:
        off = np.minimum(off, np.abs(each_ns - one) / (_NOT_ALIKE * one))
    return np.where(passed_ns > 0, 1.0 - _OF_IRREGULAR * off, -np.inf)
