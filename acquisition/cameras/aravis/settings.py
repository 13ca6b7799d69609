"""Settings of the aravis driver."""

from pydantic import BaseModel, Field


class AravisSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera and options of the communication."""

    serial: str | None = Field(
        default=None, description="serial number or libaravis's id; needed only where there are several"
    )
    buffers: int = Field(default=64, ge=2, le=4096, description="frames kept for a reader that is late")
    packet_bytes: int | None = Field(
        default=None, ge=576, le=16114, description="GigE packets; left out: the largest that passes"
    )
