"""Frames as raw pixels in one file, and the small TOML file beside it that states their layout and times."""

import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Final, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from acquisition.cameras.files.frame_source import (
    FrameSource,
    FrameTimes,
    StoredImage,
    UnreadableFrame,
    missing_frames,
    numbers_by_steps,
)
from acquisition.cameras.pixel_formats import BY_NAME
from processing.errors import DeviceError, place_in_words
from processing.units import NS_PER_S

_RAW_SUFFIXES: Final = (".raw", ".bin", ".gray", ".y8", ".y16")
_COLOUR_FORMATS: Final = ("RGB8", "BGR8")
_FORMATS: Final = (*BY_NAME, *_COLOUR_FORMATS)


def is_raw(path: Path) -> bool:
    """Whether a file holds raw pixels, by its suffix, or because a sidecar ``NAME.toml`` lies beside it."""
    return path.suffix.lower() in _RAW_SUFFIXES or any(
        one.name.startswith(path.name) and one.is_file() for one in _sidecars(path)
    )


class RawSidecar(BaseModel, frozen=True, extra="forbid", strict=True):
    """Layout of a file of raw pixels, one frame after another, rows from the top, without gaps.

    `frames` is their number, needed where the file is cut off. Of `frame_rate_hz`, `times_s` and `times_ns`
    (one a frame, rising) at most one is stated; without any the times come from elsewhere, as for images.
    """

    width_px: int = Field(gt=0, le=65536)
    height_px: int = Field(gt=0, le=65536)
    pixel_format: str
    byte_order: Literal["little", "big"] = "little"
    header_bytes: int = Field(default=0, ge=0)
    frames: int | None = Field(default=None, gt=0)
    frame_rate_hz: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False)
    times_s: list[FiniteFloat] | None = Field(default=None, min_length=1)
    times_ns: list[int] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.pixel_format not in _FORMATS:
            raise ValueError(f"pixel_format = {self.pixel_format!r}: should be one of {', '.join(_FORMATS)}")
        if self.byte_order == "big" and (
            self.pixel_format in _COLOUR_FORMATS or BY_NAME[self.pixel_format].transport_bits != 16
        ):
            raise ValueError(f"byte_order: pixels of {self.pixel_format} have none; leave it out")
        stated = [
            name for name in ("frame_rate_hz", "times_s", "times_ns") if getattr(self, name) is not None
        ]
        if len(stated) > 1:
            raise ValueError(f"{' and '.join(stated)}: state one of them")
        times_ns = self.stated_times_ns
        if times_ns is None:
            return self
        if self.frames is not None and len(times_ns) != self.frames:
            raise ValueError(f"{stated[0]}: has {len(times_ns)} entries for frames = {self.frames}")
        if later := next((k for k, (a, b) in enumerate(pairwise(times_ns), 1) if b <= a), 0):
            raise ValueError(f"{stated[0]}: entry {later + 1} is not later than the one before it")
        return self

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        if self.pixel_format in _COLOUR_FORMATS:
            return 3 * self.width_px * self.height_px
        return BY_NAME[self.pixel_format].byte_count(self.width_px, self.height_px)

    @property
    def stated_times_ns(self) -> list[int] | None:
        """The times that are listed, in ns; None where there are none."""
        if self.times_s is None:
            return self.times_ns
        return [round(time_s * NS_PER_S) for time_s in self.times_s]


