"""The camera's clock as an instrument that is read with every frame: outliers, steps and wraps of its times.

A frame's time is expected from the one before it: by the frame time that was learned and the numbers between,
or, of a camera that keeps no rate, by the computer's clock. A frame can arrive late by any time and early by
none, so that neither clock alone tells a step. What both contradict waits until the next frames tell a single
wrong time, which is left out and counted, from a step, which is taken off all times that follow. A clock that
makes no sense any more is given up, and the computer's carries the times on.
"""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from processing.ticks import S_PER_NS, seconds
from rig.devices.host_clock import NO_TIME_NS
from rig.devices.rising_times import RisingTimes, rising_times
from rig.devices.usual_times import BY_HOST_NS, REGULAR, SMOOTHING, UsualTimes

_ALIKE = 3
"""Frames that agree on a step, until it is believed."""
_MOST_WAITING = 12
"""Frames in doubt, after which it is decided, unless their reader is behind; each holds an image."""
_LONGEST_WAIT, _MOST_WAITING_BYTES = 2000, 64 * 1024 * 1024
"""Of a reader that is behind: frames that it takes late do not say when they came."""
_BEHIND_NS = 800_000_000.0
"""The same where a frame's reader had not waited for it, which may have lain in the driver as long."""
_COUNTERS_NS: Final = tuple((1 << 32) * tick_ns for tick_ns in (1, 8, 10, 16, 20, 40, 100, 1000))
"""After which counters of 32 bits begin again, of usual ticks."""


class ClockStep(NamedTuple):
    """A step of the camera's clock, which is taken off the times after it, and its standard uncertainty.

    A step of 0: the clock was given up, and each time has this uncertainty.
    """

    step_ns: int
    u_ns: int


class Seen(NamedTuple):
    """Frames whose times hold, what is to be said, and a step: before which of the frames it was."""

    frames: list[Frame]
    note: str = ""
    step: ClockStep | None = None
    after_step: int = 0


