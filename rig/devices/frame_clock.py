"""The camera's clock as an instrument that is read with every frame: outliers, steps and wraps of its times.

A frame's time is expected from the one before it: by the frame time that was learned and the numbers between,
or, of a camera that keeps no rate, by the computer's clock. A frame can arrive late by any time and early by
none, so that neither clock alone tells a step. What both contradict waits until the next frames tell a single
wrong time, which is left out and counted, from a step, which is taken off all times that follow.
"""

from typing import NamedTuple

from acquisition.frame import Frame
from processing.ticks import S_PER_NS, seconds
from rig.devices.host_clock import NO_TIME_NS

_LEARNED = 8
"""Frames after which the frame time is known."""
_ALIKE = 3
"""Frames that agree on a step, until it is believed."""
_SMOOTHING = 0.1
_LEAST_NS = 2_000_000.0
"""Smaller disagreements are those of the computer's readings of frames, or of the exposure."""
_BY_HOST_NS = 60_000_000.0
"""Disagreements with the computer's clock that late readings explain."""
_REGULAR = 0.2
"""Mean deviation of frame times, of one, up to which a camera keeps a rate."""


class Seen(NamedTuple):
    """Frames whose times hold, and what is to be said."""

    frames: list[Frame]
    note: str = ""


class FrameClock:
    """Joins the times of one camera, frame by frame, to a line that never steps.

    `rejected` counts frames whose times fitted nothing, `wraps` the times that a counter began again.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.wraps = 0
        self._steps_ns: list[float] = []
        self._offset_ns = 0
        self.begin_again()

    def begin_again(self) -> None:
        """The camera was opened again: whatever its clock shows now is new."""
        self._last: Frame | None = None
        self._interval_ns = self._deviation_ns = 0.0
        self._learned = 0
        self._waiting: list[tuple[Frame, float]] = []
        self._offset_ns = 0

    def take(self, frame: Frame) -> Seen:
        """The frames that may go on: none, while a step is in doubt, or several once it is not."""
        if frame.device_time_ns < 0:
            return Seen([frame])
        if frame.device_time_ns >= NO_TIME_NS:
            self.rejected += 1
            told = self.rejected == 1
            return Seen([], f"frames without a time are left out: {frame.device_time_ns} ns" if told else "")
        moved = frame._replace(device_time_ns=frame.device_time_ns + self._offset_ns)
        last = self._last
        if last is None:
            return self._joined(moved)
        off_ns = self._off_ns(moved, last)
        if off_ns is None:
            # those that waited were alone
            self.rejected += len(self._waiting)
            note = self._about_rejected() if self._waiting else ""
            self._waiting.clear()
            return self._joined(moved, note)
        allowed_ns = max(_LEAST_NS, 10 * self._deviation_ns) if self._regular else _BY_HOST_NS
        self._waiting = [one for one in self._waiting if abs(one[1] - off_ns) < allowed_ns]
        before = len(self._waiting)
        self._waiting.append((frame, off_ns))
        if before + 1 < _ALIKE:
            return Seen([])
        return self._stepped(allowed_ns)

    @property
    def waiting(self) -> int:
        """Frames whose times are in doubt."""
        return len(self._waiting)

    @property
    def _regular(self) -> bool:
        return self._learned >= _LEARNED and self._deviation_ns < _REGULAR * self._interval_ns

    def _off_ns(self, frame: Frame, last: Frame) -> float | None:
        """How far a time lies from what is expected of it; None where one of the clocks confirms it."""
        passed_ns = float(frame.device_time_ns - last.device_time_ns)
        by_host_ns = float(frame.host_time_ns - last.host_time_ns)
        numbers = frame.sequence - last.sequence
        by_rate_ns = numbers * self._interval_ns if numbers > 0 else by_host_ns
        if not self._regular:
            # it came when the computer says, or was read late
            return None if 0 < passed_ns <= by_host_ns + _BY_HOST_NS else passed_ns - by_host_ns
        off_ns = passed_ns - by_rate_ns
        allowed_ns = max(_LEAST_NS, 10 * self._deviation_ns)
        # a camera may change its rate, and lose frames that have no number
        by_either = abs(off_ns) < allowed_ns or abs(passed_ns - by_host_ns) < 0.5 * abs(off_ns)
        return None if passed_ns > 0 and by_either else off_ns

    def _joined(self, frame: Frame, note: str = "") -> Seen:
        last, self._last = self._last, frame
        if last is not None and frame.sequence > last.sequence:
            each_ns = (frame.device_time_ns - last.device_time_ns) / (frame.sequence - last.sequence)
            if self._learned:
                self._deviation_ns += _SMOOTHING * (abs(each_ns - self._interval_ns) - self._deviation_ns)
            self._interval_ns += (_SMOOTHING if self._learned else 1.0) * (each_ns - self._interval_ns)
            self._learned += 1
        return Seen([frame], note)

    def _stepped(self, u_ns: float) -> Seen:
        """What waits agrees: the clock has stepped, and goes on from where it would be."""
        first, last = self._waiting[0][0], self._last
        assert last is not None
        step_ns = sum(off_ns for _, off_ns in self._waiting) / len(self._waiting)
        self._offset_ns -= round(step_ns)
        waited, self._waiting = self._waiting, []
        frames = []
        for frame, _ in waited:
            moved = frame._replace(device_time_ns=frame.device_time_ns + self._offset_ns)
            frames += self._joined(moved).frames
        u_s = S_PER_NS * (self._deviation_ns + 1.0 if self._regular else u_ns)
        again = step_ns < 0 and any(abs(step_ns - before) < _BY_HOST_NS for before in self._steps_ns)
        self._steps_ns.append(step_ns)
        if again:
            self.wraps += 1
            counter = f"the camera's counter begins again every {-S_PER_NS * step_ns:.4g} s; its times go on"
            return Seen(frames, counter if self.wraps == 1 else "")
        return Seen(
            frames,
            f"the camera's clock stepped by {seconds(round(step_ns)):+.6g} s (u {u_s:.1g} s) before frame "
            f"{first.sequence}; its times go on from where they would be",
        )

    def _about_rejected(self) -> str:
        frame, off_ns = self._waiting[0]
        return (
            f"{len(self._waiting)} frames left out from frame {frame.sequence} on: the camera's time "
            f"{frame.device_time_ns} ns is {seconds(round(off_ns)):+.3g} s from what both clocks say"
        )
