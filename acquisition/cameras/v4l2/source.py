"""Interface of a source of video frames, implemented by `LinuxSource` and `OpenCvSource`."""

from typing import NamedTuple, Protocol

from acquisition.camera import CameraInfo, CameraSettings
from acquisition.frame import Image


class RawFrame(NamedTuple):
    """One frame; `device_time_ns` is -1 if the source has none.

    `image` is None if the driver reports a damaged frame. `host_time_ns` is on the host's monotonic clock.
    `late`: frames that are missing before this one were lost because earlier ones were not fetched in time.
    """

    image: Image | None
    sequence: int
    device_time_ns: int
    host_time_ns: int
    late: bool = False


class FrameDevice(Protocol):
    """A device, used by one thread at a time. Methods raise DeviceError or CameraLost."""

    def open(self) -> CameraInfo:
        """Open the device for exclusive use."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; the values returned are read back."""
        ...

    def start(self) -> None:
        """Start the stream; frames from before are not delivered."""
        ...

    def next(self, timeout_s: float) -> RawFrame | None:
        """The next frame; None if none arrives within this time."""
        ...

    def stop(self) -> None:
        """Stop the stream."""
        ...

    def close(self) -> None:
        """Close the device; may be called more than once."""
        ...
