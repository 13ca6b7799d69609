"""The final number and time of each frame, which are assigned in this module only.

A frame's time is predicted from the frame before it: by the learned frame interval and the difference of the
numbers, or, for a camera that keeps no rate, by the computer's clock. A frame can arrive late by any amount
but never early, so that neither clock alone reveals a step. A frame that both clocks contradict waits until
the next frames show whether its time alone was wrong (it is left out and counted) or the clock stepped (the
step is subtracted from all later times). A clock with no consistent times is abandoned.
"""

import math
from collections import deque
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

_AGREEING_FRAMES = 3
"""Number of frames that must agree on a step before it is accepted."""
_MAX_WAITING = 12
"""Number of doubtful frames (each holds an image) that forces a decision, unless the reader is behind."""
_MAX_WAITING_BEHIND = 2000
"""As `_MAX_WAITING`, for a reader that is behind, whose frames do not show when they came."""
_MAX_WAITING_BYTES = 64 * 1024 * 1024
"""Memory of doubtful frames that forces a decision, too, where the reader is behind."""
_MAX_QUEUED_DELAY_NS = 800_000_000.0
"""As `MAX_READING_DELAY_NS`, for a frame that lay in the driver until it was read."""
_COUNTER_PERIODS_NS: Final = tuple((1 << 32) * tick_ns for tick_ns in (1, 8, 10, 16, 20, 40, 100, 1000))
"""Times after which a counter of 32 bits begins again, for usual lengths of its tick."""
_SILENCE_MARGIN_S = 0.35
"""Addition to two frame intervals, so that an interruption is reported within 0.5 s of them."""
_MIN_CLOCK_RESET_NS = 1_000_000_000
"""Smallest disagreement of the two clocks over a gap that means that the camera's was reset in it."""
_U_BY_HOST_NS = 2_000_000
"""Standard uncertainty of the time between two frames by the computer's clock."""


class _DoubtfulFrame(NamedTuple):
    """A frame whose time is in doubt."""

    frame: Frame
    off_ns: float
    """Deviation of its time from the expected time."""
    camera_ns: int
    """Its time as the camera stated it."""


