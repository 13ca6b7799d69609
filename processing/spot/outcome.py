"""What a fit's end means: second spot, flags, uncertainties, the state that the next frame starts from."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.general_fit import (
    PARAMETERS,
    background_variance,
    cholesky,
    inverse_diagonal,
    score_general,
    window_of,
)
from processing.spot.second_spot import REACH, try_second
from processing.spot.spot import Image
from processing.spot.upright_fit import UNKNOWNS

Floats = NDArray[np.float64]
Result = tuple[float, float, float, float, float, float, float, float, float, float, int]

STATE_SIZE = 21
"""State: 0 follows, 1 to 10 parameters on the sensor, 11 and 12 step of the position, 13 tilted,
14 two spots, 15 frames that hint at a tilt; 16 dark variance, 17 inverse gain, 18 full scale, 19 row step,
20 squared PRNU."""
WORK_ROWS = 21
"""Scratch of PARAMETERS columns: parameters, information, its factor."""

_SATURATED, _EDGE, _LOST, _LOW_SNR, _POOR_FIT, _OUTLIERS, _MULTIPLE = 1, 2, 4, 8, 16, 32, 64
_GATE = 25.0


@njit(cache=True, nogil=True, error_model="numpy")
def lost(state: Floats) -> Result:
    state[0] = 0.0
    state[11] = 0.0
    state[12] = 0.0
    nan = math.nan
    return nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, _LOST


@njit(cache=True, nogil=True, error_model="numpy")
def significant(p: Floats, floor: float, pixels: int, outliers: int) -> bool:
    """The spot's light stands out of the noise of its own area, and is not made of outliers."""
    area = 4.0 * math.pi * p[3] * p[4]
    return p[0] * math.sqrt(area) > 8.0 * math.sqrt(floor) and outliers < 0.3 * pixels


@njit(cache=True, nogil=True, error_model="numpy")
def finish(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    state: Floats,
    work: Floats,
    general: bool,
    tilted: bool,
    two: bool,
    followed: bool,
    chi2: float,
    pixels: int,
    saturated: int,
    outliers: int,
) -> Result:
    """Look for a second spot where the residuals ask for one, then report."""
    p = work[0]
    matrix = work[1:11]
    factor = work[11:21]
    if not two and chi2 > (pixels - 6) * 1.05 + 6.0 * math.sqrt(2.0 * pixels):
        two, chi2, pixels, saturated, outliers = try_second(
            image, state, work, tilted, chi2, pixels, saturated, outliers
        )
        general = True
        _information(image, p, tilted, two, state, chi2, pixels, matrix)
        if not cholesky(matrix, PARAMETERS, factor):
            return lost(state)
    elif two and not p[7] > 0.003 * p[0]:
        two = False
    floor = background_variance(p, state[16], state[17])
    return _report(
        p, origin_x, origin_y, sensor_nx, sensor_ny, floor, chi2, pixels, saturated, outliers,
        general, tilted, two, followed, factor, state,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _information(
    image: Image,
    p: Floats,
    tilted: bool,
    two: bool,
    state: Floats,
    chi2: float,
    pixels: int,
    matrix: Floats,
) -> None:
    """Information about the final parameters, for the uncertainties."""
    ny, nx = image.shape
    x0, y0, x1, y1 = window_of(p, nx, ny, REACH)
    gate = _GATE * max(1.0, chi2 / max(pixels - 6, 1))
    gradient = np.empty(PARAMETERS)
    score_general(
        image,
        x0,
        y0,
        x1,
        y1,
        p,
        tilted,
        two,
        state[16],
        state[17],
        state[20],
        state[18],
        gate,
        gradient,
        matrix,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _report(
    p: Floats,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    floor: float,
    chi2: float,
    pixels: int,
    saturated: int,
    outliers: int,
    general: bool,
    tilted: bool,
    two: bool,
    followed: bool,
    factor: Floats,
    state: Floats,
) -> Result:
    x = p[1] + origin_x
    y = p[2] + origin_y
    size = PARAMETERS if general else UNKNOWNS
    unknowns = 6 + (1 if tilted else 0) + (3 if two else 0)
    chi2_per_dof = chi2 / max(pixels - unknowns, 1)
    inflate = math.sqrt(max(1.0, chi2_per_dof))
    u_x = inflate * math.sqrt(inverse_diagonal(factor, size, 1))
    u_y = inflate * math.sqrt(inverse_diagonal(factor, size, 2))
    flags = 0
    if saturated > 0:
        flags |= _SATURATED
    if (
        x - 3.0 * p[3] < -0.5
        or y - 3.0 * p[4] < -0.5
        or x + 3.0 * p[3] > sensor_nx - 0.5
        or y + 3.0 * p[4] > sensor_ny - 0.5
    ):
        flags |= _EDGE
    if p[0] < 5.0 * math.sqrt(floor):
        flags |= _LOW_SNR
    if chi2_per_dof > 1.3 + 6.0 * math.sqrt(2.0 / max(pixels, 1)):
        flags |= _POOR_FIT
    if outliers > 0:
        flags |= _OUTLIERS
    if two:
        flags |= _MULTIPLE
    sigma_1, sigma_2, rotation = p[3], p[4], 0.0
    if tilted:
        mean = 0.5 * (p[3] * p[3] + p[4] * p[4])
        half = 0.5 * (p[3] * p[3] - p[4] * p[4])
        root = math.hypot(half, p[6])
        # the axis nearer to x keeps the name of x, so that the two do not swap from frame to frame
        sign = 1.0 if half >= 0.0 else -1.0
        sigma_1 = math.sqrt(max(mean + sign * root, 1e-12))
        sigma_2 = math.sqrt(max(mean - sign * root, 1e-12))
        rotation = 0.5 * math.atan2(sign * p[6], sign * half)
    if followed:
        state[11] = x - state[2]
        state[12] = y - state[3]
    else:
        state[11] = 0.0
        state[12] = 0.0
    for k in range(PARAMETERS):
        state[1 + k] = p[k]
    state[2] = x
    state[3] = y
    state[9] = p[8] + origin_x
    state[10] = p[9] + origin_y
    state[0] = 1.0
    state[13] = 1.0 if tilted else 0.0
    state[14] = 1.0 if two else 0.0
    return x, y, u_x, u_y, sigma_1, sigma_2, rotation, p[0], p[5], chi2_per_dof, flags
