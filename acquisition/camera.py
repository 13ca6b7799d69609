"""The interface of every camera driver: frames, settings, counts, and the errors of a camera."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, fields
from enum import StrEnum
from operator import add, attrgetter
from typing import Final, Literal, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator

from processing.errors import DeviceError

Image = NDArray[np.uint8] | NDArray[np.uint16]
_OVERHEAD_BYTES: Final = 1024
"""Approximate memory of a frame without its pixels."""


class Frame(NamedTuple):
    """One frame as the camera delivered it.

    Attributes
    ----------
    image
        Shape (ny, nx), uint8 or uint16, in DN. No consumer may write to it, and the camera does not write
        to it again.
    sequence
        The camera's own frame number, counted from 0 at `start`; a gap is a lost frame.
    device_time_ns
        The camera's clock in integer nanoseconds: in a driver at the moment of the exposure that
        `CameraInfo.stamped` states, in a session at its middle; -1 where the camera has no clock of its own.
    host_time_ns
        The host's monotonic clock when the frame arrived, before any processing.
    """

    image: Image
    sequence: int
    device_time_ns: int
    host_time_ns: int

    @property
    def time_ns(self) -> int:
        """The camera's clock where it has one, else the host's monotonic clock."""
        return self.device_time_ns if self.device_time_ns >= 0 else self.host_time_ns

    @property
    def memory_bytes(self) -> int:
        """Approximate memory that the frame takes while it waits in a queue."""
        return self.image.nbytes + _OVERHEAD_BYTES


PixelFormat = Literal["mono8", "mono10", "mono12", "mono14", "mono16"]
FORMAT_OF_BITS: Final[dict[int, PixelFormat]] = {
    8: "mono8", 10: "mono10", 12: "mono12", 14: "mono14", 16: "mono16",
}  # fmt: skip
BITS_OF_FORMAT: Final = {name: bits for bits, name in FORMAT_OF_BITS.items()}
FeatureValue = bool | int | float | str
"""Value of one of the camera's own features."""
TimestampMoment = Literal["start", "middle", "end"]
"""The moment of the exposure that a camera's timestamps mark."""
ColourPlane = Literal["red", "green", "blue"]
"""The pixels of one colour of a sensor with a Bayer mosaic."""
Edge = Literal["rising", "falling"]
"""The change of a trigger's voltage that starts an exposure."""

BAYER_PERIOD_PX: Final = 2
"""Distance, in x and in y, of neighbouring pixels of one colour in a Bayer mosaic."""
_NEUTRAL_VALUES: Final = {"ptp": False, "binning": 1} | dict.fromkeys(
    ("trigger", "trigger_edge", "exposure_output", "colour_plane")
)
"""Settings that some drivers do not support, with the value that, like None, means "not requested"."""


class FrameTimeout(DeviceError):
    """No frame arrived within the timeout; the camera may still be connected."""


class CameraLost(DeviceError):
    """The connection to the camera is lost (unplugged, link down); it may return after `close` and `open`."""


class CameraSettings(BaseModel, frozen=True, extra="forbid"):
    """Settings of a camera requested by the user.

    None keeps the camera's present value, except where a field says otherwise. The region of interest is in
    pixels of the delivered image, x to the right, y down; the image has its width and height.
    """

    exposure_us: float | None = Field(default=None, gt=0)
    gain_db: float | None = None
    frame_rate_hz: float | None = Field(default=None, gt=0)
    pixel_format: PixelFormat | None = None
    binning: int | None = Field(
        default=None,
        ge=1,
        le=16,
        description="sensor pixels per image pixel, in each direction; None: 1",
    )
    colour_plane: ColourPlane | None = Field(
        default=None,
        description="of a colour camera, use only pixels of this colour; size and offsets count these",
    )
    width_px: int | None = Field(default=None, gt=0)
    height_px: int | None = Field(default=None, gt=0)
    offset_x_px: int | None = Field(default=None, ge=0)
    offset_y_px: int | None = Field(default=None, ge=0)
    trigger: str | None = Field(
        default=None,
        description="line that starts each exposure, as the camera calls it (Line1); None: it runs freely",
    )
    trigger_edge: Edge | None = Field(default=None, description="of the trigger; None: rising")
    exposure_output: str | None = Field(
        default=None, description="line that is active during each exposure, as the camera calls it"
    )
    ptp: bool | None = Field(default=None, description="the camera's clock follows the network's (IEEE 1588)")
    features: dict[str, FeatureValue] = Field(
        default_factory=dict,
        description="any feature by its own name, set after all others, in this order",
    )

    @property
    def pitch_factor(self) -> int:
        """Distance of neighbouring pixels of the image, in those of the sensor."""
        return (self.binning or 1) * (1 if self.colour_plane is None else BAYER_PERIOD_PX)

    @field_validator("features")
    @classmethod
    def _refuse_binning_features(cls, features: dict[str, FeatureValue]) -> dict[str, FeatureValue]:
        for name in ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical"):
            if name in features:
                raise ValueError(f"{name}: set camera.binning instead, which the pixel pitch follows")
        return features


