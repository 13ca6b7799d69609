"""Where on a whole frame the spot may be: one pass at the speed of memory, past hot pixels."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.spot import Image

BAND_ROWS = 32
_SAMPLES_Y = 16
_SAMPLES_X = 32
SAMPLES = _SAMPLES_Y * _SAMPLES_X

# The loops over a row are written as selections between values of the pixels' own type: a built-in
# maximum, or a sum, would be widened to 64 bits and no longer become vector code.


@njit(cache=True, nogil=True, error_model="numpy")
def scan_every_row(image: Image, bands: Image) -> None:
    """Into each band's row: the highest of the minima of four pixels one above the other.

    A hot pixel has neighbours that are not; a spot covers four rows.
    """
    ny, nx = image.shape
    for band in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        line = bands[band]
        for i in range(nx):
            line[i] = 0
        for y in range(band * BAND_ROWS, min(ny, (band + 1) * BAND_ROWS), 4):
            # the last rows of a frame are read twice rather than not at all
            first = max(0, min(y, ny - 4))
            row0 = image[first]
            row1 = image[first + 1]
            row2 = image[first + 2]
            row3 = image[first + 3]
            for i in range(nx):
                upper = row0[i] if row0[i] < row1[i] else row1[i]
                lower = row2[i] if row2[i] < row3[i] else row3[i]
                value = upper if upper < lower else lower
                line[i] = value if value > line[i] else line[i]


@njit(cache=True, nogil=True, error_model="numpy")
def scan_some_rows(image: Image, row_step: int, bands: Image) -> None:
    """Into each band's row: the highest pixel of a column over every `row_step`-th row."""
    ny, nx = image.shape
    for band in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        line = bands[band]
        for i in range(nx):
            line[i] = 0
        first = band * BAND_ROWS
        for y in range(first + (row_step // 2 - first) % row_step, min(ny, first + BAND_ROWS), row_step):
            row = image[y]
            for i in range(nx):
                value = row[i]
                line[i] = value if value > line[i] else line[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _brightest_band(bands: Image, count: int) -> tuple[int, int]:
    """Highest minimum of three neighbours in the bands' rows, and its band."""
    nx = bands.shape[1]
    best = 0
    best_band = -1
    for band in range(count):
        left = bands[band, : nx - 2]
        middle = bands[band, 1 : nx - 1]
        right = bands[band, 2:]
        top = left[0]
        top = top if top < middle[0] else middle[0]
        top = top if top < right[0] else right[0]
        for i in range(nx - 2):
            value = left[i] if left[i] < middle[i] else middle[i]
            value = value if value < right[i] else right[i]
            top = value if value > top else top
        if best_band < 0 or top > best:
            best = int(top)
            best_band = band
    return best, best_band


@njit(cache=True, nogil=True, error_model="numpy")
def of_three(image: Image, x: int, y: int) -> int:
    """Lowest of a pixel and its neighbours to the left and right."""
    return int(min(min(image[y, x - 1], image[y, x]), image[y, x + 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def brightest(image: Image, bands: Image) -> tuple[int, int, int]:
    """Brightest place after a scan: lowest of three neighbours in the frame itself, x, y."""
    ny, nx = image.shape
    best, band = _brightest_band(bands, (ny + BAND_ROWS - 1) // BAND_ROWS)
    line = bands[band]
    x = nx // 2
    for i in range(nx - 2):
        if min(min(line[i], line[i + 1]), line[i + 2]) == best:
            # the middle of a plateau, as a saturated spot's is
            stop = i
            while stop < nx - 2 and min(min(line[stop], line[stop + 1]), line[stop + 2]) == best:
                stop += 1
            x = (i + stop) // 2 + 1
            break
    x = min(x, nx - 2)
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
def _ranked(sample: NDArray[np.int64], rank: int, wide: bool, histogram: NDArray[np.int64]) -> int:
    """Value of a rank by counting, high byte first."""
    high = 0
    if wide:
        histogram[:] = 0
        for k in range(sample.size):
            histogram[sample[k] >> 8] += 1
        while rank >= histogram[high]:
            rank -= histogram[high]
            high += 1
    histogram[:] = 0
    for k in range(sample.size):
        if sample[k] >> 8 == high:
            histogram[sample[k] & 255] += 1
    low = 0
    while rank >= histogram[low]:
        rank -= histogram[low]
        low += 1
    return high * 256 + low


@njit(cache=True, nogil=True, error_model="numpy")
def background_of(
    image: Image, sample: NDArray[np.int64], histogram: NDArray[np.int64]
) -> tuple[float, float]:
    """Median and robust standard deviation of a grid of 512 pixels."""
    ny, nx = image.shape
    count = 0
    for j in range(_SAMPLES_Y):
        y = (2 * j + 1) * ny // (2 * _SAMPLES_Y)
        for i in range(_SAMPLES_X):
            sample[count] = image[y, (2 * i + 1) * nx // (2 * _SAMPLES_X)]
            count += 1
    wide = image.itemsize > 1
    middle = _ranked(sample, count // 2, wide, histogram)
    # the lower quantile, since light only adds; 0.8416 standard deviations below the mean
    low = _ranked(sample, count // 5, wide, histogram)
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
