"""Settings of the drivers of devices: which camera, how many frames are kept for a reader that is late."""

import math
from typing import Literal

from pydantic import BaseModel, Field

KEPT_S = 0.1
"""Python stands still for less: by a search for garbage, or a busy processor."""
_MOST_BYTES = 256 * 1024 * 1024


def kept_frames(asked: int | None, rate_hz: float | None, frame_bytes: int, least: int, most: int) -> int:
    """Number of buffers: what was `asked` for, else as many as hold `KEPT_S` at the stated rate.

    `least` are kept at any rate, also where the camera states none (None), at most `most`, and all together
    are no larger than 256 MiB.
    """
    wanted = asked or max(least, math.ceil(KEPT_S * (rate_hz or 0.0)) + 1)
    return max(2, min(wanted, most, _MOST_BYTES // max(frame_bytes, 1)))


class Usb3VisionSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of the communication with it."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    transfers: int | None = Field(
        default=None,
        ge=1,
        le=1024,
        description="frames for which reads are queued ahead; None: 100 ms of them, 4 at least",
    )
    reading: Literal["auto", "blocking"] = Field(
        default="auto", description="auto queues reads ahead if libusb 1.0 is available; blocking never does"
    )

    def frames_ahead(self, rate_hz: float | None, frame_bytes: int) -> int:
        """Frames of this size for which reads are queued; `rate_hz` is what the camera states."""
        return kept_frames(self.transfers, rate_hz, frame_bytes, 4, 1024)


class V4l2Settings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of this driver."""

    device: str | None = Field(
        default=None, description="/dev/video2, or its number; needed only where there are several"
    )
    serial: str | None = Field(default=None, description="instead of the device, where the camera has one")
    gain: int | None = Field(default=None, description="in the camera's own steps, which are not decibels")
    buffers: int | None = Field(
        default=None,
        ge=2,
        le=32,
        description="frames kept for a reader that is late; None: 100 ms of them, 4 at least",
    )


class PylonSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    buffers: int | None = Field(
        default=None,
        ge=2,
        le=4096,
        description="frames kept for a reader that is late; None: 100 ms of them, 64 at least",
    )


class AravisSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera and options of the communication."""

    serial: str | None = Field(
        default=None, description="serial number or libaravis's id; needed only where there are several"
    )
    buffers: int | None = Field(
        default=None,
        ge=2,
        le=4096,
        description="frames kept for a reader that is late; None: 100 ms of them, 64 at least",
    )
    packet_bytes: int | None = Field(
        default=None, ge=576, le=16114, description="GigE packets; left out: the largest that passes"
    )
