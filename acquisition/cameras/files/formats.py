"""What libraries do not tell of images in files: the maximum value of a PGM, a TIFF cut off, damaged FFV1.

OpenCV rescales some portable grey maps; the pages of a TIFF file are counted by its directories.
"""

import re
import zlib
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from numpy.typing import NDArray

_HEADER = re.compile(
    rb"(P[25])(?:\s|#[^\n\r]*[\n\r])+(\d+)(?:\s|#[^\n\r]*[\n\r])+(\d+)(?:\s|#[^\n\r]*[\n\r])+(\d+)\s"
)


def read_pgm(data: bytes) -> tuple[NDArray[Any], int]:
    """Pixels (ny, nx) as uint8 or uint16, and the maximum value stated in the file.

    Raises ValueError with the reason: not a PGM file, too short, or a pixel above the maximum.
    """
    header = _HEADER.match(data)
    if header is None:
        raise ValueError("no PGM header")
    nx, ny, largest = (int(header.group(i)) for i in (2, 3, 4))
    if not 0 < largest < 65536 or nx * ny == 0:
        raise ValueError(f"PGM header states {nx}x{ny} pixels up to {largest}")
    dtype: type[np.uint8] | type[np.uint16] = np.uint8 if largest < 256 else np.uint16
    if header.group(1) == b"P5":
        stored = np.dtype(dtype).newbyteorder(">")
        raster = data[header.end() : header.end() + nx * ny * stored.itemsize]
        if len(raster) < nx * ny * stored.itemsize:
            raise ValueError(
                f"the file ends after {len(raster)} of {nx * ny * stored.itemsize} bytes of pixels"
            )
        values = np.frombuffer(raster, dtype=stored)
    else:
        words = data[header.end() :].split()
        if len(words) < nx * ny:
            raise ValueError(f"the file ends after {len(words)} of {nx * ny} pixels")
        values = np.array([int(word) for word in words[: nx * ny]])
    if values.min() < 0:
        raise ValueError(f"a pixel of {values.min()}")
    if values.max() > largest:
        raise ValueError(f"a pixel of {values.max()} is above the stated largest value {largest}")
    return values.reshape(ny, nx).astype(dtype), largest


_Order = Literal["little", "big"]
_ORDERS: Final[dict[bytes, _Order]] = {b"II": "little", b"MM": "big"}
_MOST_PAGES = 10_000_000


def is_cut_off(path: Path) -> bool:
    """Whether a directory, to which the file or a page refers, lies beyond the end of the file.

    False as well for a file that is no TIFF, which is for others to report.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(16)
        order = _ORDERS.get(head[:2])
        if order is None or len(head) < 8:
            return False
        big = int.from_bytes(head[2:4], order) == 43
        offset = int.from_bytes(head[8:16] if big else head[4:8], order)
        for _ in range(_MOST_PAGES):
            if not offset:
                return False
            following = _following(file, offset, size, order, big)
            if following is None:
                return True
            offset = following
    return False


def _following(file: BinaryIO, offset: int, size: int, order: _Order, big: bool) -> int | None:
    """Place of the directory after the one at `offset`, 0 after the last; None if the file ends before."""
    count_bytes, entry_bytes, place_bytes = (8, 20, 8) if big else (2, 12, 4)
    if offset + count_bytes > size:
        return None
    file.seek(offset)
    count = int.from_bytes(file.read(count_bytes), order)
    end = offset + count_bytes + count * entry_bytes
    if end + place_bytes > size:
        return None
    file.seek(end)
    return int.from_bytes(file.read(place_bytes), order)


# Checksums of FFV1 video (RFC 9043): a decoder that finds damage delivers a picture all the same.
#
# A frame is divided into slices. Each ends with its size (3 bytes, big-endian), and where the encoder wrote
# checksums, with a status byte and a CRC-32 that makes the remainder over the whole slice zero.

_SIZE: Final = 3
_FOOTER: Final = 8
_ONES: Final = 0xFFFFFFFF
# the CRC of RFC 9043 takes the most significant bit first, zlib's the least
_REVERSED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def slices_of(packet: bytes) -> list[bytes]:
    """The slices of a frame with checksums; none if their sizes do not add up."""
    found = []
    end = len(packet)
    while end > 0:
        at = end - _FOOTER
        begin = at - int.from_bytes(packet[at : at + _SIZE], "big")
        if at < 0 or begin < 0:
            return []
        found.append(packet[begin:end])
        end = begin
    return found


def is_whole(packet: bytes) -> bool:
    """Whether a frame with checksums is undamaged."""
    slices = slices_of(packet)
    return bool(slices) and all(zlib.crc32(part.translate(_REVERSED), _ONES) == _ONES for part in slices)
