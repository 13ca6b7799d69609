"""Section [camera.v4l2]: options of the Video4Linux driver."""

from typing import Literal

from pydantic import BaseModel, Field


class V4l2Settings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of this driver."""

    device: str | None = Field(
        default=None, description="/dev/video2, or a number for OpenCV; needed only where there are several"
    )
    serial: str | None = Field(default=None, description="instead of the device, where the camera has one")
    reading: Literal["auto", "kernel", "opencv"] = Field(
        default="auto", description="kernel: calls of Linux, which count losses; opencv: on all systems"
    )
    gain: int | None = Field(default=None, description="in the camera's own steps, which are not decibels")
    buffers: int | None = Field(
        default=None,
        ge=2,
        le=32,
        description="frames kept for a reader that is late; None: 100 ms of them, 4 at least",
    )
