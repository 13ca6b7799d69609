"""Readers that the libraries lack: raw pixels, images of PGM and PPM files, the footers of FFV1 video.

Raw pixels in one file have a small TOML file beside it that states their layout and frame rate. OpenCV
rescales some portable maps.
"""

import re
import tomllib
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator

from acquisition.cameras.files.frame_source import (
    FrameSource,
    FrameTimes,
    StoredImage,
    UnreadableFrame,
)
from acquisition.cameras.pixel_formats import BY_NAME
from processing.errors import DeviceError
from processing.fault_text import fault_text, is_unknown_key
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

    `frames` is their number, needed where the file is cut off. Without `frame_rate_hz` the times come from
    elsewhere, as for images.
    """

    width_px: int = Field(gt=0, le=65536)
    height_px: int = Field(gt=0, le=65536)
    pixel_format: str
    byte_order: Literal["little", "big"] = "little"
    header_bytes: int = Field(default=0, ge=0)
    frames: int | None = Field(default=None, gt=0)
    frame_rate_hz: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.pixel_format not in _FORMATS:
            raise ValueError(f"pixel_format = {self.pixel_format!r}: should be one of {', '.join(_FORMATS)}")
        if self.byte_order == "big" and (
            self.pixel_format in _COLOUR_FORMATS or BY_NAME[self.pixel_format].transport_bits != 16
        ):
            raise ValueError(f"byte_order: pixels of {self.pixel_format} have none; leave it out")
        return self

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        if self.pixel_format in _COLOUR_FORMATS:
            return 3 * self.width_px * self.height_px
        return BY_NAME[self.pixel_format].byte_count(self.width_px, self.height_px)


class RawSource(FrameSource):
    """Raw pixels as a source of frames; frames that a cut-off file lacks are counted, and cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._sidecar, self._layout = _read_sidecar(path)
        layout = self._layout
        self._complete, self.count = self._count_frames()
        missing = self.count - self._complete
        if missing:
            stated = f"ends {missing} frames before the {self.count} that {self._sidecar.name} states"
            self.warnings = [stated]
        when = ""
        if layout.frame_rate_hz is not None:
            when = f"{layout.frame_rate_hz:.9g} frames/s, "
            times_ns = [round(k * NS_PER_S / layout.frame_rate_hz) for k in range(self.count)]
            self.times = FrameTimes(times_ns, range(self.count))
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
        stated = layout.frames
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
    fault = min(error.errors(), key=lambda one: not is_unknown_key(one))
    known = f"; known here: {', '.join(RawSidecar.model_fields)}" if is_unknown_key(fault) else ""
    return fault_text(fault) + known


_GAP: Final = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER: Final = re.compile(rb"\s*P([56])" + 3 * (_GAP + rb"(\d+)") + rb"\s")


def read_portable(data: bytes) -> tuple[NDArray[Any], int]:
    """Pixels (ny, nx), or (ny, nx, 3) with blue first, as uint8 or uint16, and the largest value stated.

    Raises ValueError with the reason: no binary PGM or PPM, too short, several images, or a pixel above the
    maximum.
    """
    header = _HEADER.match(data)
    if header is None:
        raise ValueError("no header of a binary PGM or PPM file (P5, P6); save it as one, or as TIFF or PNG")
    kind, nx, ny, largest = (int(one) for one in header.groups())
    if not 0 < largest < 65536 or nx * ny == 0:
        raise ValueError(f"the header states {nx}x{ny} pixels up to {largest}")
    channels, dtype = 3 if kind == 6 else 1, np.dtype(np.uint8 if largest < 256 else ">u2")
    size, raster = channels * nx * ny * dtype.itemsize, data[header.end() :]
    if len(raster) < size:
        raise ValueError(f"the file ends after {len(raster)} of {size} bytes of pixels")
    if _HEADER.match(raster, size):
        raise ValueError("the file holds several images; give each a file of its own: pamsplit")
    values: NDArray[Any] = np.frombuffer(raster, dtype, channels * nx * ny)
    if values.max() > largest:
        raise ValueError(f"a pixel of {values.max()} is above the stated largest value {largest}")
    pixels = values.astype(dtype.newbyteorder("=")).reshape(ny, nx, channels)
    return pixels[:, :, ::-1] if channels == 3 else pixels[:, :, 0], largest


# FFV1 video (RFC 9043): FFmpeg verifies the checksums of its frames, but does not say whether there are any.
#
# A frame is divided into slices. Each ends with its size (3 bytes, big-endian), and where the encoder wrote
# checksums, with a status byte and a CRC-32.

_SLICE_SIZE_BYTES: Final = 3
_FOOTER_BYTES: Final = 8


def has_checksums(packet: bytes) -> bool:
    """Whether the sizes of a frame's slices add up to it with the footers that hold checksums."""
    end = len(packet)
    while end > 0:
        at = end - _FOOTER_BYTES
        end = at - int.from_bytes(packet[max(at, 0) : at + _SLICE_SIZE_BYTES], "big")
        if at < 0:
            return False
    return end == 0 and bool(packet)
