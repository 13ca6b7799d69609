"""The one place where a frame gets the number and the time that hold from here on.

A frame's time is expected from the one before it: by the frame time that was learned and the numbers between,
or, of a camera that keeps no rate, by the computer's clock. A frame can arrive late by any time and early by
none, so that neither clock alone tells a step. What both contradict waits until the next frames tell a single
wrong time, which is left out and counted, from a step, which is taken off all times that follow. A clock that
makes no sense any more is given up, and the computer's carries the times on.
"""

import math
from collections.abc import Collection, Iterable
from itertools import pairwise
from typing import Final, NamedTuple

from acquisition.camera import Frame
from acquisition.frames.guard import NO_TIME_NS, ClockCheck, FrameChecks
from acquisition.frames.losses import (
    MAX_IRREGULARITY,
    MAX_READING_DELAY_NS,
    SMOOTHING,
    FrameTiming,
    RisingTimes,
    rising_times,
)
from acquisition.record.events import EventKind
from acquisition.record.topics import RecordedClockStep
from processing.units import S_PER_NS, seconds

_ALIKE = 3
"""Frames that agree on a step, until it is believed."""
_MOST_WAITING = 12
"""Frames in doubt, after which it is decided, unless their reader is behind; each holds an image."""
_LONGEST_WAIT, _MOST_WAITING_BYTES = 2000, 64 * 1024 * 1024
"""Of a reader that is behind: frames that it takes late do not say when they came."""
_BEHIND_NS = 800_000_000.0
"""`MAX_READING_DELAY_NS` where a reader had not waited for its frame, which lay in the driver so long."""
_COUNTERS_NS: Final = tuple((1 << 32) * tick_ns for tick_ns in (1, 8, 10, 16, 20, 40, 100, 1000))
"""After which counters of 32 bits begin again, of usual ticks."""
_NAMED_AFTER_S = 0.35
_RESTARTED_NS = 1_000_000_000
"""Disagreement with the computer over a gap, from which on a clock was reset in it."""
_U_BY_HOST_NS = 2_000_000
"""Of the computer's readings of two frames."""


class NumberedFrames(NamedTuple):
    """Frames whose numbers and times hold, what is to be said, and steps that were taken off, with their u.

    A step's time is that of the frame after it. A step of 0: the clock was given up; each time has this u.
    """

    frames: list[Frame]
    notes: tuple[tuple[EventKind, str], ...] = ()
    steps: tuple[RecordedClockStep, ...] = ()


class _Doubtful(NamedTuple):
    """A frame whose time is in doubt, by how much it is off, and what the camera's clock showed."""

    frame: Frame
    off_ns: float
    shown_ns: int


