"""What a source of video frames gives: two implementations, the kernel's own calls and OpenCV."""

from typing import NamedTuple, Protocol

from acquisition.camera import CameraInfo, CameraSettings
from acquisition.frame import Image


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
