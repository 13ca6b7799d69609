"""What is expected of the times of a camera's frames, and which frames in doubt keep to it.

Usual are the time of a frame, how late frames arrive, and the scatter of both. Of frames in doubt those
belong together whose times rise in one line, which a step may divide.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame

_LEARNED = 8
"""Frames after which the frame time is known."""
SMOOTHING = 0.1
"""Part of a deviation by which the frame time follows each frame."""
_OF_ARRIVALS = 0.02
"""The same of the usual delay and its scatter."""
_LEAST_NS = 2_000_000.0
"""Smaller disagreements are those of the computer's readings of frames, or of the exposure."""
BY_HOST_NS = 60_000_000.0
"""Disagreements with the computer's clock that late readings explain."""
REGULAR = 0.2
"""Mean deviation of frame times, of one, up to which a camera keeps a rate."""
_LEAST_SCATTER_NS = 20_000.0
_OF_IRREGULAR: Final = 0.6
"""Weight of an interval that is none of the camera's, of a frame: one that is out of line spoils two of them
and is left out, one between two gaps is kept."""
_NOT_ALIKE: Final = 0.5
"""Part of an interval by which another one differs wholly."""
_NEWEST: Final = 9


class UsualTimes:
    """Learned from frames whose times hold, with which `joined` is called one by one.

    `waited_for`: the last frame was, and has not lain in the driver.
    """

    def __init__(self) -> None:
        self.scatter_ns = _LEAST_NS
        self.interval_ns = 0.0
        self.begin_again()

    def begin_again(self) -> None:
        """The camera was opened again: its clock may show anything. The frame time is the last known."""
        self.last: Frame | None = None
        self.waited_for = False
        self.deviation_ns = 0.0
        self.learned = 0
        self.delay_ns = math.nan

    @property
    def is_regular(self) -> bool:
        """Whether the camera is known to keep a rate."""
        return self.learned >= _LEARNED and self.deviation_ns < REGULAR * self.interval_ns

    @property
    def allowed_ns(self) -> float:
        """By so much a time may disagree with what is expected of it."""
        return max(_LEAST_NS, 10 * self.deviation_ns) if self.is_regular else BY_HOST_NS

    @property
    def allowed_by_arrival_ns(self) -> float:
        """The same by the arrival of frames."""
        return max(3 * _LEAST_NS, 6 * self.scatter_ns)

    def early_ns(self, moved: Frame) -> float:
        """How much sooner than usual it came, by its time: as much as the clock has stepped, less what it was
        read late."""
        return moved.device_time_ns - (moved.host_time_ns - self.delay_ns)

    def off_by_rate_ns(self, frame: Frame, last: Frame) -> float:
        """How far a time lies from what the camera's rate lets expect."""
        return (
            frame.device_time_ns - last.device_time_ns - (frame.sequence - last.sequence) * self.interval_ns
        )

    def joined(self, frame: Frame) -> Frame:
        """The frame, whose time holds and is learned from."""
        last, self.last = self.last, frame
        if last is not None:
            passed_ns, numbers = frame.time_ns - last.time_ns, frame.sequence - last.sequence
            self.waited_for = frame.host_time_ns - last.host_time_ns > 0.5 * passed_ns
            if numbers > 0 and passed_ns > 0:
                off_ns = passed_ns / numbers - self.interval_ns
                if self.learned:
                    self.deviation_ns += SMOOTHING * (abs(off_ns) - self.deviation_ns)
                self.interval_ns += (SMOOTHING if self.learned else 1.0) * off_ns
                self.learned += 1
        delay_ns = float(frame.host_time_ns - frame.device_time_ns)
        if math.isnan(self.delay_ns) or self.learned < _LEARNED:
            # the first ones may be late
            self.delay_ns = min(delay_ns, delay_ns if math.isnan(self.delay_ns) else self.delay_ns)
        elif self.waited_for:
            # one that was not has lain in the driver, as long as nobody read
            later_ns = delay_ns - self.delay_ns
            most_ns = 2 * self.scatter_ns
            self.delay_ns += _OF_ARRIVALS * min(max(later_ns, -most_ns), most_ns)
            wider_ns = min(abs(later_ns), most_ns) - self.scatter_ns
            self.scatter_ns = max(self.scatter_ns + _OF_ARRIVALS * wider_ns, _LEAST_SCATTER_NS)
        return frame

    def carried(self, frame: Frame) -> Frame:
        """The frame with the time of its arrival less the usual delay, smoothed by the camera's rate."""
        arrived_ns = frame.host_time_ns - self.delay_ns
        last = self.last
        time_ns = arrived_ns
        if last is not None:
            numbers = frame.sequence - last.sequence
            by_rate_ns = last.device_time_ns + numbers * self.interval_ns
            later_ns = arrived_ns - by_rate_ns
            if self.learned >= _LEARNED and numbers > 0 and abs(later_ns) < BY_HOST_NS:
                most_ns = 2 * self.scatter_ns
                time_ns = by_rate_ns + _OF_ARRIVALS * min(max(later_ns, -most_ns), most_ns)
            time_ns = max(time_ns, last.device_time_ns + 1)
        self.last = frame._replace(device_time_ns=round(time_ns))
        return self.last


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


def _worth(
    passed_ns: NDArray[np.float64], numbers: NDArray[np.int64], usual: list[float]
) -> NDArray[np.float64]:
    """Of a frame with the interval before it; none where its time does not rise."""
    each_ns = passed_ns / numbers
    off = np.ones(len(each_ns))
    for one in usual:
        off = np.minimum(off, np.abs(each_ns - one) / (_NOT_ALIKE * one))
    return np.where(passed_ns > 0, 1.0 - _OF_IRREGULAR * off, -np.inf)
