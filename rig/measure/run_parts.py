"""What a run is made of, who watches it, and how it ended."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from acquisition.frame import Frame
from acquisition.record.events import Event
from rig.devices import Devices, FrameStream
from rig.instrument import Block, Optics, Snapshot
from rig.measure.end_of_run import EndLimits
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.record_file import RecordFile
from rig.measure.start_judge import StartLimits


class Watcher(Protocol):
    """Is told what a run does: the terminal's screen, the viewer. Called in the processing thread.

    Must return immediately and never raise.
    """

    def block(self, start_ns: int, frames: Sequence[Frame], block: Block) -> None:
        """Some frames were processed."""
        ...

    def event(self, start_ns: int, event: Event) -> None:
        """Something happened."""
        ...

    def snapshot(self, snapshot: Snapshot) -> None:
        """The state of the run after that."""
        ...


def _not_noted(_record: Path, _reason: str) -> None:
    """Nobody wants to know of rejected starts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunParts:
    """What a run is made of.

    Attributes
    ----------
    stream
        The camera's frames; the camera is open and configured, not started.
    optics
        What turns frames into deflections.
    record
        The file that the run is recorded in.
    end
        Limits of amplitude and time at which the run ends.
    phases
        What is done before the record begins; None: it begins with the camera's first frame.
    start
        Which starts are accepted; None: any.
    start_rejected
        Called with the new name of a record whose start was not accepted, and the reason.
    devices
        Controller, laser and environment sensor, whose events and readings are recorded.
    environment_period_s
        Time between two recorded readings of the environment.
    """

    stream: FrameStream
    optics: Optics
    record: RecordFile
    end: EndLimits
    phases: PhasesBeforeRecord | None = None
    start: StartLimits | None = None
    start_rejected: Callable[[Path, str], None] = _not_noted
    watchers: Sequence[Watcher] = ()
    devices: Devices | None = None
    environment_period_s: float = 1.0
    full_frame_interval_s: float = 10.0
    keep_windows: bool = True


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run ended.

    `failure` is the error that ended it, None where it ended as intended. `interrupt` is what the
    main thread got from Ctrl-C or a signal; the record is closed in either case.
    """

    snapshot: Snapshot
    swings: int
    failure: Exception | None
    interrupt: KeyboardInterrupt | None = None
