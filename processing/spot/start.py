"""Starts of the fit at a bright place: along chords where the spot is clean, from areas where it is not."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    Floats,
    X,
    Y,
)
from processing.spot.scan import of_three
from processing.spot.spot import Image

_WIDTH_OF_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian, in standard deviations."""


class _Area(NamedTuple):
    """Connected pixels above a level: their number, sums of their coordinates, the box they lie in."""

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


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(image: Image, x: int, y: int, dx: int, dy: int, level: float) -> float:
    """Distance from (x, y) to where the light falls below a level, between pixels; NaN at an edge."""
    ny, nx = image.shape
    before = float(image[y, x])
    distance = 0
    while True:
        x += dx
        y += dy
        if x < 0 or y < 0 or x >= nx or y >= ny:
            return math.nan
        value = float(image[y, x])
        if value < level:
            return distance + (before - level) / (before - value)
        before = value
        distance += 1


@njit(cache=True, nogil=True, error_model="numpy")
def start_on_chords(image: Image, x: int, y: int, background: float, peak: int, p: Floats) -> bool:
    """Start from the chords at half height along a row and a column; False where there are none.

    The middles of the chords lead to an ellipse's centre in two rounds.
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
        peak = max(peak, of_three(image, x, y))
    p[AMPLITUDE] = peak - background
    p[X] = centre_x
    p[Y] = centre_y
    p[SIGMA_X] = width_x / _WIDTH_OF_SIGMA
    p[SIGMA_Y] = width_y / _WIDTH_OF_SIGMA
    p[BACKGROUND] = background
    p[COVARIANCE] = p[SECOND_AMPLITUDE] = p[SECOND_X] = p[SECOND_Y] = 0.0
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _flood(
    image: Image,
    x: int,
    y: int,
    level: float,
    mask: NDArray[np.uint8],
    mark: int,
    stack: NDArray[np.int64],
) -> _Area:
    """Pixels at or above `level` that are connected to (x, y); `mask` gets `mark` there."""
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
        place = stack[top]
        top -= 1
        py = place // nx
        px = place - py * nx
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


@njit(cache=True, nogil=True, error_model="numpy")
def start_on_areas(
    image: Image,
    x: int,
    y: int,
    background: float,
    peak: float,
    full_scale: float,
    mask: NDArray[np.uint8],
    stack: NDArray[np.int64],
    p: Floats,
) -> bool:
    """Start of the fit from the areas above two levels about a bright place.

    The area above the background and a level l is 2 pi sigma_1 sigma_2 ln(A/l), an ellipse's: two areas
    give the product of the sigmas and, where the top is clipped, the amplitude A that it would have.
    """
    light = peak - background
    if light <= 0.0:
        return False
    upper = background + 0.75 * light
    lower = background + 0.35 * light
    clipped = peak >= 0.97 * full_scale
    if clipped:
        upper = background + 0.95 * light
    inner = _flood(image, x, y, upper, mask, 1, stack)
    outer = _flood(image, x, y, lower, mask, 2, stack)
    # the mask is left clean for the next frame; the outer area's box holds the inner one
    mask[outer.y_first : outer.y_last + 1, outer.x_first : outer.x_last + 1] = 0
    if outer.pixels < 3:
        return False
    mean_x = outer.x / outer.pixels
    mean_y = outer.y / outer.pixels
    # sigma_1 sigma_2 from the difference of the two areas
    spread = (outer.pixels - inner.pixels) / (
        2.0 * math.pi * math.log((upper - background) / (lower - background))
    )
    spread = max(spread, 0.3)
    amplitude = light
    if clipped:
        amplitude = (upper - background) * math.exp(min(inner.pixels / (2.0 * math.pi * spread), 5.0))
    # an ellipse of uniform weight with half-axes h has the variances h^2/4, and here h^2 = 2 sigma^2 ln(A/l);
    # 1/12 is the variance of a position within a pixel
    scale = 2.0 / math.log(max(amplitude / (lower - background), 1.2))
    xx = (outer.xx / outer.pixels - mean_x * mean_x + 1.0 / 12.0) * scale
    yy = (outer.yy / outer.pixels - mean_y * mean_y + 1.0 / 12.0) * scale
    xy = (outer.xy / outer.pixels - mean_x * mean_y) * scale
    # an area lit so evenly that the limits below act is no compact spot; the fit will reject it
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
