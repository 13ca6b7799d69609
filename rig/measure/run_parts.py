"""Plan, parts and outcome of one run, and the creation of its record with attachments."""

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
from rig.measure.end_of_run import EndOfRun, StopRequest
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.posterior import LivePosterior
from rig.measure.run_status import RunStatus, Watcher
from rig.measure.session_orders import OperatorNote
from rig.settings import Configuration
from rig.terminal import Verdict, plain_values

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
    waited: Sequence[str] = ()
    """What the run has waited for, for the record."""
    checked: Callable[[Sequence[Verdict]], None] | None = None
    """Called with the preflight table of a run that ends there, without a record; None for other runs."""


@dataclass(slots=True, kw_only=True)
class RunParts:
    """The parts of a run, and what they share: its state, the request to end it, the observer guard."""

    plan: RunPlan
    camera: OpenCamera
    """Open and configured, not started."""
    optics: Optics
    """Calibrated values for the conversion of frames to deflections."""
    stream: FrameStream
    """The camera's frames."""
    devices: Devices
    """Controller, laser and environment sensor, whose events and readings are recorded."""
    phases: PhasesBeforeRecord | None = None
    """Phases before the record; None: the record begins with the camera's first frame."""
    watchers: Sequence[Watcher] = ()
    """Receive what is recorded."""
    posterior: LivePosterior | None = None
    """The live fit; None without one."""
    typed_acknowledgement: TypedAcknowledgement | None = None
    """Acknowledgements of a trip that a person types at the terminal."""
    guard: ObserverGuard = field(init=False, default_factory=ObserverGuard)
    """Catches the errors of observers."""
    status: RunStatus = field(init=False)
    """State of the run, passed on to the watchers."""
    stop: StopRequest = field(init=False)
    """Request to end the run."""

    def __post_init__(self) -> None:
        self.status = RunStatus(self.watchers, self.devices, self.optics.unit, self.guard)
        self.stop = StopRequest(self.stream)

    @property
    def end(self) -> EndOfRun:
        """The judge of the run's end, by its limits of amplitude and time and its stop conditions."""
        session = self.plan.config.session
        # without a lever the amplitude in arcsec is unknown, and only the time limit applies
        final_rad = session.final_amplitude_arcsec * ARCSEC_RAD
        return EndOfRun(
            final_rad if self.optics.unit is DeflectionUnit.RAD else 0.0,
            session.max_duration_s,
            self.plan.config.stop_conditions if self.posterior is not None else (),
        )

    @property
    def waits_when_dark(self) -> bool:
        """Whether a run whose laser goes dark waits for a person to relight it; otherwise it ends."""
        return self.plan.config.laser.when_dark == "wait"

    @property
    def operator_present(self) -> bool:
        """Whether a person at the terminal or a desk could acknowledge a trip and ask for light."""
        typed = self.typed_acknowledgement
        return (typed is not None and typed.available) or self.plan.session_news.watched

    def open_record(self, epoch_offset_ns: int, first: Frame, preflight: Sequence[Verdict]) -> RecordWriter:
        """Create the file with configuration, provenance and preflight table.

        `epoch_offset_ns` is UTC minus the time of the frames' clock, `first` the first frame of the record.
        """
        config, camera, lever = self.plan.config, self.camera, self.optics.lever
        attachments = configuration_attachments(config, self.plan.source)
        if features := features_json(camera.camera):
            attachments["camera-features-start.json"] = features
        if preflight:
            attachments["preflight.json"] = json.dumps(plain_values(preflight), indent=1).encode()
        # the settings that were read back from the camera
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
