"""Search of a whole frame for the spot, followed by its fit, without knowledge of earlier frames."""

import math

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats, Ints, Singles
from processing.kernel import kernel
from processing.spot.clean_fit import TILT_EVIDENCE, fit_clean
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    TILTED,
    Fitted,
    Place,
    Workspace,
    X,
    Y,
    as_kind,
    nothing_hidden,
    workspace_of,
)
from processing.spot.general_fit import fit_general
from processing.spot.linear_algebra import cholesky, inverse_diagonal
from processing.spot.memory import TILT_HINTS
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
from processing.spot.sensor_model import PixelNoise, pixel_noise_of
from processing.spot.spot import Image
from processing.spot.start import start_on_areas, start_on_chords

_NEAR_PX = 32
_SMALLEST_SPOT_PX = 0.7
"""A smaller fitted sigma means a cluster of hot pixels and not a spot."""


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
def _fit_any(image: Image, work: Workspace, noise: PixelNoise) -> Fitted:
    """General fit of a single spot; as upright unless its tilt is significant (five standard deviations).

    The result has ``done = False`` also for a spot that is too small or not significant.
    """
    p = work.parameters
    fitted = fit_general(image, work, True, False, noise, REACH, nothing_hidden())
    tilted = False
    if fitted.done and cholesky(work.information, TILTED, work.factor):
        u_c = math.sqrt(inverse_diagonal(work.factor, TILTED, COVARIANCE))
        u_c *= math.sqrt(max(1.0, fitted.chi2 / max(fitted.pixels - TILTED, 1)))
        tilted = abs(p[COVARIANCE]) > 5.0 * u_c
    if fitted.done and not tilted:
        p[COVARIANCE] = 0.0
        fitted = fit_general(image, work, False, False, noise, REACH, nothing_hidden())
    if fitted.done and min(p[SIGMA_X], p[SIGMA_Y]) > _SMALLEST_SPOT_PX and significant(p, noise, fitted):
        return as_kind(fitted, fitted.size, tilted, False)
    return Fitted(
        False, fitted.chi2, fitted.pixels, fitted.saturated, fitted.outliers, fitted.size, tilted, False
    )


@kernel
def _near_edge(image: Image, p: Floats) -> bool:
    """Whether the image's edge is nearer to the spot than two standard deviations."""
    ny, nx = image.shape
    edge_x, edge_y = min(p[X], nx - 1 - p[X]), min(p[Y], ny - 1 - p[Y])
    return bool(edge_x < 2.0 * p[SIGMA_X] or edge_y < 2.0 * p[SIGMA_Y])


@kernel
def search(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    memory: Floats,
    work_array: Floats,
    tables: Singles,
    noise_values: Floats,
    row_step: int,
    bands: Image,
    sample: Ints,
    mask: NDArray[np.uint8],
    stack: Ints,
    cut_out: bool,
) -> Result:
    """Find and fit the spot of one frame.

    Methods are tried from the fastest to the most general:

    1. A scan of every `row_step`-th row, start values from the spot's chords at half maximum, upright fit.
    2. The same after a scan of every row.
    3. Start values from the areas above two levels, general fit: tilted, saturated or irregular spots.
    4. Start values from the brightest block of pixels, general fit: a spot too faint to be seen in
       single pixels.

    `bands`, `sample`, `mask` and `stack` are working memory, `row_step` belongs to the scan. An image that is
    `cut_out` of a frame may hold the flank of a spot outside: the last two methods, which take long, are left
    out for a place near its edge. For the other parameters see `follow`. Returns the fields of a `Spot`, with
    the flag LOST if nothing was found.
    """
    place = Place(origin_x, origin_y, sensor_nx, sensor_ny)
    work = workspace_of(work_array)
    noise = pixel_noise_of(noise_values)
    p = work.parameters
    memory[TILT_HINTS] = 0.0
    background = spread = threshold = 0.0
    peak = x = y = 0
    for attempt in range(1 if row_step == 1 else 2):
        if attempt == 0 and row_step > 1:
            scan_some_rows(image, row_step, bands)
        else:
            scan_every_row(image, bands)
        if attempt == 0:
            # after the scan, because these rows are in the cache by then
            background, spread = background_of(image, row_step, sample)
            # the highest of 1e5 to 1e6 normally distributed values lies about 5 standard deviations above the
            # mean: 6 excludes noise
            threshold = background + 6.0 * spread
        peak, x, y = brightest(image, bands)
        if attempt == 0 and row_step > 1:
            # most rows around this position have not been read yet
            prefetch_window(image, x - _NEAR_PX, y - _NEAR_PX, 2 * _NEAR_PX, 2 * _NEAR_PX)
        peak, y = _climb(image, peak, x, y)
        if peak > threshold and start_on_chords(image, x, y, background, peak, p):
            upright = fit_clean(image, work, True, False, noise, tables)
            if (
                upright.fitted.done
                and abs(upright.tilt) < TILT_EVIDENCE
                and significant(p, noise, upright.fitted)
            ):
                return finish(image, place, memory, work, noise, upright.fitted, followed=False)
    if peak > threshold and start_on_areas(
        image, x, y, background, float(peak), noise.full_scale_dn, mask, stack, p
    ):
        if cut_out and _near_edge(image, p):
            return lost(memory)
        fitted = _fit_any(image, work, noise)
        if fitted.done:
            return finish(image, place, memory, work, noise, fitted, followed=False)
    size = 8 if min(image.shape) >= 24 else 3
    mean, x, y = brightest_block(image, size, background + 8.0 * spread)
    # the mean of size^2 pixels has the standard deviation spread / size; again 6 standard deviations
    if mean > background + 6.0 * spread / size:
        p[:] = 0.0
        p[AMPLITUDE] = max(1.3 * (mean - background), 0.5)
        p[X] = x
        p[Y] = y
        p[SIGMA_X] = p[SIGMA_Y] = float(size)
        p[BACKGROUND] = background
        if cut_out and _near_edge(image, p):
            return lost(memory)
        fitted = _fit_any(image, work, noise)
        if fitted.done:
            return finish(image, place, memory, work, noise, fitted, followed=False)
    return lost(memory)
