"""Readers that the libraries lack: raw pixels, images of PGM, PPM and TIFF files, the footers of FFV1 video.

Raw pixels in one file have a small TOML file beside it that states their layout and times. OpenCV rescales
some portable maps and reads only the first image of each. A TIFF file has a directory for each image, but
ImageJ writes one for all.
"""

import re
import tomllib
from itertools import pairwise
from mmap import mmap
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
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


_GAP: Final = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER: Final = re.compile(rb"\s*P([56])" + 3 * (_GAP + rb"(\d+)") + rb"\s")


class _PortableMapHeader(NamedTuple):
    """Header of a binary PGM (1 channel) or PPM (3) image; `pixels_at` is the offset of its pixels."""

    channels: int
    nx: int
    ny: int
    largest: int
    pixels_at: int

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.uint8 if self.largest < 256 else ">u2")

    @property
    def end(self) -> int:
        return self.pixels_at + self.channels * self.nx * self.ny * self.dtype.itemsize


def _portable(data: bytes | mmap, begin: int) -> _PortableMapHeader | None:
    header = _HEADER.match(data, begin)
    if header is None:
        return None
    kind, nx, ny, largest = (int(one) for one in header.groups())
    return _PortableMapHeader(3 if kind == 6 else 1, nx, ny, largest, header.end())


def portable_images(data: bytes | mmap) -> list[tuple[int, int]]:
    """First byte, and end, of each image of a portable map; the last may end beyond the file."""
    found, begin = list[tuple[int, int]](), 0
    while header := _portable(data, begin):
        found.append((begin, header.end))
        begin = header.end
    return found


def read_portable(data: bytes) -> tuple[NDArray[Any], int]:
    """Pixels (ny, nx), or (ny, nx, 3) with blue first, as uint8 or uint16, and the largest value stated.

    Raises ValueError with the reason: no binary PGM or PPM, too short, or a pixel above the maximum.
    """
    header = _portable(data, 0)
    if header is None:
        raise ValueError("no header of a binary PGM or PPM file (P5, P6); save it as one, or as TIFF or PNG")
    channels, nx, ny, largest, begin = header
    if not 0 < largest < 65536 or nx * ny == 0:
        raise ValueError(f"the header states {nx}x{ny} pixels up to {largest}")
    raster = data[begin : header.end]
    if len(raster) < header.end - begin:
        raise ValueError(f"the file ends after {len(raster)} of {header.end - begin} bytes of pixels")
    values: NDArray[Any] = np.frombuffer(raster, dtype=header.dtype)
    if values.max() > largest:
        raise ValueError(f"a pixel of {values.max()} is above the stated largest value {largest}")
    pixels = values.astype(header.dtype.newbyteorder("=")).reshape(ny, nx, channels)
    return pixels[:, :, ::-1] if channels == 3 else pixels[:, :, 0], largest


_Order = Literal["little", "big"]
_ORDERS: Final[dict[bytes, _Order]] = {b"II": "little", b"MM": "big"}
_MAX_PAGES = 10_000_000
_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 16: 8}
"""Bytes of the types of a TIFF tag that are read here: byte, text, short, long, and long of BigTIFF."""
_MAX_TEXT_BYTES = 1 << 20
WIDTH, HEIGHT, BITS, COMPRESSION, _NOTE, STRIP_OFFSETS = 256, 257, 258, 259, 270, 273
"""Numbers of TIFF tags; the last two are ImageDescription and StripOffsets."""


class TiffHead(NamedTuple):
    """Number of directories of a TIFF file; tags and note (ImageDescription) of the first one.

    `cut_off` is True if a directory, to which the file or a page refers, lies beyond the end of the file.
    """

    directories: int
    cut_off: bool
    order: _Order
    tags: dict[int, list[int]]
    note: str


def tiff_head(path: Path) -> TiffHead:
    """Read the directories of a TIFF file; any other file has 0 of them, and is no error."""
    size = path.stat().st_size
    tags: dict[int, list[int]] = {}
    count = 0
    with path.open("rb") as file:
        head = file.read(16)
        order = _ORDERS.get(head[:2])
        if order is None or len(head) < 8:
            return TiffHead(0, False, "little", tags, "")
        big = int.from_bytes(head[2:4], order) == 43
        offset = int.from_bytes(head[8:16] if big else head[4:8], order)
        while offset and count < _MAX_PAGES:
            following = _next_directory(file, offset, size, order, big)
            if following is None:
                break
            tags = tags or _tags(file, offset, order, big)
            offset, count = following, count + 1
    note = bytes(one & 0xFF for one in tags.pop(_NOTE, [])).decode("latin-1")
    return TiffHead(count, offset > 0, order, tags, note)


def _tags(file: BinaryIO, offset: int, order: _Order, big: bool) -> dict[int, list[int]]:
    """Values of a directory by tag: integers, or the bytes of a text."""
    count_bytes, entry_bytes, place_bytes = _directory(big)
    file.seek(offset)
    entries = file.read(count_bytes + entry_bytes * int.from_bytes(file.read(count_bytes), order))
    found = {}
    for at in range(0, len(entries) - entry_bytes + 1, entry_bytes):
        tag, kind = (int.from_bytes(entries[at + k : at + k + 2], order) for k in (0, 2))
        size = _SIZES.get(kind, 0)
        length = size * int.from_bytes(entries[at + 4 : at + entry_bytes - place_bytes], order)
        data = entries[at + entry_bytes - place_bytes : at + entry_bytes]
        if length > place_bytes:
            file.seek(int.from_bytes(data, order))
            data = file.read(min(length, _MAX_TEXT_BYTES))
        if size:
            found[tag] = [
                int.from_bytes(data[k : k + size], order) for k in range(0, min(length, len(data)), size)
            ]
    return found


def _directory(big: bool) -> tuple[int, int, int]:
    """Sizes in bytes of a directory's entry count, an entry, and a file offset."""
    return (8, 20, 8) if big else (2, 12, 4)


def _next_directory(file: BinaryIO, offset: int, size: int, order: _Order, big: bool) -> int | None:
    """Offset of the directory after that at `offset`, 0 after the last; None if the file ends before it."""
    count_bytes, entry_bytes, place_bytes = _directory(big)
    if offset + count_bytes > size:
        return None
    file.seek(offset)
    count = int.from_bytes(file.read(count_bytes), order)
    end = offset + count_bytes + count * entry_bytes
    if end + place_bytes > size:
        return None
    file.seek(end)
    return int.from_bytes(file.read(place_bytes), order)


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
