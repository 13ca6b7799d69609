"""Readers that the libraries lack: all images of a PGM, PPM or TIFF file, and the footers of FFV1 video.

OpenCV rescales some portable maps and reads only the first image of each. A TIFF file has a directory for
each image, but ImageJ writes one for all.
"""

import re
from mmap import mmap
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