def refuse_unsupported(settings: CameraSettings, name: str, supported: Collection[str] = ()) -> None:
    """Raise DeviceError for a requested setting that not every driver supports, unless it is `supported`."""
    for key, neutral in _NEUTRAL_VALUES.items():
        value = getattr(settings, key)
        if key not in supported and value not in (None, neutral):
            raise DeviceError(f"{name}: this driver knows no {key}; leave camera.{key} = {value!r} out")
    if settings.features and "features" not in supported:
        raise DeviceError(
            f"{name}: has no features that can be set by name; leave [camera.features] out "
            f"({', '.join(settings.features)})"
        )


class ShutterKind(StrEnum):
    """Kinds of a sensor's shutter."""

    UNKNOWN = "unknown"
    ROLLING = "rolling"
    GLOBAL = "global"
    OTHER = "other"

    @classmethod
    def of(cls, word: str) -> Self:
        """The kind of shutter from the camera's own word for it, which is also in the record."""
        if not word or word.lower().startswith(cls.ROLLING):
            return cls("rolling" if word else "unknown")
        # "GlobalReset" exposes its rows for different times, so it is no global shutter
        return cls("global" if word == "Global" else "other")


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Identity and sensor of the camera."""

    driver: str
    vendor: str
    model: str
    serial: str
    width_px: int
    height_px: int
    full_scale_dn: int
    """Largest possible value of a pixel."""
    has_clock: bool
    stamped: TimestampMoment = "start"
    shutter: str = ""
    """The camera's own word for its shutter ("Rolling", "Global", "GlobalReset"); empty where it has none."""


class PluggedCamera(NamedTuple):
    """A connected camera as found by its driver, before it is opened."""

    driver: str
    name: str
    serial: str
    connection: str
    """Port, network address, path, transport layer or USB speed, as text."""
    modes: tuple[str, ...] = ()
    """Image modes, as far as known."""
    problem: str = ""
    """Reason why the camera cannot be used; empty if there is none."""


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """Counts since `start`: frames delivered, frames lost by the place of the loss, reconnections."""

    delivered: int = 0
    dropped_by_camera: int = 0
    dropped_by_bus: int = 0
    dropped_by_host: int = 0
    incomplete: int = 0
    """Frames of which a part is missing."""
    reconnects: int = 0
    error_status: int = 0
    """Frames that the camera or its driver marked as faulty."""
    wrong_id: int = 0
    """Frames that came again or too late, with an earlier number; none is missing because of them."""

    @property
    def dropped(self) -> int:
        """Total number of missing frames."""
        return sum(_counts(self)) - self.delivered - self.reconnects - self.wrong_id

    def __add__(self, other: "CameraStatus") -> "CameraStatus":
        """Sum of the counts of two parts of a run, before and after a reconnection."""
        return CameraStatus(*map(add, _counts(self), _counts(other)))


_counts: Callable[[CameraStatus], tuple[int, ...]] = attrgetter(
    *(field.name for field in fields(CameraStatus))
)
"""All counts; `astuple` copies recursively, which is too slow for every block of frames."""

PTP_STATUS_FEATURES: Final = ("PtpStatus", "GevIEEE1588Status")
"""Features with the state of the clock by the Precision Time Protocol: "Slave" follows the network's."""


@runtime_checkable
class HasFeatures(Protocol):
    """A camera whose own features can be read by name, for the record."""

    def feature_values(self) -> dict[str, FeatureValue]:
        """All features that can be read now; also while frames are delivered."""
        ...

    def feature_value(self, name: str) -> FeatureValue | None:
        """Value of one feature; None if the camera has none of this name or it cannot be read now."""
        ...


class Camera(Protocol):
    """A source of frames.

    Life cycle: ``open`` -> ``configure`` -> (``start`` -> ``read``... -> ``stop``) any number of
    times -> ``close``. One thread calls ``read``; ``stop`` and ``close`` may come from another
    thread at any time, in any state, any number of times, and return within one second.

    Every method raises `DeviceError` with one line that names the camera, the value and the remedy. A
    lost frame is counted in `status` and never replaced.
    """

    def open(self) -> CameraInfo:
        """Find and claim the camera. Raises DeviceError if it is missing, ambiguous or in use."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings while stopped; return what was applied, read back from the camera."""
        ...

    def start(self) -> None:
        """Start delivering frames, numbered from 0; frames buffered before are discarded."""
        ...

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame in order. Blocks for at most timeout_s.

        All frames have the size and type of the first. A session ends at a frame of another size or type, at
        a number that does not rise, and at an image that has changed since it was delivered.

        Returns None if the source has ended (a folder, a simulated run) or was stopped. Raises FrameTimeout
        if no frame arrived in time, CameraLost if the connection is lost.
        """
        ...

    def stop(self) -> None:
        """Stop delivering; a blocked `read` returns None."""
        ...

    def close(self) -> None:
        """Release the camera."""
        ...

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`; may be read from any thread."""
        ...
