"""Plan and outcome of one run, and what prepares the program for its frames."""

import gc
import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.camera import Camera, HasFeatures
from acquisition.record import pixels_path
from processing.errors import DeviceError
from rig.devices import SessionNews
from rig.instrument import RunNow
from rig.measure.run_status import Watcher
from rig.measure.session_orders import OperatorNote
from rig.settings import Configuration
from rig.terminal import Verdict

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunPlan:
    """Plan of one run: its configuration, its record, and the observers that are informed of it."""

    config: Configuration
    source: Path
    record: Path
    title: str
    force: bool = False
    json_lines: bool = False
    fitted: bool = True
    """Whether parameters are fitted while the run is measured."""
    is_last: bool = True
    """Whether no other run follows, for which the laser would stay lit."""
    start_rejected: Callable[[Path, str], None] = lambda _path, _reason: None
    """Called with the new path of the record of each rejected start, and the reason."""
    watchers: Sequence[Watcher] = ()
    """Receive what is recorded, in addition to the display."""
    session_news: SessionNews = field(default_factory=SessionNews)
    """Serves programs that watch the session through its socket."""
    take_notes: Callable[[], Sequence[OperatorNote]] = list
    """Returns notes that operators have written during the run since the last call."""
    checked: Callable[[Sequence[Verdict]], None] | None = None
    """Called with the preflight table of a run that ends there, without a record; None for other runs."""


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """End of a run; its record is closed unless `hangs` names what hangs."""

    last: RunNow
    """State of the run at its end."""
    failure: Exception | None
    """The error that ended the run; None for a regular end."""
    interrupt: KeyboardInterrupt | None
    """The exception raised in the main thread by Ctrl-C or a signal."""
    stopped: bool
    """Whether the run ended because of that interrupt."""
    hangs: str
    """What hung while the run was ended; the record is then cut short. Empty if nothing did."""

    def check(self) -> None:
        """Raise what ended the run otherwise than regularly: an error, a thread that hangs, an interrupt."""
        if problem := self.failure or (DeviceError(self.hangs) if self.hangs else self.interrupt):
            raise problem


def features_json(camera: Camera) -> bytes:
    """All features of the camera that can be read now, as JSON; empty for a camera that has none."""
    if not isinstance(camera, HasFeatures):
        return b""
    try:
        return json.dumps(camera.feature_values(), indent=1).encode()
    except DeviceError as error:
        _log.warning("the camera's features cannot be read for the record: %s", error)
        return b""


def set_aside(record: Path, attempt: int) -> Path:
    """Rename the record of a rejected start; returns its new path."""
    new_path = record.with_name(f"{record.stem}-start-{attempt}{record.suffix}")
    record.rename(new_path)
    if pixels_path(record).exists():
        pixels_path(record).rename(pixels_path(new_path))
    return new_path


_SWITCH_INTERVAL_S = 0.0005
"""Time after which a thread must pass on Python's interpreter lock. Each numerical kernel releases the lock,
and would wait Python's default of 5 ms to get it back from a busy thread: a loop over many small kernels
would delay frames by seconds."""


@contextmanager
def ready_for_frames(*, live: bool) -> Iterator[None]:
    """A context in which threads wait for one another only briefly.

    For a `live` camera the garbage collector leaves out all objects that exist now: those of the libraries
    are so many that one collection stops all threads for some tenths of a second, in which the buffers of a
    camera overflow. Frames made on demand simply wait. Enter the context before the devices are opened: it
    collects once itself, on a busy machine for longer than a controller's watchdog waits.
    """
    default_interval_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if live:
        gc.collect()
        gc.freeze()
    try:
        yield
    finally:
        if live:
            gc.unfreeze()
        sys.setswitchinterval(default_interval_s)
