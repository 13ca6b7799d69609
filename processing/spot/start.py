"""Search of a whole image for the spot, and start values of its fit: from chords, or from areas."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats, Ints
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    Image,
    X,
    Y,
)
from processing.spot.scan import (
    background_of,
    brightest,
    brightest_block,
    lowest_of_three,
    prefetch_window,
    scan_every_row,
    scan_some_rows,
)

_WIDTH_OF_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian, in standard deviations."""


class _Area(NamedTuple):
    """Connected pixels above a level: number, sums of coordinates and their products, and bounding box."""

    pixels: int
    x: float
    y: float
    xx: float
    yy: float
    xy: float
    x_first: int
    x_last: int
    y_first: int
    y_last: int


@kernel
def _crossing(image: Image, x: int, y: int, dx: int, dy: int, level: float) -> float:
    """Distance in px from (x, y) along (dx, dy) to where the light falls below a level, interpolated between
    pixels; NaN if the image's edge comes first."""
    ny, nx = image.shape
    last_value = float(image[y, x])
    distance = 0
    while True:
        x += dx
        y += dy
        if x < 0 or y < 0 or x >= nx or y >= ny:
            return math.nan
        value = float(image[y, x])
        if value < level:
            return distance + (last_value - level) / (last_value - value)
        last_value = value
        distance += 1


@kernel
def start_from_chords(image: Image, x: int, y: int, background: float, peak: int, p: Floats) -> bool:
    """Start values from the chords at half maximum along a row and a column, written into `p`.

    Moving to the middle of a chord along x, then along y, converges to the centre of an ellipse;
    two rounds suffice. Returns False if a chord reaches the edge or is shorter than 2 px.
    """
    ny, nx = image.shape
    for _ in range(2):
        level = background + 0.5 * (peak - background)
        if not image[y, x] >= level:
            return False
        left = _crossing(image, x, y, -1, 0, level)
        right = _crossing(image, x, y, 1, 0, level)
        centre_x = x + 0.5 * (right - left)
        width_x = left + right
        if not width_x >= 2.0:
            return False
        x = min(max(round(centre_x), 1), nx - 2)
        if not image[y, x] >= level:
            return False
        up = _crossing(image, x, y, 0, -1, level)
        down = _crossing(image, x, y, 0, 1, level)
        centre_y = y + 0.5 * (down - up)
        width_y = up + down
        if not width_y >= 2.0:
            return False
        y = min(max(round(centre_y), 0), ny - 1)
        peak = max(peak, lowest_of_three(image, x, y))
    p[AMPLITUDE] = peak - background
    p[X] = centre_x
    p[Y] = centre_y
    p[SIGMA_X] = width_x / _WIDTH_OF_SIGMA
    p[SIGMA_Y] = width_y / _WIDTH_OF_SIGMA
    p[BACKGROUND] = background
    p[COVARIANCE] = p[SECOND_AMPLITUDE] = p[SECOND_X] = p[SECOND_Y] = 0.0
    return True


@kernel
def _flood(
    image: Image, x: int, y: int, level: float, mask: NDArray[np.uint8], mark: int, stack: Ints
) -> _Area:
    """Flood fill: pixels at or above `level` connected to (x, y); `mask` is set to `mark` there."""
    ny, nx = image.shape
    sum_x = sum_y = sum_xx = sum_yy = sum_xy = 0.0
    x_first = x_last = x
    y_first = y_last = y
    count = 0
    if image[y, x] < level:
        return _Area(count, sum_x, sum_y, sum_xx, sum_yy, sum_xy, x_first, x_last, y_first, y_last)
    top = 0
    stack[0] = y * nx + x
    mask[y, x] = mark
    while top >= 0:
        index = stack[top]
        top -= 1
        py = index // nx
        px = index - py * nx
        count += 1
        sum_x += px
        sum_y += py
        sum_xx += px * px
        sum_yy += py * py
        sum_xy += px * py
        x_first = min(x_first, px)
        x_last = max(x_last, px)
        y_first = min(y_first, py)
        y_last = max(y_last, py)
        for k in range(4):
            qx = px + (1 if k == 0 else -1 if k == 1 else 0)
            qy = py + (1 if k == 2 else -1 if k == 3 else 0)
            if 0 <= qx < nx and 0 <= qy < ny and mask[qy, qx] != mark and image[qy, qx] >= level:
                mask[qy, qx] = mark
                top += 1
                stack[top] = qy * nx + qx
    return _Area(count, sum_x, sum_y, sum_xx, sum_yy, sum_xy, x_first, x_last, y_first, y_last)


