"""Continuous frame numbers and times over several starts of a camera, as after it was unplugged."""

from acquisition.frame import Frame
from processing.ticks import seconds

_NAMED_AFTER_S = 0.35
_CLOCK_STEP_NS = 1_000_000_000
_SMOOTHING = 0.1


class FrameLine:
    """Continues numbers and times of frames after a reconnection.

    A camera that is opened again numbers its frames from 0, and its clock may have been reset. The frames
    after the gap get the numbers that follow from the time elapsed, so that missing frames are counted. A
    clock that was reset is shifted by a constant, so that it continues consistently with the host's clock;
    the shift is reported. `missing` is the number of frames missed while the camera was disconnected.
    """

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._interval_ns = 0.0
        self._offset = 0
        self._shift_ns = 0
        self._anew = False
        self.missing = 0

    def patience_s(self, without_s: float) -> float:
        """Time without a frame that is still normal: two frame times and a margin; `without_s` at the start.

        With this margin an interruption is reported within two frame times plus 0.5 s.
        """
        return 2e-9 * self._interval_ns + _NAMED_AFTER_S if self._interval_ns else without_s

    def begin_anew(self) -> None:
        """The camera was opened again: the next frame is its first."""
        self._anew = self._last is not None

    def join(self, frame: Frame) -> tuple[Frame, str]:
        """The frame with its number and time in this line; a note with the first after a gap."""
        note = ""
        if self._anew and self._last is not None:
            note = self._find_offsets(frame, self._last)
            self._anew = False
        elif self._last is not None:
            self._learn_interval(frame, self._last)
        if self._offset or self._shift_ns:
            device_time_ns = frame.device_time_ns
            if device_time_ns >= 0:
                device_time_ns += self._shift_ns
            frame = frame._replace(sequence=frame.sequence + self._offset, device_time_ns=device_time_ns)
        self._last = frame
        return frame, note

    def _learn_interval(self, frame: Frame, last: Frame) -> None:
        steps = frame.sequence + self._offset - last.sequence
        passed_ns = frame.time_ns + (self._shift_ns if frame.device_time_ns >= 0 else 0) - last.time_ns
        if steps > 0 and passed_ns > 0:
            now_ns = passed_ns / steps
            self._interval_ns += (_SMOOTHING if self._interval_ns else 1.0) * (now_ns - self._interval_ns)

    def _find_offsets(self, frame: Frame, last: Frame) -> str:
        by_host_ns = frame.host_time_ns - last.host_time_ns
        passed_ns = by_host_ns
        self._shift_ns = 0
        shifted = ""
        if frame.device_time_ns >= 0:
            passed_ns = frame.device_time_ns - last.device_time_ns
            # simulated time may pass more quickly than the host's, a clock that began anew is behind it
            if passed_ns < by_host_ns - _CLOCK_STEP_NS or passed_ns <= 0:
                self._shift_ns = by_host_ns - passed_ns
                passed_ns = by_host_ns
                shifted = f"; its clock began anew, {self._shift_ns} ns are added to its times"
        interval_ns = self._interval_ns or passed_ns
        missing = max(round(passed_ns / interval_ns) - 1, 0)
        self._offset = last.sequence + 1 + missing - frame.sequence
        self.missing += missing
        return (
            f"opened again after {seconds(passed_ns):.3f} s without frames, about {missing} of them{shifted}"
        )
