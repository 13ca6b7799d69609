"""What a source of video frames gives: two implementations, the kernel's own calls and OpenCV."""

from typing import Literal, NamedTuple, Protocol

from pydantic import BaseModel, Field

from acquisition.camera import CameraInfo, CameraSettings
from acquisition.frame import Image


class V4l2Settings(BaseModel, frozen=True, extra="forbid"):
    """Which camera, and what only this driver can be asked for."""

    device: str | None = Field(
        default=None, description="/dev/video2, or a number for OpenCV; needed only where there are several"
    )
    serial: str | None = Field(default=None, description="instead of the device, where the camera has one")
    reading: Literal["auto", "kernel", "opencv"] = Field(
        default="auto", description="kernel: Linux's own calls, which count losses; opencv: everywhere"
    )
    gain: int | None = Field(
        default=None, description="in the camera's own steps, for these have no decibels"
    )
    buffers: int = Field(default=4, ge=2, le=32, description="buffers of the driver")
    queued_frames: int = Field(default=64, ge=2, le=4096, description="frames kept for a reader that is late")


class RawFrame(NamedTuple):
    """One frame; `sequence` and `device_time_ns` are -1 where the source has none.

    `image` is None where the driver says that the frame is damaged.
    """

    image: Image | None
    sequence: int
    device_time_ns: int
    host_time_ns: int


class Source(Protocol):
    """A device, used by one thread at a time; errors are DeviceError and CameraLost."""

    def open(self) -> CameraInfo:
        """Claim the device."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply, read back."""
        ...

    def start(self) -> None:
        """Let the camera run; frames from before are not delivered."""
        ...

    def next(self) -> RawFrame | None:
        """The next frame, or None after a short while without one."""
        ...

    def stop(self) -> None:
        """Halt."""
        ...

    def close(self) -> None:
        """Give back; any number of times."""
        ...