class FrameLine:
    """One continuous series of frame numbers and times of a camera, also where it was opened again.

    `time_shift_ns` moves the camera's timestamps to the middle of the exposure. A camera that is opened again
    numbers its frames from 0, and its clock may have been reset: the numbers continue by the time elapsed, so
    that missing frames are counted, and the times by a constant, which is reported as a step. Times of frames
    that are not `in_real_time` are taken as they are; they may pass more quickly than the computer's.

    Each frame is checked first, and a clock that cannot be right is refused (`guard`).

    Attributes
    ----------
    events
        Kinds and texts of events of the camera's clock, until they are taken.
    steps
        Steps of the clock that were subtracted, until they are taken, each with the time of the frame after
        it. A step of 0 means that the clock was abandoned; its uncertainty is then that of each later time.
    missing
        Number of frames missed while the camera was gone.
    rejected
        Number of frames whose times fitted neither clock.
    wraps
        Number of times that a counter of the camera began again.
    """

    def __init__(self, time_shift_ns: int = 0, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._to_middle_ns = time_shift_ns
        self._checks = FrameChecks(in_real_time=in_real_time)
        self._clock_check = ClockCheck()
        self._timing = FrameTiming()
        self._waiting: list[_DoubtfulFrame] = []
        self._before_gap: Frame | None = None
        self._number_offset = self._offset_ns = 0
        self._clock_abandoned = False
        self._steps_ns: list[float] = []
        self.events: deque[tuple[EventKind, str]] = deque()
        self.steps: deque[RecordedClockStep] = deque()
        self.missing = self.rejected = self.wraps = 0

    def patience_s(self, initial_s: float) -> float:
        """Longest normal time without a frame: two frame intervals and a margin; `initial_s` at the start."""
        usual_ns = self._timing.interval_ns
        return 2 * S_PER_NS * usual_ns + _SILENCE_MARGIN_S if usual_ns else initial_s

    def restart(self) -> None:
        """Take account of a camera that was opened again: the next frame is its first, its clock is new."""
        self._checks.restart()
        self._clock_check.restart()
        self._before_gap = self._timing.last or self._before_gap
        self._timing.restart()
        self.rejected += len(self._waiting)
        self._waiting.clear()
        self._offset_ns = 0
        self._clock_abandoned = False

    def take(self, item: object) -> list[Frame]:
        """Frames with final numbers and times after `item` was read: none while a step is in doubt, several
        afterwards.

        Raises DeviceError, in one line, for a frame or a clock that `guard` refuses.
        """
        frame = self._checks.check(item)
        if self._in_real_time:
            self._clock_check.see(frame)
        camera_ns = frame.device_time_ns
        has_time = 0 <= camera_ns < NO_TIME_NS
        before_gap, timing = self._before_gap, self._timing
        if before_gap is not None and (camera_ns < NO_TIME_NS or not self._in_real_time):
            self._go_on_after_gap(frame, before_gap)
        time_ns = self._middle_ns(frame) + self._offset_ns if has_time else camera_ns
        if self._number_offset or time_ns != camera_ns:
            frame = Frame(frame.image, frame.sequence + self._number_offset, time_ns, frame.host_time_ns)
        if self._clock_abandoned and camera_ns >= 0:
            return [timing.time_by_arrival(frame)]
        if camera_ns >= 0 and self._in_real_time:
            off_ns = math.inf if timing.last is None or not has_time else self._off_ns(frame, timing.last)
            if off_ns is not None and (timing.last is not None or not has_time):
                return self._hold_back(_DoubtfulFrame(frame, off_ns, camera_ns))
            if self._waiting:
                return self._release_confirmed(frame)
        timing.learn(frame)
        return [frame]

    @property
    def waiting(self) -> int:
        """Number of frames whose times are in doubt."""
        return len(self._waiting)

    def _go_on_after_gap(self, frame: Frame, last: Frame) -> None:
        """Let number and time of the first frame after a gap follow those of the last one before it."""
        self._before_gap = None
        passed_ns = by_host_ns = frame.host_time_ns - last.host_time_ns
        remark = ""
        if 0 <= frame.device_time_ns < NO_TIME_NS:
            by_device_ns = self._middle_ns(frame) - last.device_time_ns
            # a clock that began again is behind, or far off if it is set by another clock
            differs = self._in_real_time and abs(by_device_ns - by_host_ns) > _MIN_CLOCK_RESET_NS
            if differs or by_device_ns <= 0:
                self._offset_ns = by_host_ns - by_device_ns
                after_ns = last.device_time_ns + by_host_ns
                self.steps.append(RecordedClockStep(after_ns, -self._offset_ns, _U_BY_HOST_NS))
                remark = f"; its clock restarted, {self._offset_ns} ns are added to its times"
            else:
                passed_ns = by_device_ns
        usual_ns = self._timing.interval_ns
        missing = max(round(passed_ns / usual_ns) - 1, 0) if usual_ns else 0
        self._number_offset = last.sequence + 1 + missing - frame.sequence
        self.missing += missing
        gap = f"{seconds(passed_ns):.3f} s without frames, about {missing} of them"
        self.events.append((EventKind.CAMERA_BACK, f"opened again after {gap}{remark}"))

    def _middle_ns(self, frame: Frame) -> int:
        return max(frame.device_time_ns + self._to_middle_ns, 0)

    def _hold_back(self, doubtful: _DoubtfulFrame) -> list[Frame]:
        """Keep a frame whose time neither clock confirms, until the next frames explain it."""
        self._waiting.append(doubtful)
        last, allowed_ns = self._timing.last, self._timing.allowed_ns
        agreeing = [other for other in self._waiting if abs(other.off_ns - doubtful.off_ns) < allowed_ns]
        must_decide = len(self._waiting) >= _MAX_WAITING and (self._reader_keeps_up or self._is_full)
        if len(agreeing) >= _AGREEING_FRAMES and last is not None:
            step = self._agreed_step(agreeing, last, must_decide=must_decide)
            return [] if step is None else self._release_after_step(last, *step)
        if not must_decide:
            return []
        step = None if last is None else self._step_by_arrivals(last)
        if last is None or step is None:
            return self._abandon_clock()
        return self._release_after_step(last, *step)

    @property
    def _reader_keeps_up(self) -> bool:
        """Whether the newest frames were waited for; a reader that hung, even twice, takes many at once."""
        arrivals_ns = [doubtful.frame.host_time_ns for doubtful in self._waiting[-1 - _AGREEING_FRAMES :]]
        return all(later - sooner > 0.5 * self._timing.interval_ns for sooner, later in pairwise(arrivals_ns))

    @property
    def _is_full(self) -> bool:
        """Whether no more frames may wait for their reader."""
        waiting = len(self._waiting)
        size = waiting * self._waiting[-1].frame.image.nbytes
        return waiting >= _MAX_WAITING_BEHIND or (waiting >= 4 * _MAX_WAITING and size >= _MAX_WAITING_BYTES)

    def _off_ns(self, frame: Frame, last: Frame) -> float | None:
        """Deviation of a time from the expected one in ns; None where one of the clocks confirms the time."""
        timing = self._timing
        passed_ns = float(frame.device_time_ns - last.device_time_ns)
        by_host_ns = float(frame.host_time_ns - last.host_time_ns)
        numbers = frame.sequence - last.sequence
        by_rate_ns = numbers * timing.interval_ns if numbers > 0 else by_host_ns
        off_ns = passed_ns - by_rate_ns
        if timing.is_regular:
            is_confirmed = abs(off_ns) < timing.allowed_ns or self._host_confirms(frame, last, off_ns)
            return None if passed_ns > 0 and is_confirmed else off_ns
        # an irregular camera's frame came at its arrival, or was read late; the frame before may also have
        # been read late, if both had gathered in the driver
        delay_ns = MAX_READING_DELAY_NS if timing.last_read_at_arrival else _MAX_QUEUED_DELAY_NS
        fits_rate = timing.intervals > 0 and abs(off_ns) < MAX_IRREGULARITY * by_rate_ns
        is_confirmed = passed_ns > 0 and (passed_ns <= by_host_ns + delay_ns or fits_rate)
        return None if is_confirmed else passed_ns - by_host_ns

    def _host_confirms(self, frame: Frame, last: Frame, off_ns: float) -> bool:
        """Whether the computer's clock confirms a time that the camera's rate does not: the rate may change,
        or frames without numbers be lost. When a frame came that was read late, the computer does not know.
        """
        timing = self._timing
        previous = self._waiting[-1].frame if self._waiting else last
        passed_ns = frame.device_time_ns - previous.device_time_ns
        by_host_ns = frame.host_time_ns - previous.host_time_ns
        if passed_ns <= 0 or by_host_ns < 0.5 * min(passed_ns, timing.interval_ns):
            return False
        early_ns = abs(timing.early_ns(frame))
        if timing.last_read_at_arrival:
            by_last_ns = frame.device_time_ns - last.device_time_ns - frame.host_time_ns + last.host_time_ns
            early_ns = min(early_ns, abs(by_last_ns))
        return early_ns < min(timing.allowed_by_arrival_ns, 0.5 * abs(off_ns))

    def _release_confirmed(self, frame: Frame) -> list[Frame]:
        """Release the waiting frames after a frame whose time one of the clocks confirms.

        Usually the waiting times are wrong, and are left out. Those that rise to this frame's are kept, if
        the computer confirms it and the rate does not: then frames without numbers are missing, or the rate
        has changed, and the waiting frames were read too late to be confirmed.
        """
        timing, last, indices = self._timing, self._timing.last, list[int]()
        if last is not None and timing.is_regular:
            by_rate_ns = (frame.sequence - last.sequence) * timing.interval_ns
            off_ns = frame.device_time_ns - last.device_time_ns - by_rate_ns
            if len(self._waiting) >= _AGREEING_FRAMES or abs(off_ns) >= timing.allowed_ns:
                times_ns = [doubtful.frame.device_time_ns for doubtful in self._waiting]
                sooner = {i for i, time_ns in enumerate(times_ns) if time_ns < frame.device_time_ns}
                indices = [i for i in self._rising(last, newest=[frame]).consistent if i in sooner]
        frames = self._release_waiting(indices)
        timing.learn(frame)
        return [*frames, frame]

    def _rising(self, last: Frame, step_ns: int = 0, newest: Iterable[Frame] = ()) -> RisingTimes:
        frames = [*(doubtful.frame for doubtful in self._waiting), *newest]
        return rising_times(
            [float(frame.device_time_ns - last.device_time_ns) for frame in frames],
            [frame.sequence - last.sequence for frame in frames],
            self._timing.interval_ns,
            float(step_ns),
        )

    def _agreed_step(
        self, agreeing: list[_DoubtfulFrame], last: Frame, *, must_decide: bool
    ) -> tuple[int, int] | None:
        """A step and its standard uncertainty, in ns: by the rate if the computer agrees, else by the
        computer, as frames without numbers may be missing. None while late reading may explain it.
        """
        timing = self._timing
        by_host_ns = max(timing.early_ns(doubtful.frame) for doubtful in agreeing)
        if not timing.is_regular:
            # times must rise from the last one, however late that was read
            beyond_ns = max(by_host_ns - (agreeing[0].frame.device_time_ns - last.device_time_ns - 1), 0.0)
            return round(by_host_ns - beyond_ns), round(timing.scatter_ns + beyond_ns)
        by_rate_ns = sum(doubtful.off_ns for doubtful in agreeing) / len(agreeing)
        for period_ns in _COUNTER_PERIODS_NS:
            if abs(by_rate_ns + period_ns) < timing.allowed_ns:
                return -period_ns, 0
        difference_ns = abs(by_rate_ns - by_host_ns)
        if difference_ns < min(timing.allowed_by_arrival_ns, 0.5 * abs(by_rate_ns)):
            numbers = max(agreeing[-1].frame.sequence - last.sequence, 1)
            return round(by_rate_ns), math.ceil(timing.deviation_ns * (1.0 + SMOOTHING * numbers) + 1.0)
        if not must_decide:
            return None
        if not self._reader_keeps_up:
            # read late by an unknown time, and frames without numbers may be missing
            return round(by_rate_ns), math.ceil(difference_ns)
        if abs(by_host_ns) < timing.allowed_by_arrival_ns:
            # the camera lost frames that have no number, and its clock is right
            return 0, 0
        return round(by_host_ns), round(timing.scatter_ns)

    def _step_by_arrivals(self, last: Frame) -> tuple[int, int] | None:
        """A step and its standard uncertainty, in ns, from the arrivals of the newest frames, which were read
        as they arrived; for a rate that may have changed. None where these frames do not agree.
        """
        timing = self._timing
        if not timing.is_regular or math.isnan(timing.delay_ns):
            return None
        newest = self._waiting[-1 - _AGREEING_FRAMES :]
        early_ns = [timing.early_ns(doubtful.frame) for doubtful in newest]
        step_ns = round(max(early_ns))
        # no more frames can wait for a late reader: regularly rising times are accepted without a step
        if not self._reader_keeps_up or abs(step_ns) < timing.allowed_by_arrival_ns:
            step_ns = 0
        if self._reader_keeps_up and max(early_ns) - min(early_ns) > timing.allowed_by_arrival_ns:
            return None
        if len(self._rising(last, step_ns).consistent) < 0.5 * len(self._waiting):
            return None
        return step_ns, round(timing.scatter_ns) if step_ns else 0

    def _release_after_step(self, last: Frame, step_ns: int, u_ns: int) -> list[Frame]:
        """Release the waiting frames, which agree on a step of the clock, with the step subtracted."""
        rising = self._rising(last, step_ns)
        waiting, first = len(self._waiting), rising.first_after_step
        first = waiting if first is None else first
        first_number = self._waiting[min(first, waiting - 1)].frame.sequence
        if not step_ns:
            return self._release_waiting(rising.consistent, first)
        frames = self._release_waiting(rising.consistent, first, step_ns)
        self._offset_ns -= step_ns
        is_wrap = step_ns < 0 and any(abs(step_ns - ns) < MAX_READING_DELAY_NS for ns in self._steps_ns)
        self._steps_ns.append(step_ns)
        later = [frame for frame, i in zip(frames, rising.consistent, strict=True) if i >= first]
        # a counter that began again (u is 0) is known exactly, and is not recorded as a step of the clock
        if later and u_ns:
            self.steps.append(RecordedClockStep(later[0].time_ns, step_ns, u_ns))
        self.wraps += is_wrap
        if not is_wrap:
            self._tell(
                f"the camera's clock stepped by {seconds(step_ns):+.6g} s (u {seconds(max(u_ns, 1)):.1g} s) "
                f"before frame {first_number}; its times continue without the step"
            )
        elif self.wraps == 1:
            every_s = -seconds(step_ns)
            self._tell(f"the camera's counter begins again every {every_s:.4g} s; its times continue")
        return frames

    def _abandon_clock(self) -> list[Frame]:
        """Abandon a clock whose times disagree: later times are the computer's, at the camera's rate."""
        self._clock_abandoned = True
        waiting = [doubtful.frame for doubtful in self._waiting]
        if (last := self._before_gap) is not None:
            self._go_on_after_gap(waiting[0], last)
            waiting = [frame._replace(sequence=frame.sequence + self._number_offset) for frame in waiting]
            self._timing.delay_ns = float(last.host_time_ns - last.device_time_ns)
        elif math.isnan(self._timing.delay_ns):
            self._timing.delay_ns = 0.0
        frames, camera_ns = list(map(self._timing.time_by_arrival, waiting)), self._waiting[0].camera_ns
        self._waiting.clear()
        u_ns = round(self._timing.scatter_ns)
        self._tell(
            f"the camera's clock is abandoned from frame {waiting[0].sequence} on, where it shows "
            f"{camera_ns} ns: times are the computer's, u {seconds(u_ns):.1g} s; restart "
            "the camera before the next run"
        )
        self.steps.append(RecordedClockStep(frames[0].time_ns, 0, u_ns))
        return frames

    def _release_waiting(self, indices: Collection[int], first: int = 0, step_ns: int = 0) -> list[Frame]:
        """The waiting frames of these indices, from `first` on without the step; the others are left out."""
        frames, rejected, indices = [], [], set(indices)
        for i, doubtful in enumerate(self._waiting):
            if i not in indices:
                rejected.append(doubtful)
                continue
            time_ns = doubtful.frame.device_time_ns - (step_ns if i >= first else 0)
            frames.append(doubtful.frame._replace(device_time_ns=time_ns))
            self._timing.learn(frames[-1])
        self._waiting.clear()
        self.rejected += len(rejected)
        if rejected:
            frame, off_ns, camera_ns = rejected[0]
            off = "no time" if math.isinf(off_ns) else f"{S_PER_NS * off_ns:+.3g} s from what both clocks say"
            count = "1 frame" if len(rejected) == 1 else f"{len(rejected)} frames"
            from_frame = f"{count} left out from frame {frame.sequence} on"
            self._tell(f"{from_frame}: the camera's time {camera_ns} ns is {off}")
        return frames

    def _tell(self, text: str) -> None:
        self.events.append((EventKind.CAMERA_CLOCK, text))
