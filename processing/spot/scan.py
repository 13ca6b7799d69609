"""Where on a whole frame the spot may be: one pass at the speed of memory, past hot pixels."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.prefetch import LINE_BYTES, prefetch, prefetch_window
from processing.spot.spot import Image

BAND_ROWS = 32
BAND_STEP = 256
"""Bands are wider than the image, up to a multiple of this and two more: no remainder is done one by one."""
_SAMPLES_Y = 16
_SAMPLES_X = 32
SAMPLES = _SAMPLES_Y * _SAMPLES_X

_BLOCK = 64
"""Pixels of a row between two looks ahead: the loads then never come in bursts that have to queue."""
_ROWS_AHEAD = 4

# The loops over a row are written as selections between values of the pixels' own type: a built-in
# maximum, or a sum, would be widened to 64 bits and no longer become vector code. They run over slices
# of a constant length, which spares the compiler the remainder.


@njit(cache=True, nogil=True, error_model="numpy")
def _raise_narrow(image: Image, first: int, last: int, line: Image) -> None:
    """Raise `line` to the lowest pixel of each column between two rows, for images less than a block wide."""
    for x in range(image.shape[1]):
        value = image[first, x]
        for y in range(first + 1, last + 1):
            value = image[y, x] if image[y, x] < value else value
        line[x] = value if value > line[x] else line[x]


@njit(cache=True, nogil=True, error_model="numpy")
def scan_every_row(image: Image, bands: Image) -> None:
    """Into each band's row: the highest of the minima of four pixels one above the other.

    A hot pixel has neighbours that are not; a spot covers four rows.
    """
    ny, nx = image.shape
    pixels = image.reshape(ny * nx)
    in_a_line = LINE_BYTES // image.itemsize
    for band in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        line = bands[band]
        line[:nx] = 0
        for y in range(band * BAND_ROWS, min(ny, (band + 1) * BAND_ROWS), 4):
            # the last rows of a frame are read twice rather than not at all
            top = max(0, min(y, ny - 4))
            if nx < _BLOCK:
                _raise_narrow(image, top, top + 3, line)
                continue
            start = top * nx
            # by itself the processor does not see that four rows side by side are one stream
            ahead = start + 8 * nx
            for x in range(0, nx, _BLOCK):
                for place in range(ahead, ahead + 4 * _BLOCK, in_a_line):
                    prefetch(image, place)
                ahead += 4 * _BLOCK
                # the last block overlaps the one before, which changes no highest or lowest value
                column = min(x, nx - _BLOCK)
                first = start + column
                row0 = pixels[first : first + _BLOCK]
                row1 = pixels[first + nx : first + nx + _BLOCK]
                row2 = pixels[first + 2 * nx : first + 2 * nx + _BLOCK]
                row3 = pixels[first + 3 * nx : first + 3 * nx + _BLOCK]
                part = line[column : column + _BLOCK]
                for i in range(_BLOCK):
                    upper = row0[i] if row0[i] < row1[i] else row1[i]
                    lower = row2[i] if row2[i] < row3[i] else row3[i]
                    value = upper if upper < lower else lower
                    part[i] = value if value > part[i] else part[i]


@njit(cache=True, nogil=True, error_model="numpy")
def scan_some_rows(image: Image, row_step: int, bands: Image) -> None:
    """Into each band's row: the highest pixel of a column over every `row_step`-th row."""
    ny, nx = image.shape
    in_a_line = LINE_BYTES // image.itemsize
    for band in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        line = bands[band]
        line[:nx] = 0
        first = band * BAND_ROWS
        for y in range(first + (row_step // 2 - first) % row_step, min(ny, first + BAND_ROWS), row_step):
            ahead = (y + _ROWS_AHEAD * row_step) * nx
            for place in range(ahead, ahead + nx, in_a_line):
                prefetch(image, place)
            row = image[y]
            for i in range(nx):
                value = row[i]
                line[i] = value if value > line[i] else line[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _highest_of_three(line: Image, first: int, count: int) -> int:
    """Highest minimum of three neighbours."""
    left = line[first : first + count]
    middle = line[first + 1 : first + 1 + count]
    right = line[first + 2 : first + 2 + count]
    top = left[0]
    top = top if top < middle[0] else middle[0]
    top = top if top < right[0] else right[0]
    for i in range(count):
        value = left[i] if left[i] < middle[i] else middle[i]
        value = value if value < right[i] else right[i]
        top = value if value > top else top
    return int(top)


@njit(cache=True, nogil=True, error_model="numpy")
def of_three(image: Image, x: int, y: int) -> int:
    """Lowest of a pixel and its neighbours to the left and right."""
    return int(min(min(image[y, x - 1], image[y, x]), image[y, x + 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def brightest(image: Image, bands: Image) -> tuple[int, int, int]:
    """Brightest place after a scan: lowest of three neighbours in the frame itself, x, y."""
    ny, nx = image.shape
    width = bands.shape[1] - 2
    band = 0
    best = -1
    for k in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        top = _highest_of_three(bands[k], 0, width)
        if top > best:
            best = top
            band = k
    line = bands[band]
    first_x = 0
    while _highest_of_three(line, first_x, BAND_STEP) < best:
        first_x += BAND_STEP
    while min(min(line[first_x], line[first_x + 1]), line[first_x + 2]) < best:
        first_x += 1
    # the middle of a plateau, as a saturated spot's is
    stop = first_x
    while stop < nx - 2 and min(min(line[stop], line[stop + 1]), line[stop + 2]) == best:
        stop += 1
    x = min((first_x + stop) // 2 + 1, nx - 2)
    prefetch_window(image, x - 1, max(0, band * BAND_ROWS - 1), 3, BAND_ROWS + 2)
    peak = -1
    first = last = band * BAND_ROWS
    # a spot of several rows' plateau is met in its middle too; one row on, where a band cuts the spot
    for y in range(max(0, band * BAND_ROWS - 1), min(ny, (band + 1) * BAND_ROWS + 1)):
        value = of_three(image, x, y)
        if value > peak:
            peak = value
            first = y
            last = y
        elif value == peak and y == last + 1:
            last = y
    return peak, x, (first + last) // 2


@njit(cache=True, nogil=True, error_model="numpy")
def _ranked(sample: NDArray[np.int64], rank: int, bits: int) -> int:
    """Value of a rank: the highest of which at most `rank` are lower, found bit by bit."""
    value = 0
    for bit in range(bits - 1, -1, -1):
        trial = value | (1 << bit)
        lower = 0
        for k in range(sample.size):
            lower += 1 if sample[k] < trial else 0
        if lower <= rank:
            value = trial
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def background_of(image: Image, row_step: int, sample: NDArray[np.int64]) -> tuple[float, float]:
    """Median and robust standard deviation of a grid of 512 pixels, in rows that a scan has read."""
    ny, nx = image.shape
    count = 0
    for j in range(_SAMPLES_Y):
        y = (2 * j + 1) * ny // (2 * _SAMPLES_Y)
        y = max(0, y - (y - row_step // 2) % row_step)
        for i in range(_SAMPLES_X):
            sample[count] = image[y, (2 * i + 1) * nx // (2 * _SAMPLES_X)]
            count += 1
    bits = 8 * image.itemsize
    middle = _ranked(sample, count // 2, bits)
    # the lower quantile, since light only adds; 0.8416 standard deviations below the mean
    low = _ranked(sample, count // 5, bits)
    return float(middle), max((middle - low) / 0.8416, 0.3)


@njit(cache=True, nogil=True, error_model="numpy")
def brightest_block(image: Image, size: int, clip: float) -> tuple[float, int, int]:
    """Highest mean of a block, pixels clipped at `clip` so that a hot one counts for little: mean, x, y."""
    ny, nx = image.shape
    best = -1.0
    best_x = nx // 2
    best_y = ny // 2
    for y in range(0, ny - size + 1, size):
        for x in range(0, nx - size + 1, size):
            total = 0.0
            for j in range(size):
                for i in range(size):
                    total += min(float(image[y + j, x + i]), clip)
            if total > best:
                best = total
                best_x = x + size // 2
                best_y = y + size // 2
    return best / (size * size), best_x, best_y
