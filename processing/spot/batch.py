"""A stack of frames in one call: follow each from the one before, search where that fails."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.following import SEARCH, follow
from processing.spot.searching import search
from processing.spot.spot import Image

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def track_run(
    images: Image,
    state: Floats,
    work: Floats,
    tables: NDArray[np.float32],
    bands: Image,
    sample: Integers,
    mask: NDArray[np.uint8],
    stack: Integers,
    rows: Floats,
    flags: Integers,
) -> None:
    """Fields of each frame's spot into `rows` (n, 10), its flags into `flags` (n,)."""
    ny, nx = images.shape[1:]
    for k in range(images.shape[0]):
        image = images[k]
        flag = SEARCH
        if state[0] > 0.0:
            found = follow(image, 0, 0, nx, ny, state, work, tables)
            flag = found[10]
        if flag == SEARCH:
            found = search(image, 0, 0, nx, ny, state, work, tables, bands, sample, mask, stack)
            flag = found[10]
        flags[k] = flag
        row = rows[k]
        row[0], row[1], row[2], row[3], row[4] = found[0], found[1], found[2], found[3], found[4]
        row[5], row[6], row[7], row[8], row[9] = found[5], found[6], found[7], found[8], found[9]