class FrameLine:
    """Joins the frames of one camera to a line of numbers and times, also where it was opened again.

    `time_shift_ns` moves the camera's timestamps to the middle of the exposure. A camera that is opened again
    numbers its frames from 0, and its clock may have been reset: the numbers go on by the time elapsed, so
    that missing frames are counted, and the clock by a constant, which is reported as a step. Frames that are
    not `in_real_time` have a clock of their own, whose times hold; theirs may pass more quickly than the
    computer's.

    What a camera delivers is checked first, and a clock that cannot be right is refused (`guard`).

    `missing` counts the frames missed while the camera was gone, `rejected` those whose times fitted nothing,
    `wraps` the times that a counter began again.
    """

    def __init__(self, time_shift_ns: int = 0, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._to_middle_ns = time_shift_ns
        self._delivered = FrameChecks(in_real_time=in_real_time)
        self._clock = ClockCheck()
        self._usual = FrameTiming()
        self._waiting: list[_Doubtful] = []
        self._before_gap: Frame | None = None
        self._from_number = self._offset_ns = 0
        self._given_up = False
        self._steps_ns: list[float] = []
        self.missing = self.rejected = self.wraps = 0

    def patience_s(self, without_s: float) -> float:
        """Time without a frame that is still normal: two frame times and a margin; `without_s` at the start.

        With this margin an interruption is reported within two frame times plus 0.5 s.
        """
        usual_ns = self._usual.interval_ns
        return 2 * S_PER_NS * usual_ns + _NAMED_AFTER_S if usual_ns else without_s

    def restart(self) -> None:
        """The camera was opened again: the next frame is its first, whatever its clock shows is new."""
        self._delivered.restart()
        self._clock.restart()
        self._before_gap = self._usual.last or self._before_gap
        self._usual.restart()
        self.rejected += len(self._waiting)
        self._waiting.clear()
        self._offset_ns = 0
        self._given_up = False

    def take(self, read: object) -> NumberedFrames:
        """The frames that may go on: none, while a step is in doubt, or several once it is not.

        Raises DeviceError, in one line, for what no camera may deliver.
        """
        frame = self._delivered.check(read)
        if self._in_real_time:
            self._clock.see(frame)
        shown_ns = frame.device_time_ns
        has_time = 0 <= shown_ns < NO_TIME_NS
        before_gap, usual = self._before_gap, self._usual
        continues = before_gap is not None and (shown_ns < NO_TIME_NS or not self._in_real_time)
        note, step = self._go_on(frame, before_gap) if before_gap is not None and continues else (None, [])
        time_ns = self._middle_ns(frame) + self._offset_ns if has_time else shown_ns
        if self._from_number or time_ns != shown_ns:
            frame = Frame(frame.image, frame.sequence + self._from_number, time_ns, frame.host_time_ns)
        if shown_ns < 0 or not self._in_real_time:
            passed = NumberedFrames([usual.learn(frame)])
        elif self._given_up:
            passed = NumberedFrames([usual.time_by_arrival(frame)])
        else:
            off_ns = math.inf if usual.last is None or not has_time else self._off_ns(frame, usual.last)
            if has_time and (off_ns is None or usual.last is None):
                # one of the clocks confirms the time
                passed = self._after_doubts(frame) if self._waiting else NumberedFrames([usual.learn(frame)])
            else:
                passed = self._doubted(_Doubtful(frame, off_ns or 0.0, shown_ns))
        if note is None:
            return passed
        return passed._replace(notes=(*passed.notes, note), steps=(*step, *passed.steps))

    @property
    def waiting(self) -> int:
        """Frames whose times are in doubt."""
        return len(self._waiting)

    def _go_on(self, frame: Frame, last: Frame) -> tuple[tuple[EventKind, str], list[RecordedClockStep]]:
        """Number and time of the first frame after a gap follow those of the last one before it."""
        self._before_gap = None
        passed_ns = by_host_ns = frame.host_time_ns - last.host_time_ns
        step: list[RecordedClockStep] = []
        shifted = ""
        if 0 <= frame.device_time_ns < NO_TIME_NS:
            by_device_ns = self._middle_ns(frame) - last.device_time_ns
            # a clock that began again is behind, or anywhere where another one sets it
            differs = self._in_real_time and abs(by_device_ns - by_host_ns) > _RESTARTED_NS
            if differs or by_device_ns <= 0:
                self._offset_ns = by_host_ns - by_device_ns
                after_ns = last.device_time_ns + by_host_ns
                step.append(RecordedClockStep(after_ns, -self._offset_ns, _U_BY_HOST_NS))
                shifted = f"; its clock restarted, {self._offset_ns} ns are added to its times"
            else:
                passed_ns = by_device_ns
        usual_ns = self._usual.interval_ns
        missing = max(round(passed_ns / usual_ns) - 1, 0) if usual_ns else 0
        self._from_number = last.sequence + 1 + missing - frame.sequence
        self.missing += missing
        passed = f"{seconds(passed_ns):.3f} s without frames, about {missing} of them"
        return (EventKind.CAMERA_BACK, f"opened again after {passed}{shifted}"), step

    def _middle_ns(self, frame: Frame) -> int:
        return max(frame.device_time_ns + self._to_middle_ns, 0)

    def _doubted(self, one: _Doubtful) -> NumberedFrames:
        """Neither clock confirms the time: it waits until the next frames tell what it is."""
        self._waiting.append(one)
        last, allowed_ns = self._usual.last, self._usual.allowed_ns
        agreed = [other for other in self._waiting if abs(other.off_ns - one.off_ns) < allowed_ns]
        decides = len(self._waiting) >= _MOST_WAITING and (self._reader_is_up or self._is_full)
        if len(agreed) >= _ALIKE and last is not None:
            step = self._step_of(agreed, last, decides=decides)
            return NumberedFrames([]) if step is None else self._stepped(last, *step)
        if not decides:
            return NumberedFrames([])
        unlike = None if last is None else self._step_by_arrivals(last)
        return self._give_up() if last is None or unlike is None else self._stepped(last, *unlike)

    @property
    def _reader_is_up(self) -> bool:
        """Whether the newest frames were waited for; a reader that hung, even twice, takes many at once."""
        came_ns = [one.frame.host_time_ns for one in self._waiting[-1 - _ALIKE :]]
        return all(later - sooner > 0.5 * self._usual.interval_ns for sooner, later in pairwise(came_ns))

    @property
    def _is_full(self) -> bool:
        """Whether no more frames may wait for their reader."""
        waiting = len(self._waiting)
        size = waiting * self._waiting[-1].frame.image.nbytes
        return waiting >= _LONGEST_WAIT or (waiting >= 4 * _MOST_WAITING and size >= _MOST_WAITING_BYTES)

    def _off_ns(self, frame: Frame, last: Frame) -> float | None:
        """How far a time lies from what is expected of it; None where one of the clocks confirms it."""
        usual = self._usual
        passed_ns = float(frame.device_time_ns - last.device_time_ns)
        by_host_ns = float(frame.host_time_ns - last.host_time_ns)
        numbers = frame.sequence - last.sequence
        by_rate_ns = numbers * usual.interval_ns if numbers > 0 else by_host_ns
        off_ns = passed_ns - by_rate_ns
        if usual.is_regular:
            near = abs(off_ns) < usual.allowed_ns or self._by_computer(frame, last, off_ns)
            return None if passed_ns > 0 and near else off_ns
        # it came when the computer says, or was read late; so was the one before, of those that had
        # gathered while nobody read
        latest_ns = by_host_ns + (MAX_READING_DELAY_NS if usual.waited_for else _BEHIND_NS)
        by_rate = usual.learned > 0 and abs(off_ns) < MAX_IRREGULARITY * by_rate_ns
        return None if passed_ns > 0 and (passed_ns <= latest_ns or by_rate) else passed_ns - by_host_ns

    def _by_computer(self, frame: Frame, last: Frame, off_ns: float) -> bool:
        """Whether the computer confirms what the rate does not: a camera may change its rate, and lose frames
        that have no number. Frames that were not waited for came at some time while nobody read.
        """
        usual = self._usual
        before = self._waiting[-1].frame if self._waiting else last
        passed_ns = frame.device_time_ns - before.device_time_ns
        by_host_ns = frame.host_time_ns - before.host_time_ns
        if passed_ns <= 0 or by_host_ns < 0.5 * min(passed_ns, usual.interval_ns):
            return False
        early_ns = abs(usual.early_ns(frame))
        if usual.waited_for:
            by_last_ns = frame.device_time_ns - last.device_time_ns - frame.host_time_ns + last.host_time_ns
            early_ns = min(early_ns, abs(by_last_ns))
        return early_ns < min(usual.allowed_by_arrival_ns, 0.5 * abs(off_ns))

    def _after_doubts(self, frame: Frame) -> NumberedFrames:
        """One of the clocks confirms the time. Those that waited were alone; or they rise to this one, which
        the computer confirms and the rate does not: frames without numbers are missing, or the rate has
        changed, and they were read too late to be confirmed.
        """
        usual, kept = self._usual, list[int]()
        if usual.last is not None and usual.is_regular:
            several = len(self._waiting) >= _ALIKE
            if several or abs(usual.off_by_rate_ns(frame, usual.last)) >= usual.allowed_ns:
                before = [(place, one.frame.device_time_ns) for place, one in enumerate(self._waiting)]
                sooner = {place for place, time_ns in before if time_ns < frame.device_time_ns}
                kept = [place for place in self._rising(usual.last, newest=[frame]).kept if place in sooner]
        frames, notes, _ = self._settled(kept)
        return NumberedFrames([*frames, usual.learn(frame)], notes)

    def _rising(self, last: Frame, step_ns: int = 0, newest: Iterable[Frame] = ()) -> RisingTimes:
        frames = [*(one.frame for one in self._waiting), *newest]
        return rising_times(
            [float(one.device_time_ns - last.device_time_ns) for one in frames],
            [one.sequence - last.sequence for one in frames],
            self._usual.interval_ns,
            float(step_ns),
        )

    def _step_of(self, agreed: list[_Doubtful], last: Frame, *, decides: bool) -> tuple[int, int] | None:
        """A step and its u: by the camera's rate where the computer agrees with it, else by the computer.

        Frames without numbers may be missing, which the rate knows nothing of; None while frames that were
        read late may explain the difference.
        """
        usual = self._usual
        by_host_ns = max(usual.early_ns(one.frame) for one in agreed)
        if not usual.is_regular:
            # times go on after the last one, however late that was read
            beyond_ns = max(by_host_ns - (agreed[0].frame.device_time_ns - last.device_time_ns - 1), 0.0)
            return round(by_host_ns - beyond_ns), round(usual.scatter_ns + beyond_ns)
        by_rate_ns = sum(one.off_ns for one in agreed) / len(agreed)
        for round_ns in _COUNTERS_NS:
            if abs(by_rate_ns + round_ns) < usual.allowed_ns:
                return -round_ns, 0
        apart_ns = abs(by_rate_ns - by_host_ns)
        if apart_ns < min(usual.allowed_by_arrival_ns, 0.5 * abs(by_rate_ns)):
            numbers = max(agreed[-1].frame.sequence - last.sequence, 1)
            return round(by_rate_ns), math.ceil(usual.deviation_ns * (1.0 + SMOOTHING * numbers) + 1.0)
        if not decides:
            return None
        if not self._reader_is_up:
            # read late by nobody knows how much, and frames without numbers may be missing
            return round(by_rate_ns), math.ceil(apart_ns)
        if abs(by_host_ns) < usual.allowed_by_arrival_ns:
            # the camera lost frames that have no number, and its clock is right
            return 0, 0
        return round(by_host_ns), round(usual.scatter_ns)

    def _step_by_arrivals(self, last: Frame) -> tuple[int, int] | None:
        """What has happened where the rate is no help, which may have changed: the newest frames were waited
        for, and say together how far the clock is off; None where they say nothing in common.
        """
        usual = self._usual
        if not usual.is_regular or math.isnan(usual.delay_ns):
            return None
        early_ns = [usual.early_ns(one.frame) for one in self._waiting[-1 - _ALIKE :]]
        step_ns = round(max(early_ns))
        # if there is no room to wait for more, times that rise as a camera's do are believed
        if not self._reader_is_up or abs(step_ns) < usual.allowed_by_arrival_ns:
            step_ns = 0
        if self._reader_is_up and max(early_ns) - min(early_ns) > usual.allowed_by_arrival_ns:
            return None
        if len(self._rising(last, step_ns).kept) < 0.5 * len(self._waiting):
            return None
        return step_ns, round(usual.scatter_ns) if step_ns else 0

    def _stepped(self, last: Frame, step_ns: int, u_ns: int) -> NumberedFrames:
        """What waits agrees: the clock has stepped, and goes on from where it would be."""
        rising = self._rising(last, step_ns)
        waiting, first = len(self._waiting), rising.first_after_step
        first = waiting if first is None else first
        before = self._waiting[min(first, waiting - 1)].frame.sequence
        frames, notes, left_out = self._settled(rising.kept, first, step_ns)
        if not step_ns:
            return NumberedFrames(frames, notes)
        self._offset_ns -= step_ns
        again = step_ns < 0 and any(abs(step_ns - ns) < MAX_READING_DELAY_NS for ns in self._steps_ns)
        self._steps_ns.append(step_ns)
        after = [one for one, place in zip(frames, rising.kept, strict=True) if place >= first]
        # a counter's new round is known exactly, and no step of the clock
        steps = (RecordedClockStep(after[0].time_ns, step_ns, u_ns),) if after and u_ns else ()
        self.wraps += again
        if again and self.wraps > 1:
            return NumberedFrames(frames, notes, steps)
        said = f"the camera's counter begins again every {-seconds(step_ns):.4g} s; its times continue"
        if not again:
            said = (
                f"the camera's clock stepped by {seconds(step_ns):+.6g} s (u {seconds(max(u_ns, 1)):.1g} s) "
                f"before frame {before}; its times continue without the step"
                + (f", {_frames(left_out)} left out" if left_out else "")
            )
        return NumberedFrames(frames, ((EventKind.CAMERA_CLOCK, said),), steps)

    def _give_up(self) -> NumberedFrames:
        """No two of the times agree: from here on they are the computer's, at the camera's rate."""
        self._given_up = True
        waited, notes = [one.frame for one in self._waiting], list[tuple[EventKind, str]]()
        if (last := self._before_gap) is not None:
            notes.append(self._go_on(waited[0], last)[0])
            waited = [one._replace(sequence=one.sequence + self._from_number) for one in waited]
            self._usual.delay_ns = float(last.host_time_ns - last.device_time_ns)
        elif math.isnan(self._usual.delay_ns):
            self._usual.delay_ns = 0.0
        frames, shown_ns = [self._usual.time_by_arrival(one) for one in waited], self._waiting[0].shown_ns
        self._waiting.clear()
        u_ns = round(self._usual.scatter_ns)
        said = (
            f"the camera's clock is abandoned from frame {waited[0].sequence} on, where it shows "
            f"{shown_ns} ns: times are the computer's, u {seconds(u_ns):.1g} s; restart "
            "the camera before the next run"
        )
        step = RecordedClockStep(frames[0].time_ns, 0, u_ns)
        return NumberedFrames(frames, (*notes, (EventKind.CAMERA_CLOCK, said)), (step,))

    def _settled(
        self, kept: Collection[int], first: int = 0, step_ns: int = 0
    ) -> tuple[list[Frame], tuple[tuple[EventKind, str], ...], int]:
        """Those that waited and are `kept`, from the `first` on without the step; what is said of the others,
        and their number.
        """
        frames, alone, kept = [], [], set(kept)
        for place, one in enumerate(self._waiting):
            if place not in kept:
                alone.append(one)
                continue
            time_ns = one.frame.device_time_ns - (step_ns if place >= first else 0)
            frames.append(self._usual.learn(one.frame._replace(device_time_ns=time_ns)))
        self._waiting.clear()
        self.rejected += len(alone)
        if not alone:
            return frames, (), 0
        frame, off_ns, shown_ns = alone[0]
        off = "no time" if math.isinf(off_ns) else f"{S_PER_NS * off_ns:+.3g} s from what both clocks say"
        said = (
            f"{_frames(len(alone))} left out from frame {frame.sequence} on: the camera's time "
            f"{shown_ns} ns is {off}"
        )
        return frames, ((EventKind.CAMERA_CLOCK, said),), len(alone)


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"
