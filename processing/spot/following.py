"""One frame: follow the spot from the last one; the compiled heart of the tracker."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.general_fit import PARAMETERS, background_variance, fit_general
from processing.spot.outcome import Result, finish, significant
from processing.spot.second_spot import REACH
from processing.spot.spot import Image
from processing.spot.upright_fit import fit_upright

Floats = NDArray[np.float64]

SEARCH = -1
"""In place of flags: the spot was not found where it was expected."""


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    state: Floats,
    work: Floats,
    tables: NDArray[np.float32],
) -> Result:
    """Spot of one frame from the last one's; flags are `SEARCH` where it is not where it should be."""
    p = work[0]
    matrix = work[1:11]
    factor = work[11:21]
    zero_variance, inverse_gain, full_scale, uneven = state[16], state[17], state[18], state[20]
    _expected(state, origin_x, origin_y, p)
    tilted = state[13] > 0.0
    two = state[14] > 0.0
    if not (tilted or two):
        done, chi2, pixels, outliers, evidence = fit_upright(
            image, p, False, zero_variance, inverse_gain, uneven, full_scale, tables, matrix, factor
        )
        if done:
            # three frames in a row must say so before the spot is taken for tilted
            state[15] = state[15] + 1.0 if abs(evidence) > 6.0 else 0.0
            if state[15] >= 3.0:
                tilted = True
            return finish(
                image, origin_x, origin_y, sensor_nx, sensor_ny, state, work,
                False, tilted, False, True, chi2, pixels, 0, outliers,
            )  # fmt: skip
        _expected(state, origin_x, origin_y, p)
    done, chi2, pixels, saturated, outliers = fit_general(
        image, p, tilted, two, zero_variance, inverse_gain, uneven, full_scale, REACH, matrix, factor
    )
    if not done or not _plausible(
        p, state, background_variance(p, zero_variance, inverse_gain), outliers, pixels
    ):
        nan = math.nan
        return nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, SEARCH
    return finish(
        image, origin_x, origin_y, sensor_nx, sensor_ny, state, work,
        True, tilted, two, True, chi2, pixels, saturated, outliers,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _expected(state: Floats, origin_x: int, origin_y: int, p: Floats) -> None:
    """Where the spot should be: the last place and its last step once more."""
    for k in range(PARAMETERS):
        p[k] = state[1 + k]
    p[1] += state[11] - origin_x
    p[2] += state[12] - origin_y
    p[8] += state[11] - origin_x
    p[9] += state[12] - origin_y


@njit(cache=True, nogil=True, error_model="numpy")
def _plausible(p: Floats, state: Floats, floor: float, outliers: int, pixels: int) -> bool:
    """The spot that was followed still looks like itself; else it is looked for anew."""
    ratio_x = p[3] / state[4]
    ratio_y = p[4] / state[5]
    return (
        significant(p, floor, pixels, outliers)
        and 0.5 < ratio_x < 2.0
        and 0.5 < ratio_y < 2.0
        and p[0] > 0.05 * state[1]
    )
