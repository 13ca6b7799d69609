"""One phase before a record: looked on until it is reached, its limit is past, or someone stops it."""

from collections.abc import Callable

from processing.errors import DataError
from rig.instrument import Event, Snapshot
from rig.measure.recent_frames import Lookout


class Stopped(Exception):
    """The operator ended it, or no more frames come."""


class PhaseWatch:
    """One phase after the other over a lookout: reports, keeps events, ends at its limit."""

    def __init__(
        self,
        lookout: Lookout,
        report: Callable[[Snapshot], None],
        stopped: Callable[[], bool],
        unit_rad: float,
    ) -> None:
        self.lookout = lookout
        self._report = report
        self._stopped = stopped
        self.words = ""
        self.events: list[Event] = []

    def note(self, kind: str, text: str) -> None:
        """Keep an event, at the time of the newest frame."""
        self.events.append(Event(self.lookout.now_ns, kind, text))

    def phase(
        self,
        name: str,
        limit_s: float,
        reached: Callable[[], bool],
        instruction: str = "",
        every_s: float = 0.0,
    ) -> None:
        """Look on until it is reached.

        Raises DataError past the limit, `Stopped` when asked to or drained."""
        lookout = self.lookout
        begun_ns = lookout.now_ns
        looked_ns = -(10**18)
        self.words = ""
        while True:
            if self._stopped() or not lookout.advance():
                self.note(name, "stopped")
                raise Stopped
            begun_ns = begun_ns or lookout.now_ns
            elapsed_s = (lookout.now_ns - begun_ns) * 1e-9
            words = f"{name}: {self.words}" if self.words else name
            self._report(Snapshot(phase=words, elapsed_s=elapsed_s, instruction=instruction))
            due = lookout.now_ns - looked_ns >= every_s * 1e9
            looked_ns = lookout.now_ns if due else looked_ns
            if due and lookout.now_ns and reached():
                self.note(name, f"reached after {elapsed_s:.1f} s{f', {self.words}' if self.words else ''}")
                return
            if elapsed_s > limit_s:
                raise DataError(
                    f"{name}: not reached within {limit_s:g} s ({self.words or 'nothing happened'}); "
                    "remove the cause, or raise its limit in the configuration"
                )
