"""What every camera driver promises."""

from dataclasses import astuple, dataclass
from typing import Literal, NamedTuple, Protocol

from pydantic import BaseModel, Field

from acquisition.frame import Frame
from processing.errors import DeviceError

PixelFormat = Literal["mono8", "mono10", "mono12", "mono16"]


class FrameTimeout(DeviceError):
    """No frame came within the time allowed; the camera may still be alive."""


class CameraLost(DeviceError):
    """The camera is gone (unplugged, link down); `close`, then `open` again may bring it back."""


class CameraSettings(BaseModel, frozen=True, extra="forbid"):
    """What a user asks of a camera; None leaves the camera's own value.

    The region of interest is in sensor pixels, x to the right, y down; width and height of the
    frame are those of the region.
    """

    exposure_us: float | None = Field(default=None, gt=0)
    gain_db: float | None = Field(default=None, ge=0)
    frame_rate_hz: float | None = Field(default=None, gt=0)
    pixel_format: PixelFormat | None = None
    width_px: int | None = Field(default=None, gt=0)
    height_px: int | None = Field(default=None, gt=0)
    offset_x_px: int | None = Field(default=None, ge=0)
    offset_y_px: int | None = Field(default=None, ge=0)


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Who the camera is. `full_scale_dn` is the largest value that a pixel can take."""

    driver: str
    vendor: str
    model: str
    serial: str
    width_px: int
    height_px: int
    full_scale_dn: int
    has_clock: bool


class PluggedCamera(NamedTuple):
    """One camera as its driver finds it, before it is opened.

    `place` is its port, address or path, `modes` what it can deliver, as far as that is known.
    `problem` says why it cannot be used; it is empty where it can.
    """

    driver: str
    name: str
    serial: str
    place: str
    modes: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """Where the frames went since `start`; the counts are kept apart by who lost them."""

    delivered: int = 0
    dropped_by_camera: int = 0
    dropped_by_bus: int = 0
    dropped_by_host: int = 0
    incomplete: int = 0
    reconnects: int = 0

    @property
    def dropped(self) -> int:
        """All frames lost, by camera, bus and host."""
        return self.dropped_by_camera + self.dropped_by_bus + self.dropped_by_host + self.incomplete

    def __add__(self, other: "CameraStatus") -> "CameraStatus":
        """Counts of two stretches of one run, before and after a reconnection."""
        return CameraStatus(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


class Camera(Protocol):
    """A source of frames.

    Life cycle: ``open`` -> ``configure`` -> (``start`` -> ``read``... -> ``stop``) any number of
    times -> ``close``. One thread calls ``read``; ``stop`` and ``close`` may come from another
    thread at any moment, from any state, any number of times, and return within one second.

    Every method raises `DeviceError` with one line that names the camera, the value and the
    remedy. A frame that is lost is counted in `status`, never replaced.
    """

    def open(self) -> CameraInfo:
        """Find and claim the camera. Raises DeviceError where it is missing, ambiguous or in use."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings while stopped; return what was applied, read back from the camera."""
        ...

    def start(self) -> None:
        """Begin to deliver frames, numbered from 0; what was buffered before is thrown away."""
        ...

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame in order. Blocks at most timeout_s.

        Returns None when the source has come to its end (a folder, a simulated run) or was
        stopped. Raises FrameTimeout when nothing came in time, CameraLost when the camera is gone.
        """
        ...

    def stop(self) -> None:
        """Stop delivering; a blocked `read` returns None."""
        ...

    def close(self) -> None:
        """Give the camera back."""
        ...

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`; may be read from any thread."""
        ...
