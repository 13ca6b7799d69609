"""Settings of the pylon driver."""

from pydantic import BaseModel, Field


class PylonSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    buffers: int | None = Field(
        default=None,
        ge=2,
        le=4096,
        description="frames kept for a reader that is late; None: 100 ms of them, 64 at least",
    )
