"""Starts of the fit at a bright place: along chords where the spot is clean, from areas where it is not."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.scan import of_three
from processing.spot.spot import Image

Floats = NDArray[np.float64]
_WIDTH_OF_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))


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
    p[0] = peak - background
    p[1] = centre_x
    p[2] = centre_y
    p[3] = width_x / _WIDTH_OF_SIGMA
    p[4] = width_y / _WIDTH_OF_SIGMA
    p[5] = background
    for k in range(6, 10):
        p[k] = 0.0
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
    moments: Floats,
) -> int:
    """Pixels connected to (x, y) above `level`, counted; their moments and limits; `mask` gets `mark`."""
    ny, nx = image.shape
    moments[:] = 0.0
    moments[5] = moments[6] = x
    moments[7] = moments[8] = y
    if image[y, x] < level:
        return 0
    top = 0
    stack[0] = y * nx + x
    mask[y, x] = mark
    count = 0
    while top >= 0:
        place = stack[top]
        top -= 1
        py = place // nx
        px = place - py * nx
        count += 1
        moments[0] += px
        moments[1] += py
        moments[2] += px * px
        moments[3] += py * py
        moments[4] += px * py
        moments[5] = min(moments[5], px)
        moments[6] = max(moments[6], px)
        moments[7] = min(moments[7], py)
        moments[8] = max(moments[8], py)
        for k in range(4):
            qx = px + (1 if k == 0 else -1 if k == 1 else 0)
            qy = py + (1 if k == 2 else -1 if k == 3 else 0)
            if 0 <= qx < nx and 0 <= qy < ny and mask[qy, qx] != mark and image[qy, qx] >= level:
                mask[qy, qx] = mark
                top += 1
                stack[top] = qy * nx + qx
    return count


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

    The area above a level l is 2 pi sigma_1 sigma_2 ln(A/l): two areas give the size and, where the
    top is clipped, the amplitude that the clipped top hides.
    """
    light = peak - background
    if light <= 0.0:
        return False
    moments = np.empty(9)
    upper = background + 0.75 * light
    lower = background + 0.35 * light
    clipped = peak >= 0.97 * full_scale
    if clipped:
        upper = background + 0.95 * light
    n_upper = _flood(image, x, y, upper, mask, 1, stack, moments)
    n_lower = _flood(image, x, y, lower, mask, 2, stack, moments)
    # the mask is left clean for the next frame; the larger area holds the smaller
    mask[int(moments[7]) : int(moments[8]) + 1, int(moments[5]) : int(moments[6]) + 1] = 0
    if n_lower < 3:
        return False
    mean_x = moments[0] / n_lower
    mean_y = moments[1] / n_lower
    area = (n_lower - n_upper) / (2.0 * math.pi * math.log((upper - background) / (lower - background)))
    area = max(area, 0.3)
    amplitude = light
    if clipped:
        amplitude = (upper - background) * math.exp(min(n_upper / (2.0 * math.pi * area), 5.0))
    # an ellipse that is lit evenly has a quarter of its squared half-axes as variance
    scale = 2.0 / math.log(max(amplitude / (lower - background), 1.2))
    xx = (moments[2] / n_lower - mean_x * mean_x + 1.0 / 12.0) * scale
    yy = (moments[3] / n_lower - mean_y * mean_y + 1.0 / 12.0) * scale
    xy = (moments[4] / n_lower - mean_x * mean_y) * scale
    # what is lit that evenly is no compact spot, but the fit will say so
    p[0] = amplitude
    p[1] = mean_x
    p[2] = mean_y
    p[3] = math.sqrt(max(xx, 0.5))
    p[4] = math.sqrt(max(yy, 0.5))
    p[5] = background
    p[6] = max(min(xy, 0.9 * p[3] * p[4]), -0.9 * p[3] * p[4])
    p[7] = p[8] = p[9] = 0.0
    return True