@kernel
def start_from_areas(
    image: Image,
    x: int,
    y: int,
    background: float,
    peak: float,
    full_scale: float,
    mask: NDArray[np.uint8],
    stack: Ints,
    p: Floats,
) -> bool:
    """Start values from the areas above two levels around a bright pixel, written into `p`.

    The pixels of a Gaussian spot that exceed the background by more than l form an ellipse of area

        2 pi sigma_1 sigma_2 ln(A/l).

    Two areas give the product of the sigmas and, if the spot is clipped at full scale, the amplitude A that
    it would have without clipping. Second moments of the outer area give the shape. Returns False if there
    is no such area.
    """
    light = peak - background
    if light <= 0.0:
        return False
    upper = background + 0.75 * light
    lower = background + 0.35 * light
    clipped = peak >= 0.97 * full_scale
    if clipped:
        upper = background + 0.95 * light  # just below full scale: the area of the clipped pixels
    inner = _flood(image, x, y, upper, mask, 1, stack)
    outer = _flood(image, x, y, lower, mask, 2, stack)
    # clear the mask for the next frame; the bounding box of the outer area contains the inner one
    mask[outer.y_first : outer.y_last + 1, outer.x_first : outer.x_last + 1] = 0
    if outer.pixels < 3:
        return False
    mean_x = outer.x / outer.pixels
    mean_y = outer.y / outer.pixels
    # the product sigma_1 sigma_2 from the difference of the two areas
    area_ratio = 2.0 * math.pi * math.log((upper - background) / (lower - background))
    sigma_product = max((outer.pixels - inner.pixels) / area_ratio, 0.3)
    amplitude = light
    if clipped:
        amplitude = (upper - background) * math.exp(min(inner.pixels / (2.0 * math.pi * sigma_product), 5.0))
    # An ellipse of uniform weight with half axes h has the variances h^2/4, and here h^2 = 2 sigma^2 ln(A/l).
    # 1/12 px^2 is the variance of a uniform position within a pixel.
    scale = 2.0 / math.log(max(amplitude / (lower - background), 1.2))
    xx = (outer.xx / outer.pixels - mean_x * mean_x + 1.0 / 12.0) * scale
    yy = (outer.yy / outer.pixels - mean_y * mean_y + 1.0 / 12.0) * scale
    xy = (outer.xy / outer.pixels - mean_x * mean_y) * scale
    # The limits below keep the start values valid. They take effect only for an area that is no compact spot,
    # which the fit then rejects.
    p[AMPLITUDE] = amplitude
    p[X] = mean_x
    p[Y] = mean_y
    p[SIGMA_X] = math.sqrt(max(xx, 0.5))
    p[SIGMA_Y] = math.sqrt(max(yy, 0.5))
    p[BACKGROUND] = background
    bound = 0.9 * p[SIGMA_X] * p[SIGMA_Y]
    p[COVARIANCE] = max(min(xy, bound), -bound)
    p[SECOND_AMPLITUDE] = p[SECOND_X] = p[SECOND_Y] = 0.0
    return True


SOME_ROWS, EVERY_ROW, AREAS, BLOCK = range(4)
"""Methods of a search, from the fastest to the most general: a scan of some rows, then of all, and the chords
at half maximum; the areas above two levels, for spots that are tilted, saturated or irregular; the brightest
block of pixels, for a spot too faint to be seen in single pixels."""
_PEAK, _PEAK_X, _PEAK_Y, _BACKGROUND, _BACKGROUND_SCATTER = range(5)
"""Indices of the values that the methods of a search share, in DN and px."""
SEARCH_VALUES = 5
_PREFETCH_HALF_WIDTH_PX = 32
"""Half-width of the window around the brightest pixel that is loaded before it is read."""


@kernel
def _climb(image: Image, peak: int, x: int, y: int) -> tuple[int, int]:
    """Value and y of the local maximum in column `x`; a scan of some rows usually misses the brightest
    row."""
    ny = image.shape[0]
    for _ in range(64):
        has_moved = False
        for yy in (y - 1, y + 1):
            if 0 <= yy < ny:
                value = lowest_of_three(image, x, yy)
                if value > peak:
                    peak = value
                    y = yy
                    has_moved = True
        if not has_moved:
            break
    return peak, y


@kernel
def find_start(
    image: Image,
    method: int,
    row_step: int,
    full_scale_dn: float,
    p: Floats,
    search_values: Floats,
    bands: Image,
    sample: Ints,
    mask: NDArray[np.uint8],
    stack: Ints,
) -> bool:
    """Write start values by one of the methods into `p`; False if it finds no spot.

    The caller tries the methods in their order: `search_values` (SEARCH_VALUES,) holds results of the first
    ones. SOME_ROWS reads every `row_step`-th row, and is not called for a `row_step` of 1. The last four
    arguments are working memory.
    """
    if method <= EVERY_ROW:
        skips_rows = method == SOME_ROWS
        if skips_rows:
            scan_some_rows(image, row_step, bands)
        else:
            scan_every_row(image, bands)
        if skips_rows or row_step == 1:
            # after the scan, because these rows are in the cache by then
            level, scatter = background_of(image, row_step, sample)
            search_values[_BACKGROUND], search_values[_BACKGROUND_SCATTER] = level, scatter
        highest, column, row = brightest(image, bands)
        if skips_rows:
            # most rows around this position have not been read yet
            half = _PREFETCH_HALF_WIDTH_PX
            prefetch_window(image, column - half, row - half, 2 * half, 2 * half)
        highest, row = _climb(image, highest, column, row)
        search_values[_PEAK], search_values[_PEAK_X], search_values[_PEAK_Y] = highest, column, row
    background, scatter = search_values[_BACKGROUND], search_values[_BACKGROUND_SCATTER]
    peak, x, y = int(search_values[_PEAK]), int(search_values[_PEAK_X]), int(search_values[_PEAK_Y])
    if method < BLOCK:
        # the highest of 1e5 to 1e6 normally distributed values lies about 5 standard deviations above the
        # mean: 6 excludes noise
        if not peak > background + 6.0 * scatter:
            return False
        if method == AREAS:
            return start_from_areas(image, x, y, background, float(peak), full_scale_dn, mask, stack, p)
        return start_from_chords(image, x, y, background, peak, p)
    size = 8 if min(image.shape) >= 24 else 3
    mean, x, y = brightest_block(image, size, background + 8.0 * scatter)
    # the mean of size^2 pixels has the standard deviation scatter / size; again 6 standard deviations
    if not mean > background + 6.0 * scatter / size:
        return False
    p[:] = 0.0
    p[AMPLITUDE] = max(1.3 * (mean - background), 0.5)
    p[X] = x
    p[Y] = y
    p[SIGMA_X] = p[SIGMA_Y] = float(size)
    p[BACKGROUND] = background
    return True
