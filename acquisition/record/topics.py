"""Topics of a record: their names, message types, and values that only records have."""

import math
from enum import IntEnum
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import Message

from acquisition.camera import Image
from acquisition.record.events import Event, EventKind
from acquisition.record.schemas import Kind, MessageType, message_type_of
from processing.balance import names_with_units
from processing.deflections import DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycleFlag

SCHEMA_VERSION = 1
LIBRARY = "optical-pendulum-rig"

LOG_TOPIC = "/log"
PREVIEW_TOPIC = "/preview"
CAMERA_TOPIC = "/camera_calibration"
METADATA_COPY = "metadata.json"
"""Attachment that holds all metadata once more, since MCAP gives them no checksum."""
SENSOR_FRAME = "sensor"
"""Frame of reference of images and camera calibration, for viewers."""


class TurningSide(IntEnum):
    """Side of the rest position on which a turning point lies."""

    POSITIVE = 1
    NEGATIVE = -1


class Environment(NamedTuple):
    """Readings of the laboratory's sensors; NaN for quantities that are not measured."""

    time_ns: int
    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan


class RecordedReference(NamedTuple):
    """The reference spot of a frame, which the pendulum does not move; NaN where it was lost."""

    sequence: int
    time_ns: int
    x_px: float
    y_px: float
    u_x_px: float
    u_y_px: float
    amplitude_dn: float
    chi2_per_dof: float
    flags: int


class RecordedSeismometer(NamedTuple):
    """A sample of the auxiliary seismometer, in its own unit; NaN for columns that it lacks.

    `time_ns` is on the frames' clock, shifted as the newest frame; `own_time_s` is the instrument's own time,
    NaN without one. The configuration names the columns (seismometer.columns).
    """

    time_ns: int
    host_time_ns: int
    own_time_s: float = math.nan
    first: float = math.nan
    second: float = math.nan
    third: float = math.nan


class RecordedNote(NamedTuple):
    """A note of the operator; `host_time_ns` is the host's time, `time_ns` the same on the frames' clock.

    A note typed before the run has the time of the run's first frame.
    """

    time_ns: int
    host_time_ns: int
    author: str
    text: str

    @property
    def event(self) -> Event:
        """The note as an event, for displays."""
        return Event(
            self.time_ns, EventKind.NOTE, f"{self.author}: {self.text}" if self.author else self.text
        )


class ClockAnchor(NamedTuple):
    """The computer's two clocks at one moment, so that UTC can be checked all through a run."""

    time_ns: int
    host_time_ns: int
    utc_ns: int
    u_utc_s: float
    synchronised: bool


class RecordedLosses(NamedTuple):
    """Numbers of frames lost since the beginning, by cause; see `acquisition.frames.losses.FrameLosses`."""

    time_ns: int
    by_camera: int
    by_bus: int
    by_host: int
    incomplete: int
    while_unplugged: int
    wrong_time: int = 0
    error_status: int = 0
    wrong_id: int = 0


class RecordedClockStep(NamedTuple):
    """A step of the camera's clock, subtracted from `time_ns` on; 0: the clock is no longer used."""

    time_ns: int
    step_ns: int
    u_step_ns: int


class RecordedPhase(NamedTuple):
    """Phase of the session from `time_ns` on, and its request to the operator (empty: none).

    `phase` is measuring, closing the record or done, `progress` says how far, `reason` why the run ends.
    """

    time_ns: int
    elapsed_s: float
    phase: str
    progress: str = ""
    instruction: str = ""
    reason: str = ""


class RecordedLight(NamedTuple):
    """Light and interlock from `time_ns` on; texts are empty where there is nothing to say.

    `light` is what is known of the laser, `interlock` is closed, open or unknown, `trip` the number of the
    trip that waits for an acknowledgement (0: none), `darkness` why the laser does not emit although it
    should, `refusal` why no light is allowed. `spot_seen`: 1 spot in the frames, 0 none, -1 not examined.
    """

    time_ns: int
    trip: int
    spot_seen: int
    light: str
    interlock: str
    darkness: str = ""
    refusal: str = ""
    trip_text: str = ""
    devices: str = ""


