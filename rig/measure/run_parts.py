"""The parts of a run: its record file with what is attached to it, all the rest, and its outcome."""

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.camera import Camera, HasFeatures
from acquisition.frame import Frame
from acquisition.record import pixels_beside
from acquisition.record.writer import RecordWriter
from processing.errors import DeviceError
from rig.devices import Devices, FrameStream, OpenCamera, TypedLeave
from rig.instrument import Block, Optics, RunNow, configuration_attachments, session_metadata
from rig.measure.end_of_run import EndLimits
from rig.measure.notes import Notes
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.run_status import Watcher
from rig.measure.start_judge import StartLimits
from rig.posterior import LivePosterior
from rig.presentation import Verdict, table_tree
from rig.settings import Configuration

_log = logging.getLogger(__name__)


def features_json(camera: Camera) -> bytes:
    """All features of the camera that can be read now, as JSON; empty for a camera that has none."""
    if not isinstance(camera, HasFeatures):
        return b""
    try:
        return json.dumps(camera.feature_values(), indent=1).encode()
    except DeviceError as refused:
        _log.warning("the camera's features cannot be read for the record: %s", refused)
        return b""


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record to be written; `source` is the user's configuration file, which is attached unchanged."""

    path: Path
    config: Configuration
    source: Path
    camera: OpenCamera
    optics: Optics

    def open(self, epoch_offset_ns: int, first: Frame, preflight: Sequence[Verdict]) -> RecordWriter:
        """Create the file with configuration, provenance and preflight table.

        `epoch_offset_ns` is UTC minus the time of the frames' clock.
        """
        attachments = configuration_attachments(self.config, self.source)
        if features := features_json(self.camera.camera):
            attachments["camera-features-start.json"] = features
        if preflight:
            attachments["preflight.json"] = json.dumps(table_tree(preflight), indent=1).encode()
        lever = self.optics.lever
        writer = RecordWriter(
            self.path,
            epoch_offset_ns,
            metadata=session_metadata(self.config, self.camera.info, first)
            | {"camera_settings": self._camera_settings()},
            attachments=attachments,
            deflection_unit=self.optics.unit,
        )
        if lever is not None:
            shape = (first.image.shape[0], first.image.shape[1])
            distance_px = lever.arm_m / lever.pixel_pitch_m
            reference_px = self.optics.deflector(shape).reference_px
            writer.write_camera_calibration(first.time_ns, shape, distance_px, reference_px)
        return writer

    def _camera_settings(self) -> dict[str, str]:
        """Settings of the camera as read back, and what was added to its timestamps."""
        applied = self.camera.applied.model_dump(exclude_none=True)
        return {key: str(value) for key, value in applied.items()} | {
            "stamped": self.config.camera.stamped or self.camera.info.stamped,
            "time_shift_ns": str(self.camera.time_shift_ns),
        }

    def set_aside(self, attempt: int) -> Path:
        """Rename the record of a rejected start; returns its new path."""
        aside = self.path.with_name(f"{self.path.stem}-start-{attempt}{self.path.suffix}")
        self.path.rename(aside)
        if pixels_beside(self.path).exists():
            pixels_beside(self.path).rename(pixels_beside(aside))
        return aside


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
        The file to which the run is recorded, with its configuration and the camera of `stream`.
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
    posterior
        Fits what is measured so far; None: nothing does.
    somebody_watches
        Whether there is somebody who may ask for light again, and acknowledge a trip; a run with
        laser.when_dark = "wait" goes on in the dark as long as there is.
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
    posterior: LivePosterior | None = None
    somebody_watches: Callable[[], bool] = lambda: False
    typed_leave: TypedLeave | None = None
    notes: Notes | None = None
    planned: Sequence[str] = ()

    @property
    def waits_in_darkness(self) -> bool:
        """Whether the run goes on if the laser went dark and somebody may be asked; otherwise it ends."""
        return self.record.config.laser.when_dark == "wait"


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
