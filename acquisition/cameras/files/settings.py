"""Settings of the driver for recorded frames."""

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, Field, model_validator

Colour = Literal["refuse", "mean", "red", "green", "blue", "brightness"]


class FilesSettings(BaseModel, frozen=True, extra="forbid"):
    """Location and times of the frames.

    Times come from either a CSV file or a stated frame rate. If neither is given, a CSV file beside the
    frames is used: ``timestamps.csv`` in a folder of images, otherwise the name of the frames' file with the
    suffix ``.csv``; without one a film's own times are used. A stated rate that a film's own times contradict
    is refused, unless `force_frame_rate` says that it is right.

    The CSV file has one header line and one row per frame, in the order of the frames. Columns, in any order
    (others are ignored): ``time_ns`` (integer) or ``time_s`` (decimal, any number of digits), not negative
    and rising; optionally ``sequence`` (integer, rising; a gap is a frame lost by the recording program);
    optionally ``file`` (name of the image, which is checked).
    """

    path: Path = Field(
        description="folder of images, film, TIFF stack, .npy stack (n, ny, nx), or raw pixels with a sidecar"
    )
    timestamps_csv: Path | None = None
    frame_rate_hz: float | None = Field(default=None, gt=0, le=1e6)
    force_frame_rate: bool = Field(
        default=False,
        description="use frame_rate_hz even if the film's own times contradict it, as in a film stored for "
        "slow playback",
    )
    numbering: Literal["names", "order"] = Field(
        default="names",
        description="with frame_rate_hz: images count by the numbers in their names, so that a missing one "
        "leaves a gap, or by their order alone",
    )
    bit_depth: int | None = Field(
        default=None, ge=8, le=16, description="bits really used; None: all 8 or 16 (PGM states its own)"
    )
    colour: Colour = Field(
        default="refuse",
        description="how colour pictures become grey, or refuse: for RGB the mean of the channels or one of "
        "them; brightness: the stored luma, for RGB the mean. Equal channels, and luma without chroma, count "
        "as grey",
    )

    @model_validator(mode="after")
    def _one_clock(self) -> Self:
        if self.timestamps_csv is not None and self.frame_rate_hz is not None:
            raise ValueError("state timestamps_csv or frame_rate_hz, not both")
        if self.force_frame_rate and self.frame_rate_hz is None:
            raise ValueError("force_frame_rate needs frame_rate_hz, the rate to enforce")
        return self