class RecordedHealth(NamedTuple):
    """State of the session's work: waiting frames and their age, record and disk, clock, beam.

    Counts are those since the record began; `waiting_frames` are in the queue between camera and processing.
    `frame_age_s` is NaN where frames are made on demand, `disk_silent_s` how long a write has hung. `alarm`
    says what is wrong with light or disk (empty: nothing), `beam` the model of the beam.
    """

    time_ns: int
    frames: int
    dropped_frames: int
    lost_spots: int
    half_cycles: int
    waiting_frames: int
    record_bytes: int
    frame_age_s: float
    disk_free_bytes: float
    disk_silent_s: float
    clock_drift_ppm: float
    u_clock_drift_ppm: float
    alarm: str = ""
    beam: str = ""


class RecordedEstimate(NamedTuple):
    """A parameter of the contact from the first `half_cycles` half-cycles: one row of the live fit.

    The rows of one fit have the same `time_ns`. `u_value` is infinite where the data do not determine it;
    `quantity` is the key in results.json, which ends in the unit.
    """

    time_ns: int
    half_cycles: int
    value: float
    u_value: float
    quantity: str


class RecordedFittedPoint(NamedTuple):
    """Fitted amplitude and full period at a turning point, of the live fit of `time_ns`; NaN: no period.

    Residuals are (data - fit) in standard uncertainties of the data. At most 300 points are recorded.
    """

    time_ns: int
    turn_time_ns: int
    amplitude_rad: float
    amplitude_residual: float
    period_s: float = math.nan
    period_residual: float = math.nan


class RecordedWindow(NamedTuple):
    """Raw pixels (ny, nx) around the spot; `origin_px` is the sensor position (x, y) of the first pixel."""

    sequence: int
    time_ns: int
    image: Image
    origin_px: tuple[int, int]


class IntegerGaussian(NamedTuple):
    """An upright Gaussian in integers.

    Centre in 1/256 px from the window's first pixel, 2^32 over the variances in px^2, amplitude and
    background in 1/8 DN.
    """

    x: int
    y: int
    inverse_x: int
    inverse_y: int
    amplitude: int
    background: int


def _doubles(*names: str) -> tuple[tuple[str, Kind], ...]:
    return tuple((name, "double") for name in names)


def _ints(*names: str) -> tuple[tuple[str, Kind], ...]:
    return tuple((name, "int") for name in names)


_SPOT_DESCRIPTION = (
    "One camera frame: its number and times, the laser spot on the sensor, the deflection of the pendulum. "
    "Every u_NAME is the standard uncertainty (one sigma) of NAME. NaN where the spot was lost."
)
_HALF_CYCLE_DESCRIPTION = (
    "One half-cycle as detected during the measurement: its turning point. Every u_NAME is the standard "
    "uncertainty (one sigma) of NAME. Half-cycles with flags are not fitted."
)
DEFLECTION_FIELDS = {
    DeflectionUnit.RAD: ("x_rad", "y_rad", "u_x_rad", "u_y_rad"),
    DeflectionUnit.PX: ("x_deflection_px", "y_deflection_px", "u_x_deflection_px", "u_y_deflection_px"),
}
"""Names of the fields for x, y and their standard uncertainties in the message of a spot, by unit."""


def _types_in(unit: DeflectionUnit) -> tuple[MessageType, MessageType, MessageType]:
    """Types of one frame, one half-cycle and one state of the balance, with deflections in this unit."""
    calibrated = unit is DeflectionUnit.RAD
    prefix = "" if calibrated else "Uncalibrated"
    spot = (
        *_ints("sequence", "time_ns", "device_time_ns", "host_time_ns"),
        *_doubles(*Spot._fields[:-1]),
        *_ints("flags"),
        *_doubles(*DEFLECTION_FIELDS[unit], *(("x_arcsec", "y_arcsec") if calibrated else ())),
    )
    # the fields of `HalfCycle` in its order, then those for displays
    half_cycle = (
        *_ints("index", "turn_time_ns"),
        *_doubles("u_turn_time_s", f"amplitude_{unit}", f"u_amplitude_{unit}"),
        *_doubles("half_period_s", "u_half_period_s", f"centre_{unit}"),
        *_ints("side", "flags"),
        *_doubles(*(("amplitude_arcsec",) if calibrated else ()), "period_s"),
    )
    # the numbers of `Balance` in its order
    time_ns, *numbers = names_with_units(unit).values()
    half_cycle_meanings = (HalfCycleFlag, TurningSide)
    return (
        MessageType(f"{prefix}Spot", "/spot", spot, _SPOT_DESCRIPTION, (SpotFlag,)),
        MessageType(f"{prefix}Swing", "/swing", half_cycle, _HALF_CYCLE_DESCRIPTION, half_cycle_meanings),
        MessageType(f"{prefix}Balance", "/balance", (*_ints(time_ns), *_doubles(*numbers))),
    )


