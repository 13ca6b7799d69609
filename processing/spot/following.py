"""One frame when the spot was seen in the last one: fit it from where it should be now."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.fit_values import (
    AMPLITUDE,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    Fitted,
    Floats,
    Place,
    as_kind,
    workspace_of,
)
from processing.spot.general_fit import fit_general
from processing.spot.memory import LAST, TILT_HINTS, TILTED, TWO, expect
from processing.spot.outcome import Result, finish, significant
from processing.spot.sensor_model import PixelNoise, pixel_noise_of
from processing.spot.spot import Image
from processing.spot.upright_fit import TILT_EVIDENCE, fit_upright

SEARCH = -1
"""In the place of the flags: the spot was not found where it was expected."""


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    memory: Floats,
    work_array: Floats,
    tables: NDArray[np.float32],
    noise_values: Floats,
) -> Result:
    """Spot of one frame from the last one's; flags are `SEARCH` where it is not where it should be."""
    place = Place(origin_x, origin_y, sensor_nx, sensor_ny)
    work = workspace_of(work_array)
    noise = pixel_noise_of(noise_values)
    expect(memory, place, work.parameters)
    tilted = memory[TILTED] > 0.0
    two = memory[TWO] > 0.0
    if not (tilted or two):
        upright = fit_upright(image, work, False, noise, tables)
        one = upright.fitted
        if one.done:
            # three frames in a row must say so before the spot is taken for tilted: the general fit that
            # follows from then on costs many times the time
            memory[TILT_HINTS] = memory[TILT_HINTS] + 1.0 if abs(upright.tilt) > TILT_EVIDENCE else 0.0
            tilted = memory[TILT_HINTS] >= 3.0
            return finish(
                image, place, memory, work, noise, as_kind(one, one.size, tilted, False), followed=True
            )
        expect(memory, place, work.parameters)
    fitted = fit_general(image, work, tilted, two, noise, REACH)
    if not fitted.done or not _plausible(work.parameters, memory, noise, fitted):
        nan = math.nan
        return nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, SEARCH
    return finish(image, place, memory, work, noise, fitted, followed=True)


@njit(cache=True, nogil=True, error_model="numpy")
def _plausible(p: Floats, memory: Floats, noise: PixelNoise, fitted: Fitted) -> bool:
    """The spot that was followed still looks like itself; else it is looked for anew."""
    ratio_x = p[SIGMA_X] / memory[LAST + SIGMA_X]
    ratio_y = p[SIGMA_Y] / memory[LAST + SIGMA_Y]
    return (
        significant(p, noise, fitted)
        and 0.5 < ratio_x < 2.0
        and 0.5 < ratio_y < 2.0
        and p[AMPLITUDE] > 0.05 * memory[LAST + AMPLITUDE]
    )
