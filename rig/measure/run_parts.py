"""A run as it is wanted, its parts, its record with what is attached to it, and its outcome."""

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.camera import Camera, Frame, HasFeatures
from acquisition.record import pixels_beside
from acquisition.record.writer import RecordWriter
from processing.deflections import DeflectionUnit
from processing.errors import DeviceError
from processing.units import ARCSEC_RAD
from rig.devices import Devices, FrameStream, OpenCamera, SessionNews, TypedAcknowledgement
from rig.instrument import ObserverGuard, Optics, RunNow, configuration_attachments, session_metadata
from rig.measure.end_of_run import EndLimits, StopRequest
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.posterior import LivePosterior
from rig.measure.run_status import RunStatus, Watcher
from rig.measure.session_orders import Notes
from rig.presentation import Verdict, table_tree
from rig.settings import Configuration

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunPlan:
    """A run to be made.

    `start_rejected` is called with the new path of the record of each rejected start, and the reason;
    `watchers` are told what the record is told, beside its display, `session_news` tells those who watch from
    outside, `notes` are what operators note meanwhile, `waited` what the run has waited for. `fitted`:
    parameters are fitted while it is measured. `is_last`: no other run follows, for which the laser would
    stay lit.
    """

    config: Configuration
    source: Path
    record: Path
    title: str
    force: bool = False
    json_lines: bool = False
    fitted: bool = True
    is_last: bool = True
    start_rejected: Callable[[Path, str], None] = lambda _path, _reason: None
    watchers: Sequence[Watcher] = ()
    session_news: SessionNews | None = None
    notes: Notes | None = None
    waited: Sequence[str] = ()


@dataclass(slots=True, kw_only=True)
class RunParts:
    """The parts of a run, and what they share: its state, its end, and the guard around its observers.

    Attributes
    ----------
    plan
        What is wanted.
    camera
        Open and configured, not started.
    optics
        Calibrated values for the conversion of frames to deflections.
    stream
        The camera's frames.
    devices
        Controller, laser and environment sensor, whose events and readings are recorded.
    phases
        Phases before the record; None: the record begins with the camera's first frame.
    watchers
        Are told what the record is told.
    posterior
        Fits what is measured so far; None: nothing does.
    typed_leave
        What somebody at the terminal types meanwhile.
    wall
        Behind which observers stand.
    status
        What the run says of itself.
    stop
        Whether it is to end.
    """

    plan: RunPlan
    camera: OpenCamera
    optics: Optics
    stream: FrameStream
    devices: Devices | None = None
    phases: PhasesBeforeRecord | None = None
    watchers: Sequence[Watcher] = ()
    posterior: LivePosterior | None = None
    typed_leave: TypedAcknowledgement | None = None
    wall: ObserverGuard = field(init=False, default_factory=ObserverGuard)
    status: RunStatus = field(init=False)
    stop: StopRequest = field(init=False)

    def __post_init__(self) -> None:
        self.status = RunStatus(self.watchers, self.devices, self.optics.unit, self.wall)
        self.stop = StopRequest(self.stream)

    @property
    def end_limits(self) -> EndLimits:
        """Limits of amplitude and time at which the run ends."""
        session = self.plan.config.session
        # without a lever the amplitude in arcsec is unknown, and only the time limit applies
        final_rad = session.final_amplitude_arcsec * ARCSEC_RAD
        return EndLimits(
            final_rad if self.optics.unit is DeflectionUnit.RAD else 0.0,
            session.max_duration_s,
            self.plan.config.stop_conditions if self.posterior is not None else (),
        )

    @property
    def waits_in_darkness(self) -> bool:
        """Whether the run goes on if the laser went dark and somebody may be asked; otherwise it ends."""
        return self.plan.config.laser.when_dark == "wait"

    @property
    def somebody_watches(self) -> bool:
        """Whether there is somebody who may ask for light again, and acknowledge a trip."""
        news, typed = self.plan.session_news, self.typed_leave
        return (typed is not None and typed.available) or (news is not None and news.watched)

    def open_record(self, epoch_offset_ns: int, first: Frame, preflight: Sequence[Verdict]) -> RecordWriter:
        """Create the file with configuration, provenance and preflight table.

        `epoch_offset_ns` is UTC minus the time of the frames' clock.
        """
        config, camera, lever = self.plan.config, self.camera, self.optics.lever
        attachments = configuration_attachments(config, self.plan.source)
        if features := features_json(camera.camera):
            attachments["camera-features-start.json"] = features
        if preflight:
            attachments["preflight.json"] = json.dumps(table_tree(preflight), indent=1).encode()
        # as read back
        applied = camera.applied.model_dump(exclude_none=True)
        settings = {key: str(value) for key, value in applied.items()} | {
            "stamped": config.camera.stamped or camera.info.stamped,
            "time_shift_ns": str(camera.time_shift_ns),
        }
        writer = RecordWriter(
            self.plan.record,
            epoch_offset_ns,
            metadata=session_metadata(config, camera.info, first) | {"camera_settings": settings},
            attachments=attachments,
            deflection_unit=self.optics.unit,
        )
        if lever is not None:
            shape = (first.image.shape[0], first.image.shape[1])
            distance_px = lever.arm_m / lever.pixel_pitch_m
            reference_px = self.optics.deflector(shape).reference_px
            writer.write_camera_calibration(first.time_ns, shape, distance_px, reference_px)
        return writer


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


def features_json(camera: Camera) -> bytes:
    """All features of the camera that can be read now, as JSON; empty for a camera that has none."""
    if not isinstance(camera, HasFeatures):
        return b""
    try:
        return json.dumps(camera.feature_values(), indent=1).encode()
    except DeviceError as refused:
        _log.warning("the camera's features cannot be read for the record: %s", refused)
        return b""


def set_aside(record: Path, attempt: int) -> Path:
    """Rename the record of a rejected start; returns its new path."""
    aside = record.with_name(f"{record.stem}-start-{attempt}{record.suffix}")
    record.rename(aside)
    if pixels_beside(record).exists():
        pixels_beside(record).rename(pixels_beside(aside))
    return aside
