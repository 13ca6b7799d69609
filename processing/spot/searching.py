"""Search of an image for the spot, without knowledge of earlier frames: start values for its fit."""

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats, Ints
from processing.kernel import kernel
from processing.spot.fit_values import AMPLITUDE, BACKGROUND, SIGMA_X, SIGMA_Y, X, Y
from processing.spot.prefetch import prefetch_window
from processing.spot.scan import (
    background_of,
    brightest,
    brightest_block,
    of_three,
    scan_every_row,
    scan_some_rows,
)
from processing.spot.spot import Image
from processing.spot.start import start_on_areas, start_on_chords

SOME_ROWS, EVERY_ROW, AREAS, BLOCK = range(4)
"""Methods of a search, from the fastest to the most general: a scan of some rows, then of all, and the chords
at half maximum; the areas above two levels, for spots that are tilted, saturated or irregular; the brightest
block of pixels, for a spot too faint to be seen in single pixels."""
_PEAK, _PLACE_X, _PLACE_Y, _LEVEL, _SPREAD = range(5)
SEEN = 5
"""What the methods of one search tell each other: highest value, its place, background and its scatter."""
_NEAR_PX = 32


@kernel
def _climb(image: Image, peak: int, x: int, y: int) -> tuple[int, int]:
    """Climb up or down column `x` to its local maximum; returns the value there and y.

    Needed because a scan of every `row_step`-th row does not usually meet the spot's brightest row.
    """
    ny = image.shape[0]
    for _ in range(64):
        moved = False
        for yy in (y - 1, y + 1):
            if 0 <= yy < ny:
                value = of_three(image, x, yy)
                if value > peak:
                    peak = value
                    y = yy
                    moved = True
        if not moved:
            break
    return peak, y


@kernel
def find_start(
    image: Image,
    method: int,
    row_step: int,
    full_scale_dn: float,
    p: Floats,
    seen: Floats,
    bands: Image,
    sample: Ints,
    mask: NDArray[np.uint8],
    stack: Ints,
) -> bool:
    """Write start values by one of the methods into `p`, and return whether it has found any.

    The methods are tried in their order: `seen` (SEEN,) holds what the first ones have found. SOME_ROWS reads
    every `row_step`-th row and is left out for a `row_step` of 1. `bands`, `sample`, `mask` and `stack` are
    working memory.
    """
    if method <= EVERY_ROW:
        some = method == SOME_ROWS
        if some:
            scan_some_rows(image, row_step, bands)
        else:
            scan_every_row(image, bands)
        if some or row_step == 1:
            # after the scan, because these rows are in the cache by then
            seen[_LEVEL], seen[_SPREAD] = background_of(image, row_step, sample)
        highest, column, row = brightest(image, bands)
        if some:
            # most rows around this position have not been read yet
            prefetch_window(image, column - _NEAR_PX, row - _NEAR_PX, 2 * _NEAR_PX, 2 * _NEAR_PX)
        highest, row = _climb(image, highest, column, row)
        seen[_PEAK], seen[_PLACE_X], seen[_PLACE_Y] = highest, column, row
    background, spread = seen[_LEVEL], seen[_SPREAD]
    peak, x, y = int(seen[_PEAK]), int(seen[_PLACE_X]), int(seen[_PLACE_Y])
    if method < BLOCK:
        # the highest of 1e5 to 1e6 normally distributed values lies about 5 standard deviations above the
        # mean: 6 excludes noise
        if not peak > background + 6.0 * spread:
            return False
        if method == AREAS:
            return start_on_areas(image, x, y, background, float(peak), full_scale_dn, mask, stack, p)
        return start_on_chords(image, x, y, background, peak, p)
    size = 8 if min(image.shape) >= 24 else 3
    mean, x, y = brightest_block(image, size, background + 8.0 * spread)
    # the mean of size^2 pixels has the standard deviation spread / size; again 6 standard deviations
    if not mean > background + 6.0 * spread / size:
        return False
    p[:] = 0.0
    p[AMPLITUDE] = max(1.3 * (mean - background), 0.5)
    p[X] = x
    p[Y] = y
    p[SIGMA_X] = p[SIGMA_Y] = float(size)
    p[BACKGROUND] = background
    return True
