"""Section [camera.usb3vision]: options of the USB3 Vision driver."""

import logging
from typing import Any, Final, Literal

from pydantic import BaseModel, Field, model_validator

logger = logging.getLogger(__name__)

_FORMER_BUFFERS: Final = 64


class Usb3VisionSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of the communication with it."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    transfers: int = Field(default=4, ge=1, le=64, description="frames for which reads are queued ahead")
    transfer_bytes: int = Field(
        default=1 << 20, ge=1 << 14, le=1 << 26, description="largest single transfer of a frame's bytes"
    )
    reading: Literal["auto", "blocking"] = Field(
        default="auto", description="auto queues reads ahead if libusb 1.0 is available; blocking never does"
    )
    control_timeout_s: float = Field(default=0.5, gt=0, le=10, description="timeout of one reply")
    control_retries: int = Field(default=3, ge=0, le=20, description="repetitions of a command without reply")

    @model_validator(mode="before")
    @classmethod
    def _without_buffers(cls, given: Any) -> Any:
        """Accept `buffers`, which records and files of earlier versions state, and leave it out."""
        if not isinstance(given, dict) or "buffers" not in given:
            return given
        if given["buffers"] != _FORMER_BUFFERS:
            logger.warning(
                "camera.usb3vision.buffers = %s has no effect any more: frames that are late wait in the "
                "session's queue; transfers says how many are read ahead",
                given["buffers"],
            )
        return {key: value for key, value in given.items() if key != "buffers"}
