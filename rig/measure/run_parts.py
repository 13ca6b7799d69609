"""The parts of a run, and its outcome."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.camera import Camera
from acquisition.frame import Frame
from rig.devices import Devices, FrameStream, TypedLeave
from rig.instrument import Block, Optics, RunNow
from rig.measure.end_of_run import EndLimits
from rig.measure.notes import Notes
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.record_file import RecordFile
from rig.measure.run_status import Watcher
from rig.measure.start_judge import StartLimits
from rig.posterior import LivePosterior


@dataclass(frozen=True, slots=True, kw_only=True)
class RunParts:
    """The parts of a run.

    Attributes
    ----------
    stream
        The camera's frames; the camera is open and configured, not started.
    optics
        Calibrated values for the conversion of frames to deflections.
    record
        The file to which the run is recorded.
    end
        Limits of amplitude and time at which the run ends.
    phases
        Phases before the record; None: the record begins with the camera's first frame.
    start
        Limits for accepting a start; None: any start is accepted.
    start_rejected
        Called with the new path of the record of a rejected start, and the reason.
    look
        Shown each block of frames, for pictures.
    devices
        Controller, laser and environment sensor, whose events and readings are recorded.
    camera
        The camera of `stream`, whose features and temperature are recorded.
    posterior
        Fits what is measured so far; None: nothing does.
    environment_period_s
        Time between two recorded readings of the environment.
    waits_in_darkness
        Go on if the laser went dark during the run, as long as somebody may be asked; otherwise the run
        ends.
    somebody_watches
        Whether there is somebody who may ask for light again, and acknowledge a trip.
    typed_leave
        What somebody at the terminal types meanwhile.
    notes
        What operators note, for the record; None: nobody can.
    planned
        What a plan says of this run: why it is made, what it has waited for.
    """

    stream: FrameStream
    optics: Optics
    record: RecordFile
    end: EndLimits
    phases: PhasesBeforeRecord | None = None
    start: StartLimits | None = None
    start_rejected: Callable[[Path, str], None] = lambda _record, _reason: None
    watchers: Sequence[Watcher] = ()
    look: Callable[[Sequence[Frame], Block], None] = lambda _frames, _block: None
    devices: Devices | None = None
    camera: Camera | None = None
    posterior: LivePosterior | None = None
    environment_period_s: float = 1.0
    full_frame_interval_s: float = 10.0
    keep_windows: bool = True
    waits_in_darkness: bool = False
    somebody_watches: Callable[[], bool] = lambda: False
    typed_leave: TypedLeave | None = None
    notes: Notes | None = None
    planned: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run ended.

    `last` is its state at the end, `failure` the error that ended it, None for a regular end. `interrupt` is
    the exception raised in the main thread by Ctrl-C or a signal, `stopped` whether the run ended because of
    it. The record is closed, unless `hangs` says what hung while the run was ended: the record then stays as
    it is, cut short.
    """

    last: RunNow
    failure: Exception | None
    interrupt: KeyboardInterrupt | None
    stopped: bool
    hangs: str
