"""Who has a part in a run beside the camera: onlookers, what goes before, what is known beside the frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from acquisition.frame import Frame
from rig.devices import FrameStream
from rig.instrument import Block, Event, Snapshot
from rig.measure.start_and_end import StartJudge


class Watcher(Protocol):
    """Who looks on while a run goes: the viewer, a test. Must return at once and never raise."""

    def block(self, start_ns: int, frames: Sequence[Frame], block: Block) -> None:
        """Some frames were processed."""
        ...

    def event(self, start_ns: int, event: Event) -> None:
        """Something happened."""
        ...

    def snapshot(self, snapshot: Snapshot) -> None:
        """The state of the run after that."""
        ...


class Prelude(Protocol):
    """What goes before the record: preflight, warm-up, rest, release."""

    def __call__(
        self, frames: FrameStream, report: Callable[[Snapshot], None], stopped: Callable[[], bool]
    ) -> tuple[list[Frame], list[Event]]:
        """Frames that the record begins with, and what happened until then.

        No frames: the run was stopped, or the source has come to its end. Raises RigError with the
        reason where the run must not begin.
        """
        ...


class Surroundings(Protocol):
    """What is known beside the frames; every call returns at once."""

    def take_events(self) -> list[tuple[str, str]]:
        """(kind, text) of what controller, laser and sensors did since the last call."""
        ...

    def environment(self) -> tuple[float, float, float]:
        """Temperature in °C, humidity in %, pressure in Pa; NaN for what is not known."""
        ...

    def describe(self) -> str:
        """How the controller stands, in a few words."""
        ...


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run ended. `failure` is the error that ended it, None where it ended as it should.

    `interrupt` is what the main thread got from Ctrl-C or a signal: the record is closed all the same.
    """

    snapshot: Snapshot
    swings: int
    failure: Exception | None
    interrupt: KeyboardInterrupt | None = None


@dataclass(frozen=True, slots=True)
class Attempts:
    """How often a start is tried: a judge for each, and what becomes of the record of one that failed."""

    most: int
    make_judge: Callable[[], StartJudge]
    set_aside: Callable[[int, str], None]
