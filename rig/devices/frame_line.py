"""The one line of numbers and times that a camera's frames keep, also where it was opened again."""

from acquisition.frame import Frame
from processing.ticks import S_PER_NS, seconds
from rig.devices.frame_clock import ClockStep

_NAMED_AFTER_S = 0.35
_CLOCK_STEP_NS = 1_000_000_000
_U_BY_HOST_NS = 2_000_000
"""Of the computer's readings of two frames."""
_SMOOTHING = 0.1


class FrameLine:
    """The one place where a frame gets the number and the time that hold from here on.

    `time_shift_ns` moves the camera's timestamps to the middle of the exposure. A camera that is opened again
    numbers its frames from 0, and its clock may have been reset. The frames after the gap get the numbers
    that follow from the time elapsed, so that missing frames are counted. A clock that was reset is shifted
    by a constant, so that it continues consistently with the host's clock; the shift is reported. `missing`
    is the number of frames missed while the camera was disconnected. `in_real_time`: a gap is as long as the
    host's clock says; simulated time may pass more quickly.
    """

    def __init__(self, time_shift_ns: int = 0, *, in_real_time: bool = False) -> None:
        self._in_real_time = in_real_time
        self._step: ClockStep | None = None
        self._last: Frame | None = None
        self._interval_ns = 0.0
        self._offset = 0
        self._to_middle_ns = time_shift_ns
        self._continued_ns = 0
        self._reopened = False
        self.missing = 0

    def patience_s(self, without_s: float) -> float:
        """Time without a frame that is still normal: two frame times and a margin; `without_s` at the start.

        With this margin an interruption is reported within two frame times plus 0.5 s.
        """
        return 2 * S_PER_NS * self._interval_ns + _NAMED_AFTER_S if self._interval_ns else without_s

    def begin_again(self) -> None:
        """The camera was opened again: the next frame is its first."""
        self._reopened = self._last is not None

    def take_step(self) -> ClockStep | None:
        """The step of the camera's clock before the last frame, where it was opened again."""
        step, self._step = self._step, None
        return step

    def join(self, frame: Frame) -> tuple[Frame, str]:
        """The frame with its number and time in this line; a note with the first after a gap."""
        last, note = self._last, ""
        middle_ns = frame.device_time_ns
        if middle_ns >= 0:
            middle_ns = max(middle_ns + self._to_middle_ns, 0)
        if self._reopened and last is not None:
            note = self._find_offsets(frame.sequence, middle_ns, frame.host_time_ns, last)
            self._reopened = False
        if middle_ns >= 0:
            middle_ns += self._continued_ns
        if self._offset or middle_ns != frame.device_time_ns:
            frame = frame._replace(sequence=frame.sequence + self._offset, device_time_ns=middle_ns)
        if last is not None and not note:
            self._learn_interval(frame, last)
        self._last = frame
        return frame, note

    def _learn_interval(self, frame: Frame, last: Frame) -> None:
        steps, passed_ns = frame.sequence - last.sequence, frame.time_ns - last.time_ns
        if steps > 0 and passed_ns > 0:
            now_ns = passed_ns / steps
            self._interval_ns += (_SMOOTHING if self._interval_ns else 1.0) * (now_ns - self._interval_ns)

    def _find_offsets(self, number: int, middle_ns: int, host_ns: int, last: Frame) -> str:
        passed_ns = by_host_ns = host_ns - last.host_time_ns
        self._continued_ns = 0
        shifted = ""
        if middle_ns >= 0:
            passed_ns = middle_ns - last.device_time_ns
            # a clock that began again is behind, or anywhere where another one sets it
            differs = self._in_real_time and abs(passed_ns - by_host_ns) > _CLOCK_STEP_NS
            if differs or passed_ns <= 0:
                self._continued_ns, passed_ns = by_host_ns - passed_ns, by_host_ns
                self._step = ClockStep(-self._continued_ns, _U_BY_HOST_NS)
                shifted = f"; its clock restarted, {self._continued_ns} ns are added to its times"
        missing = max(round(passed_ns / (self._interval_ns or passed_ns)) - 1, 0)
        self._offset = last.sequence + 1 + missing - number
        self.missing += missing
        passed = f"{seconds(passed_ns):.3f} s without frames, about {missing} of them"
        return f"opened again after {passed}{shifted}"
