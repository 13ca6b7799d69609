"""One frame without a prior: find the spot on the whole of it, then fit."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.general_fit import background_variance, cholesky, fit_general, inverse_diagonal
from processing.spot.outcome import Result, finish, lost, significant
from processing.spot.prefetch import prefetch_window
from processing.spot.scan import (
    background_of,
    brightest,
    brightest_block,
    of_three,
    scan_every_row,
    scan_some_rows,
)
from processing.spot.second_spot import REACH
from processing.spot.spot import Image
from processing.spot.start import start_on_areas, start_on_chords
from processing.spot.upright_fit import fit_upright

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_NEAR_PX = 32
_SMALLEST_SPOT_PX = 0.7
"""Below it a bright place is a cluster of hot pixels."""


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(image: Image, peak: int, x: int, y: int) -> tuple[int, int]:
    """The row that was hit need not be the brightest: up or down from it, value and y."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_any(image: Image, state: Floats, work: Floats) -> tuple[bool, bool, float, int, int, int]:
    """General fit, tilted where the tilt is significant: done, tilted, chi2, pixels, saturated, outliers."""
    p = work[0]
    matrix = work[1:11]
    factor = work[11:21]
    tilted = False
    done, chi2, pixels, saturated, outliers = fit_general(
        image, p, True, False, state[16], state[17], state[20], state[18], REACH, matrix, factor
    )
    if done and cholesky(matrix, 7, factor):
        u_c = math.sqrt(inverse_diagonal(factor, 7, 6)) * math.sqrt(max(1.0, chi2 / max(pixels - 7, 1)))
        tilted = abs(p[6]) > 5.0 * u_c
    if done and not tilted:
        p[6] = 0.0
        done, chi2, pixels, saturated, outliers = fit_general(
            image, p, False, False, state[16], state[17], state[20], state[18], REACH, matrix, factor
        )
    done = (
        done
        and min(p[3], p[4]) > _SMALLEST_SPOT_PX
        and significant(p, background_variance(p, state[16], state[17]), pixels, outliers)
    )
    return done, tilted, chi2, pixels, saturated, outliers


@njit(cache=True, nogil=True, error_model="numpy")
def search(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    state: Floats,
    work: Floats,
    tables: NDArray[np.float32],
    bands: Image,
    sample: Integers,
    mask: NDArray[np.uint8],
    stack: Integers,
) -> Result:
    """Spot of one frame without knowing of any before it.

    The first pass reads every `row_step`-th row; where that gives no clean spot, every row is read. A clean,
    upright spot is fitted from its chords; any other by the general fit, from its areas.
    """
    p = work[0]
    matrix = work[1:11]
    factor = work[11:21]
    zero_variance, inverse_gain, full_scale, uneven = state[16], state[17], state[18], state[20]
    row_step = int(state[19])
    state[15] = 0.0
    background = spread = threshold = 0.0
    peak = x = y = 0
    for attempt in range(1 if row_step == 1 else 2):
        if attempt == 0 and row_step > 1:
            scan_some_rows(image, row_step, bands)
        else:
            scan_every_row(image, bands)
        if attempt == 0:
            # after the scan, which has brought these rows nearer
            background, spread = background_of(image, row_step, sample)
            threshold = background + 6.0 * spread
        peak, x, y = brightest(image, bands)
        if attempt == 0 and row_step > 1:
            # most rows about the place have not been read yet
            prefetch_window(image, x - _NEAR_PX, y - _NEAR_PX, 2 * _NEAR_PX, 2 * _NEAR_PX)
        peak, y = _climb(image, peak, x, y)
        if peak > threshold and start_on_chords(image, x, y, background, peak, p):
            done, chi2, pixels, outliers, evidence = fit_upright(
                image, p, True, zero_variance, inverse_gain, uneven, full_scale, tables, matrix, factor
            )
            if (
                done
                and abs(evidence) < 6.0
                and significant(p, background_variance(p, zero_variance, inverse_gain), pixels, outliers)
            ):
                return finish(
                    image, origin_x, origin_y, sensor_nx, sensor_ny, state, work,
                    False, False, False, False, chi2, pixels, 0, outliers,
                )  # fmt: skip
    if peak > threshold and start_on_areas(image, x, y, background, float(peak), full_scale, mask, stack, p):
        done, tilted, chi2, pixels, saturated, outliers = _fit_any(image, state, work)
        if done:
            return finish(
                image, origin_x, origin_y, sensor_nx, sensor_ny, state, work,
                True, tilted, False, False, chi2, pixels, saturated, outliers,
            )  # fmt: skip
    size = 8 if min(image.shape) >= 24 else 3
    mean, x, y = brightest_block(image, size, background + 8.0 * spread)
    if mean > background + 6.0 * spread / size:
        p[:] = 0.0
        p[0] = max(1.3 * (mean - background), 0.5)
        p[1] = x
        p[2] = y
        p[3] = p[4] = float(size)
        p[5] = background
        done, tilted, chi2, pixels, saturated, outliers = _fit_any(image, state, work)
        if done:
            return finish(
                image, origin_x, origin_y, sensor_nx, sensor_ny, state, work,
                True, tilted, False, False, chi2, pixels, saturated, outliers,
            )  # fmt: skip
    return lost(state)
