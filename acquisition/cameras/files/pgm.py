"""Reader of portable grey maps (PGM); OpenCV rescales some of them and drops the maximum value."""

import re
from typing import Any

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
