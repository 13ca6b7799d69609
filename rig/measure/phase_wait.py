"""Waits for a phase before the record: until it is reached, times out, or the run is stopped."""

from collections.abc import Callable

from acquisition.record.events import Event, EventKind
from processing.errors import DataError
from processing.ticks import NS_PER_S, seconds
from rig.instrument import Phase, Snapshot
from rig.measure.end_of_run import StopRequest
from rig.measure.recent_frames import RecentFrames

NO_SPOT = "no spot is seen: look at the laser, the beam's path and the camera's region"
_SPOTLESS_S = 3.0


class Stopped(Exception):
    """The operator stopped the wait, or the frames have ended."""


class PhaseWait:
    """Waits for one phase after another: takes frames, reports the state, collects events.

    `progress` is a text that describes the progress of the present phase.
    """

    def __init__(
        self,
        frames: RecentFrames,
        report: Callable[[Snapshot], None],
        stop: StopRequest,
    ) -> None:
        self.frames = frames
        self._report = report
        self._stop = stop
        self.progress = ""
        self.events: list[Event] = []

    def note(self, kind: EventKind, text: str) -> None:
        """Add an event at the time of the newest frame."""
        self.events.append(Event(self.frames.now_ns, kind, text))

    def until_reached(
        self,
        phase: Phase,
        limit_s: float,
        reached: Callable[[], bool],
        instruction: str = "",
        every_s: float = 0.0,
    ) -> None:
        """Take frames until `reached` returns True; it is called every `every_s` seconds.

        Raises DataError after `limit_s`, and `Stopped` if the run is stopped or the frames end.
        """
        frames = self.frames
        begun_ns = frames.now_ns
        asked_ns = -(10**18)
        self.progress = ""
        while True:
            if self._stop or not frames.advance():
                self.note(EventKind(phase), "stopped")
                raise Stopped
            begun_ns = begun_ns or frames.now_ns
            elapsed_s = seconds(frames.now_ns - begun_ns)
            if frames.spotless_s > _SPOTLESS_S:
                self.progress = f"no spot is seen for {frames.spotless_s:.0f} s"
            shout = NO_SPOT if frames.spotless_s > _SPOTLESS_S else instruction
            self._report(Snapshot(phase, self.progress, elapsed_s, instruction=shout))
            due = frames.now_ns - asked_ns >= every_s * NS_PER_S
            asked_ns = frames.now_ns if due else asked_ns
            if due and frames.now_ns and reached():
                so_far = f", {self.progress}" if self.progress else ""
                self.note(EventKind(phase), f"reached after {elapsed_s:.1f} s{so_far}")
                return
            if elapsed_s > limit_s:
                raise DataError(
                    f"{phase}: not reached within {limit_s:g} s ({self.progress or 'nothing happened'}); "
                    "remove the cause, or raise its limit in the configuration"
                )
