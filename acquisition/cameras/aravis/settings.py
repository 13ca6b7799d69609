"""Settings of the aravis driver."""

from pydantic import BaseModel, Field


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