class RawSource(FrameSource):
    """Raw pixels as a source of frames; frames that a cut-off file lacks are counted, and cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._sidecar, self._layout = _read_sidecar(path)
        layout = self._layout
        self._complete, self.count = self._count_frames()
        missing = self.count - self._complete
        message = [f"ends {missing} frames before the {self.count} that {self._sidecar.name} states"]
        self.times = _times(layout, self.count)
        gaps = [] if self.times is None else missing_frames(*self.times, f"the times in {self._sidecar.name}")
        self.warnings = [*(message if missing else []), *gaps]
        when = "" if layout.frame_rate_hz is None else f"{layout.frame_rate_hz:.9g} frames/s, "
        self.summary = (
            f"{self.count} frames, {when}raw {layout.pixel_format}, {layout.width_px}x{layout.height_px} px"
        )

    def read(self, index: int) -> StoredImage:
        if index >= self._complete:
            raise UnreadableFrame("the file is cut off before the end of this frame; copy it again")
        layout = self._layout
        with self._path.open("rb") as file:
            file.seek(layout.header_bytes + index * layout.frame_bytes)
            data = file.read(layout.frame_bytes)
        if len(data) < layout.frame_bytes:
            raise UnreadableFrame("the file became shorter")
        raw = np.frombuffer(data, np.uint8)
        if layout.pixel_format in _COLOUR_FORMATS:
            pixels = raw.reshape(layout.height_px, layout.width_px, 3)
            # blue first, as in all sources
            return StoredImage(pixels[:, :, ::-1] if layout.pixel_format == "RGB8" else pixels, 255)
        pixel_format = BY_NAME[layout.pixel_format]
        if layout.byte_order == "big":
            raw = raw.view(">u2").astype(np.uint16).view(np.uint8)
        image = pixel_format.image(raw, layout.width_px, layout.height_px)
        if image.max() > pixel_format.full_scale_dn:
            raise UnreadableFrame(
                f"a pixel of {image.max()} is above {pixel_format.full_scale_dn}, the largest of "
                f"{pixel_format.name}; {self._sidecar.name} states another pixel_format or byte_order than "
                "the file has"
            )
        return StoredImage(image, pixel_format.full_scale_dn)

    def _count_frames(self) -> tuple[int, int]:
        """Number of complete frames in the file, and of frames that it should hold."""
        layout = self._layout
        size = self._path.stat().st_size - layout.header_bytes
        whole, rest = divmod(max(size, 0), layout.frame_bytes)
        listed = layout.stated_times_ns
        stated = layout.frames or (None if listed is None else len(listed))
        a_frame = f"{layout.width_px}x{layout.height_px} px in {layout.pixel_format}"
        if stated is None and (rest or not whole):
            raise DeviceError(
                f"{self._path}: its {size} bytes of pixels are not a whole number of frames of {a_frame} "
                f"({layout.frame_bytes} bytes), as {self._sidecar.name} states them; correct it, or state "
                "frames there if the file is cut off"
            )
        if stated is not None and (whole, rest) > (stated, 0):
            raise DeviceError(
                f"{self._path}: holds {size - stated * layout.frame_bytes} bytes more than the {stated} "
                f"frames of {a_frame} that {self._sidecar.name} states; correct it"
            )
        return whole, whole if stated is None else stated


def _times(layout: RawSidecar, count: int) -> FrameTimes | None:
    listed = layout.stated_times_ns
    if listed is not None:
        since_ns = [time_ns - listed[0] for time_ns in listed]
        return FrameTimes(since_ns, numbers_by_steps(since_ns))
    if layout.frame_rate_hz is None:
        return None
    return FrameTimes([round(k * NS_PER_S / layout.frame_rate_hz) for k in range(count)], range(count))


def _sidecars(path: Path) -> list[Path]:
    """Possible paths of a file's sidecar: ``swing.raw.toml`` or ``swing.toml``."""
    return [path.with_name(f"{path.name}.toml"), path.with_suffix(".toml")]


def _read_sidecar(path: Path) -> tuple[Path, RawSidecar]:
    """The sidecar of a file of raw pixels, and where it is. Raises DeviceError with one line."""
    sidecar = next((one for one in _sidecars(path) if one.is_file()), None)
    if sidecar is None:
        raise DeviceError(
            f"{path}: raw pixels need a file beside them that describes their layout: write "
            f"{path.name}.toml with width_px, height_px, pixel_format "
            "(Mono8, Mono12p, Mono16, ...) and frame_rate_hz"
        )
    try:
        return sidecar, RawSidecar.model_validate(tomllib.loads(sidecar.read_text(encoding="utf-8-sig")))
    except ValidationError as error:
        raise DeviceError(f"{sidecar}: {_in_words(error)}") from None
    except OSError as error:
        raise DeviceError(f"{sidecar}: cannot be read: {error.strerror or error}") from None
    # the file is not TOML, or not text
    except ValueError as error:
        raise DeviceError(f"{sidecar}: is not TOML: {str(error).splitlines()[0]}") from None


def _in_words(error: ValidationError) -> str:
    """The first fault in words; unknown keys come before missing ones, because a misspelt key causes both."""
    fault = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    place = place_in_words(fault["loc"])
    message = fault["msg"].removeprefix("Value error, ").replace("Input should", "should")
    if fault["type"] == "extra_forbidden":
        return f"{place}: unknown key; known here: {', '.join(RawSidecar.model_fields)}"
    if fault["type"] == "missing":
        return f"{place}: is missing; state a value"
    return f"{place} = {fault['input']!r}: {message}" if place else message