TYPES_BY_UNIT: Final = {unit: _types_in(unit) for unit in (DeflectionUnit.RAD, DeflectionUnit.PX)}
"""Types of the messages whose fields have the unit of the deflections; they are the first in every record."""
SPOT, HALF_CYCLE, BALANCE = TYPES_BY_UNIT[DeflectionUnit.RAD]
_PIXELS: tuple[tuple[str, Kind], ...] = (
    *_ints("sequence", "time_ns", "x0_px", "y0_px", "width_px", "height_px", "bytes_per_pixel", "compressed"),
    *_ints(*(f"model_{name}" for name in IntegerGaussian._fields), "bit_planes"),
    ("pixels", "bytes"),
)
WINDOW = MessageType("Window", "/window", _PIXELS)
"""Pixels row by row: first the low bytes of all, then their high bytes; in a zstd frame if `compressed`.

If `model_inverse_x` is not 0, `pixels` are the bit planes of the pixels minus a model of the spot; see
`acquisition.record.codec`.
"""
IMAGE = MessageType("Image", "/image", _PIXELS)
"""A whole frame, stored as a window is."""
EVENT = MessageType(
    "Event", "/event", (("time_ns", "int"), ("kind", "text"), ("text", "text"), ("level", "text"))
)


class TimedMessage(Protocol):
    """A value that is recorded as a message of its own."""

    @property
    def time_ns(self) -> int:
        """Time of the value in ns on the frames' clock."""


_CLASSES: Final[dict[str, type[Any]]] = {
    "/environment": Environment,
    "/reference": RecordedReference,
    "/seismometer": RecordedSeismometer,
    "/note": RecordedNote,
    "/losses": RecordedLosses,
    "/clock": ClockAnchor,
    "/camera_clock_step": RecordedClockStep,
    LOG_TOPIC: Log,
    CAMERA_TOPIC: CameraCalibration,
    "/phase": RecordedPhase,
    "/light": RecordedLight,
    "/health": RecordedHealth,
    "/estimate": RecordedEstimate,
    "/fitted": RecordedFittedPoint,
}
"""Classes of the values that have a topic of their own, or Foxglove's, in the order of the channels."""
KIND_OF: Final[dict[type[TimedMessage], MessageType]] = {
    value_class: message_type_of(value_class, topic)
    for topic, value_class in _CLASSES.items()
    if not issubclass(value_class, Message)
}
"""Types of the messages that hold one value each, by the class of the value."""
ENVIRONMENT, REFERENCE = KIND_OF[Environment], KIND_OF[RecordedReference]
SEISMOMETER, CLOCK = KIND_OF[RecordedSeismometer], KIND_OF[ClockAnchor]
Topics: TypeAlias = dict[str, MessageType | type[Message]]
"""Message types of a file by topic, ours or Foxglove's classes, in the order of the channels 1, 2, ..."""


def number_topics(unit: DeflectionUnit) -> Topics:
    """Topics in the file of numbers."""
    topics: Topics = {kind.topic: kind for kind in (*TYPES_BY_UNIT[unit], EVENT)}
    return topics | {topic: KIND_OF.get(value, value) for topic, value in _CLASSES.items()}


PIXEL_TOPICS: Final[Topics] = {WINDOW.topic: WINDOW, IMAGE.topic: IMAGE, PREVIEW_TOPIC: CompressedImage}
"""Topics in the file of pixels."""