class FrameClock:
    """Joins the times of one camera, frame by frame, to a line that never steps.

    `rejected` counts frames whose times fitted nothing, `wraps` the times that a counter began again.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.wraps = 0
        self._steps_ns: list[float] = []
        self._usual = UsualTimes()
        self.begin_again()

    def begin_again(self) -> None:
        """The camera was opened again: whatever its clock shows now is new."""
        self._usual.begin_again()
        self._waiting: list[tuple[Frame, float]] = []
        self._offset_ns = 0
        self._given_up = False

    def take(self, frame: Frame) -> Seen:
        """The frames that may go on: none, while a step is in doubt, or several once it is not."""
        if frame.device_time_ns < 0:
            return Seen([frame])
        if self._given_up:
            return Seen([self._usual.carried(frame)])
        moved = frame._replace(device_time_ns=frame.device_time_ns + self._offset_ns)
        has_time = frame.device_time_ns < NO_TIME_NS
        last = self._usual.last
        off_ns = math.inf
        if has_time and last is not None:
            found_ns = self._off_ns(moved, last)
            if found_ns is None:
                return self._confirmed(moved)
            off_ns = found_ns
        elif has_time:
            return self._confirmed(moved)
        self._waiting.append((frame, off_ns))
        allowed_ns = self._usual.allowed_ns
        agreed = [one for one in self._waiting if abs(one[1] - off_ns) < allowed_ns]
        waiting = len(self._waiting)
        decides = waiting >= _MOST_WAITING and (self._reader_is_up or self._is_full)
        if len(agreed) >= _ALIKE and last is not None:
            step = self._step_of(agreed, last, decides=decides)
            return Seen([]) if step is None else self._stepped(step)
        if not decides:
            return Seen([])
        unlike = self._step_by_arrivals()
        return self._give_up() if unlike is None else self._stepped(unlike)

    @property
    def waiting(self) -> int:
        """Frames whose times are in doubt."""
        return len(self._waiting)

    @property
    def _reader_is_up(self) -> bool:
        """Whether the newest frames were waited for; a reader that hung, even twice, takes many at once."""
        came_ns = [frame.host_time_ns for frame, _ in self._waiting[-1 - _ALIKE :]]
        return all(later - sooner > 0.5 * self._usual.interval_ns for sooner, later in pairwise(came_ns))

    @property
    def _is_full(self) -> bool:
        """Whether no more frames may wait for their reader."""
        waiting = len(self._waiting)
        size = waiting * self._waiting[-1][0].image.nbytes
        return waiting >= _LONGEST_WAIT or (waiting >= 4 * _MOST_WAITING and size >= _MOST_WAITING_BYTES)

    def _off_ns(self, frame: Frame, last: Frame) -> float | None:
        """How far a time lies from what is expected of it; None where one of the clocks confirms it."""
        passed_ns = float(frame.device_time_ns - last.device_time_ns)
        by_host_ns = float(frame.host_time_ns - last.host_time_ns)
        numbers = frame.sequence - last.sequence
        by_rate_ns = numbers * self._usual.interval_ns if numbers > 0 else by_host_ns
        if not self._usual.is_regular:
            # it came when the computer says, or was read late; so was the one before, of those that had
            # gathered while nobody read
            latest_ns = by_host_ns + (BY_HOST_NS if self._usual.waited_for else _BEHIND_NS)
            by_rate = self._usual.learned > 0 and abs(passed_ns - by_rate_ns) < REGULAR * by_rate_ns
            return None if passed_ns > 0 and (passed_ns <= latest_ns or by_rate) else passed_ns - by_host_ns
        off_ns = passed_ns - by_rate_ns
        if passed_ns > 0 and (abs(off_ns) < self._usual.allowed_ns or self._by_computer(frame, last, off_ns)):
            return None
        return off_ns

    def _by_computer(self, frame: Frame, last: Frame, off_ns: float) -> bool:
        """Whether the computer confirms what the rate does not: a camera may change its rate, and lose frames
        that have no number. Frames that were not waited for came at some time while nobody read.
        """
        before = self._waiting[-1][0] if self._waiting else None
        before = last if before is None else before._replace(device_time_ns=self._time_ns(before))
        passed_ns = frame.device_time_ns - before.device_time_ns
        by_host_ns = frame.host_time_ns - before.host_time_ns
        if passed_ns <= 0 or by_host_ns < 0.5 * min(passed_ns, self._usual.interval_ns):
            return False
        early_ns = abs(self._usual.early_ns(frame))
        if self._usual.waited_for:
            by_last_ns = (frame.device_time_ns - last.device_time_ns) - (
                frame.host_time_ns - last.host_time_ns
            )
            early_ns = min(early_ns, abs(by_last_ns))
        return early_ns < min(self._usual.allowed_by_arrival_ns, 0.5 * abs(off_ns))

    def _time_ns(self, frame: Frame) -> int:
        """Of a frame that waits, as if its clock had not stepped again."""
        return frame.device_time_ns + self._offset_ns

    def _confirmed(self, frame: Frame) -> Seen:
        """One of the clocks confirms the time: those that waited were alone, or in one line with it."""
        in_line = self._in_line_with(frame) if self._waiting else []
        kept = {one.sequence for one in in_line}
        note = self._rejected([one for one in self._waiting if one[0].sequence not in kept])
        self._waiting.clear()
        return Seen([self._usual.joined(one) for one in [*in_line, frame]], note)

    def _in_line_with(self, frame: Frame) -> list[Frame]:
        """Those that wait and rise to this one, which the computer confirms and the rate does not: frames
        without numbers are missing, or the rate has changed, and they were read too late to be confirmed.
        """
        last = self._usual.last
        if last is None or not self._usual.is_regular:
            return []
        if (
            len(self._waiting) < _ALIKE
            and abs(self._usual.off_by_rate_ns(frame, last)) < self._usual.allowed_ns
        ):
            return []
        rising = self._rising(last, [*(one for one, _ in self._waiting), self._unmoved(frame)])
        found = [self._waiting[place][0] for place in rising.kept if place < len(self._waiting)]
        in_line = [one._replace(device_time_ns=self._time_ns(one)) for one in found]
        return [one for one in in_line if one.device_time_ns < frame.device_time_ns]

    def _unmoved(self, frame: Frame) -> Frame:
        return frame._replace(device_time_ns=frame.device_time_ns - self._offset_ns)

    def _rising(self, last: Frame, frames: list[Frame], step_ns: float = 0.0) -> RisingTimes:
        return rising_times(
            [float(self._time_ns(one) - last.device_time_ns) for one in frames],
            [one.sequence - last.sequence for one in frames],
            self._usual.interval_ns,
            step_ns,
        )

    def _step_of(self, agreed: list[tuple[Frame, float]], last: Frame, *, decides: bool) -> ClockStep | None:
        """Size of a step: by the camera's rate where the computer agrees with it, else by the computer.

        Frames without numbers may be missing, which the rate knows nothing of; None while frames that were
        read late may explain the difference.
        """
        by_host_ns = max(
            self._usual.early_ns(frame._replace(device_time_ns=self._time_ns(frame))) for frame, _ in agreed
        )
        if not self._usual.is_regular:
            # times go on after the last one, however late that was read
            most_ns = agreed[0][0].device_time_ns + self._offset_ns - last.device_time_ns - 1
            beyond_ns = max(by_host_ns - most_ns, 0.0)
            return ClockStep(round(by_host_ns - beyond_ns), round(self._usual.scatter_ns + beyond_ns))
        by_rate_ns = sum(off_ns for _, off_ns in agreed) / len(agreed)
        counters = [
            -round_ns for round_ns in _COUNTERS_NS if abs(by_rate_ns + round_ns) < self._usual.allowed_ns
        ]
        if counters:
            return ClockStep(counters[0], 0)
        numbers = max(agreed[-1][0].sequence - last.sequence, 1)
        if abs(by_rate_ns - by_host_ns) < min(self._usual.allowed_by_arrival_ns, 0.5 * abs(by_rate_ns)):
            u_ns = self._usual.deviation_ns * (1.0 + SMOOTHING * numbers) + 1.0
            return ClockStep(round(by_rate_ns), math.ceil(u_ns))
        if decides and not self._reader_is_up:
            # read late by nobody knows how much, and frames without numbers may be missing
            return ClockStep(round(by_rate_ns), math.ceil(abs(by_rate_ns - by_host_ns)))
        if decides and abs(by_host_ns) < self._usual.allowed_by_arrival_ns:
            # the camera lost frames that have no number, and its clock is right
            return ClockStep(0, 0)
        return ClockStep(round(by_host_ns), round(self._usual.scatter_ns)) if decides else None

    def _step_by_arrivals(self) -> ClockStep | None:
        """What has happened where the rate is no help, which may have changed: the newest frames were waited
        for, and say together how far the clock is off; None where they say nothing in common.
        """
        last = self._usual.last
        if last is None or not self._usual.is_regular or math.isnan(self._usual.delay_ns):
            return None
        waiting = [one for one, _ in self._waiting]
        newest = [one._replace(device_time_ns=self._time_ns(one)) for one in waiting[-1 - _ALIKE :]]
        early_ns = [self._usual.early_ns(one) for one in newest]
        step_ns = round(max(early_ns))
        if not self._reader_is_up:
            # there is no room to wait for more; if their times rise as a camera's do, they are believed
            step_ns = 0
        elif max(early_ns) - min(early_ns) > self._usual.allowed_by_arrival_ns:
            return None
        elif abs(step_ns) < self._usual.allowed_by_arrival_ns:
            step_ns = 0
        if len(self._rising(last, waiting, float(step_ns)).kept) < 0.5 * len(waiting):
            return None
        return ClockStep(step_ns, round(self._usual.scatter_ns) if step_ns else 0)

    def _stepped(self, step: ClockStep) -> Seen:
        """What waits agrees: the clock has stepped, and goes on from where it would be."""
        waiting = [one for one, _ in self._waiting]
        last = self._usual.last
        assert last is not None
        rising = self._rising(last, waiting, float(step.step_ns))
        kept = set(rising.kept)
        alone = [one for place, one in enumerate(self._waiting) if place not in kept]
        note = self._rejected(alone)
        self._waiting.clear()
        first = rising.first_after_step if rising.first_after_step is not None else len(waiting)
        before_ns, self._offset_ns = self._offset_ns, self._offset_ns - step.step_ns
        frames: list[Frame] = []
        for place in rising.kept:
            one = waiting[place]
            offset_ns = before_ns if place < first else self._offset_ns
            frames.append(self._usual.joined(one._replace(device_time_ns=one.device_time_ns + offset_ns)))
        if not step.step_ns:
            return Seen(frames, note)
        after_step = sum(place < first for place in rising.kept)
        again = step.step_ns < 0 and any(abs(step.step_ns - ns) < BY_HOST_NS for ns in self._steps_ns)
        self._steps_ns.append(step.step_ns)
        if again:
            self.wraps += 1
            counter = (
                f"the camera's counter begins again every {-seconds(step.step_ns):.4g} s; its times continue"
            )
            return Seen(frames, counter if self.wraps == 1 else note, step, after_step)
        u_s = seconds(max(step.u_ns, 1))
        left_out = f", {_frames(len(alone))} left out" if alone else ""
        return Seen(
            frames,
            f"the camera's clock stepped by {seconds(step.step_ns):+.6g} s (u {u_s:.1g} s) before frame "
            f"{waiting[min(first, len(waiting) - 1)].sequence}; its times continue without "
            f"the step{left_out}",
            step,
            after_step,
        )

    def _give_up(self) -> Seen:
        """No two of the times agree: from here on they are the computer's, at the camera's rate."""
        self._given_up = True
        waited, self._waiting = self._waiting, []
        if math.isnan(self._usual.delay_ns):
            self._usual.delay_ns = 0.0
        frames = [self._usual.carried(one) for one, _ in waited]
        u_ns = round(self._usual.scatter_ns)
        return Seen(
            frames,
            f"the camera's clock is abandoned from frame {waited[0][0].sequence} on, where it shows "
            f"{waited[0][0].device_time_ns} ns: times are the computer's, u {seconds(u_ns):.1g} s; restart "
            "the camera before the next run",
            ClockStep(0, u_ns),
        )

    def _rejected(self, alone: list[tuple[Frame, float]]) -> str:
        """Count them; what is said of them, where there are any."""
        self.rejected += len(alone)
        if not alone:
            return ""
        frame, off_ns = alone[0]
        off = "no time" if math.isinf(off_ns) else f"{S_PER_NS * off_ns:+.3g} s from what both clocks say"
        return (
            f"{_frames(len(alone))} left out from frame {frame.sequence} on: the camera's time "
            f"{frame.device_time_ns} ns is {off}"
        )


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"


Integers = NDArray[np.int64]

_LEAST_NS = 2_000_000
_NO_IMAGE = np.zeros((1, 1), np.uint8)


class MendedTimes(NamedTuple):
    """What is added to the times of a record's frames.

    `sequence` (n,) are the frames that have a right time, in order, `added_ns` (n,) what their times lack;
    `steps` are times, as they were recorded, and the steps before them; `left_out` counts the other frames.
    """

    sequence: Integers
    added_ns: Integers
    steps: tuple[tuple[int, ClockStep], ...]
    left_out: int


def mended_times(sequence: Integers, device_ns: Integers, host_ns: Integers) -> MendedTimes | None:
    """The corrections of recorded frames, (n,) each; None where the clock never stepped.

    A camera without a clock (times below 0) has nothing to be corrected.
    """
    numbers = np.diff(sequence)
    if len(numbers) == 0 or device_ns.min() < 0:
        return None
    passed_ns = np.diff(device_ns).astype(float)
    by_rate_ns = numbers * float(np.median(passed_ns / np.maximum(numbers, 1)))
    by_host_ns = np.diff(host_ns)
    off_ns = np.minimum(np.abs(passed_ns - by_rate_ns), np.abs(passed_ns - by_host_ns))
    if off_ns.max() < _LEAST_NS and passed_ns.min() > 0:
        return None
    clock = FrameClock()
    kept: list[int] = []
    added: list[int] = []
    steps: list[tuple[int, ClockStep]] = []
    recorded = dict(zip(sequence.tolist(), device_ns.tolist(), strict=True))
    for number, device, host in zip(sequence.tolist(), device_ns.tolist(), host_ns.tolist(), strict=True):
        seen = clock.take(Frame(_NO_IMAGE, number, device, host))
        if seen.step is not None:
            steps.append((recorded[seen.frames[seen.after_step].sequence], seen.step))
        for frame in seen.frames:
            kept.append(frame.sequence)
            added.append(frame.device_time_ns - recorded[frame.sequence])
    if not steps and len(kept) == len(sequence):
        return None
    return MendedTimes(np.array(kept), np.array(added), tuple(steps), len(sequence) - len(kept))
