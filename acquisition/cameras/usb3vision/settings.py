"""Section [camera.usb3vision]: options of the USB3 Vision driver."""

from typing import Literal

from pydantic import BaseModel, Field

from acquisition.cameras.kept_frames import kept_frames

_FEWEST, _MOST = 4, 1024


class Usb3VisionSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of the communication with it."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    transfers: int | None = Field(
        default=None,
        ge=1,
        le=_MOST,
        description="frames for which reads are queued ahead; None: 100 ms of them, 4 at least",
    )
    reading: Literal["auto", "blocking"] = Field(
        default="auto", description="auto queues reads ahead if libusb 1.0 is available; blocking never does"
    )

    def frames_ahead(self, rate_hz: float | None, frame_bytes: int) -> int:
        """Frames of this size for which reads are queued; `rate_hz` is what the camera states."""
        return kept_frames(self.transfers, rate_hz, frame_bytes, _FEWEST, _MOST)
