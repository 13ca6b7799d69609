"""Fit of the spot in a frame, started from the position expected from the previous frames, or from a search.

The fit of a clean spot is tried first because it is the fastest; the general fit (second spot, saturation) is
used if the spot needs it. One kernel contains both, so that they are compiled once for each type of pixel.
"""

import math

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.clean_fit import TILT_EVIDENCE, fit_clean, has_left
from processing.spot.fit_values import (
    AMPLITUDE,
    COVARIANCE,
    HAS_SECOND,
    IS_TILTED,
    LAST,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    TILT_HINTS,
    TILTED,
    Image,
    Placement,
    SpotFit,
    Workspace,
    as_kind,
    cholesky,
    expect,
    inverse_diagonal,
    nothing_hidden,
    workspace_of,
)
from processing.spot.general_fit import fit_general
from processing.spot.outcome import Result, finish, significant, without_spot
from processing.spot.sensor_model import PixelNoise, pixel_noise_of

SEARCH = -1
"""Value in place of the flags of a `Result` if the spot is not where the fit began."""
EXPECTED, NEAR, ROUGH = range(3)
"""Start values of a fit: the spot expected from the previous frames (EXPECTED), or values from a search that
are good enough for the fit of a clean spot (NEAR) or not (ROUGH)."""
_MIN_SIGMA_PX = 0.7
"""Smallest standard deviation of a spot; a smaller one is that of a cluster of hot pixels."""


@kernel
def follow(
    image: Image,
    origin_x: int,
    origin_y: int,
    sensor_nx: int,
    sensor_ny: int,
    memory: Floats,
    work_array: Floats,
    tables: Singles,
    noise_values: Floats,
    start: int,
) -> Result:
    """Fit the spot of one frame; returns the fields of a `Spot`.

    If the spot is not there, the flags are `SEARCH`, every other field is NaN and the caller has to search
    elsewhere.

    Parameters
    ----------
    image : (ny, nx) a frame or a window of it
    origin_x, origin_y, sensor_nx, sensor_ny : fields of `Placement`
    memory : memory of the tracker, with the indices of `fit_values` from `HAS_LAST_SPOT` on; updated
    work_array : working memory of shape WORKSPACE_SHAPE, which holds the start values of a search
    tables : (TABLE_ROWS, LARGEST_TABLE) working memory of the upright fit
    noise_values : fields of `PixelNoise`
    start : EXPECTED, NEAR or ROUGH; a search accepts a tilted, saturated or irregular spot only with ROUGH
    """
    placement = Placement(origin_x, origin_y, sensor_nx, sensor_ny)
    work = workspace_of(work_array)
    noise = pixel_noise_of(noise_values)
    if start == ROUGH:
        any_fit = _fit_any(image, work, noise)
        if any_fit.converged:
            return finish(image, placement, memory, work, noise, any_fit, followed=False)
        return without_spot(SEARCH)
    tilted = has_second = False
    if start == EXPECTED:
        expect(memory, placement, work.parameters)
        tilted = memory[IS_TILTED] > 0.0
        has_second = memory[HAS_SECOND] > 0.0
    if not has_second:
        clean = fit_clean(image, work, start == NEAR, tilted, noise, tables)
        single = clean.fit
        if start == NEAR:
            upright = single.converged and abs(clean.tilt) < TILT_EVIDENCE
            if upright and significant(work.parameters, noise, single):
                return finish(image, placement, memory, work, noise, single, followed=False)
            return without_spot(SEARCH)
        if single.converged:
            # A tilt must be significant in three frames in a row before the spot is treated as tilted: the
            # fit with one parameter more takes longer.
            memory[TILT_HINTS] = memory[TILT_HINTS] + 1.0 if abs(clean.tilt) > TILT_EVIDENCE else 0.0
            tilted = tilted or memory[TILT_HINTS] >= 3.0
            single = as_kind(single, single.size, tilted, False)
            return finish(image, placement, memory, work, noise, single, followed=True)
        if clean.far:
            return without_spot(SEARCH)
        # the failed fit has changed the parameters: restore the start values
        expect(memory, placement, work.parameters)
    if has_left(image, work.parameters, noise):
        return without_spot(SEARCH)
    fit = fit_general(image, work, tilted, has_second, noise, REACH, nothing_hidden())
    if not fit.converged or not _plausible(work.parameters, memory, noise, fit):
        return without_spot(SEARCH)
    return finish(image, placement, memory, work, noise, fit, followed=True)


@kernel
def _plausible(p: Floats, memory: Floats, noise: PixelNoise, fit: SpotFit) -> bool:
    """Whether the fitted spot resembles the last one: size within a factor of 2, amplitude above 5 % of it.
    If not, the fit may have followed a reflection or a hot pixel."""
    ratio_x = p[SIGMA_X] / memory[LAST + SIGMA_X]
    ratio_y = p[SIGMA_Y] / memory[LAST + SIGMA_Y]
    return (
        significant(p, noise, fit)
        and 0.5 < ratio_x < 2.0
        and 0.5 < ratio_y < 2.0
        and p[AMPLITUDE] > 0.05 * memory[LAST + AMPLITUDE]
    )


@kernel
def _fit_any(image: Image, work: Workspace, noise: PixelNoise) -> SpotFit:
    """General fit of one spot, upright unless its tilt is significant (5 u). `converged` is False also for a
    spot that is too small or not significant."""
    p = work.parameters
    fit = fit_general(image, work, True, False, noise, REACH, nothing_hidden())
    tilted = False
    if fit.converged and cholesky(work.information, TILTED, work.factor):
        u_c = math.sqrt(inverse_diagonal(work.factor, TILTED, COVARIANCE))
        u_c *= math.sqrt(max(1.0, fit.chi2 / max(fit.pixels - TILTED, 1)))
        tilted = abs(p[COVARIANCE]) > 5.0 * u_c
    if fit.converged and not tilted:
        p[COVARIANCE] = 0.0
        fit = fit_general(image, work, False, False, noise, REACH, nothing_hidden())
    is_spot = fit.converged and min(p[SIGMA_X], p[SIGMA_Y]) > _MIN_SIGMA_PX and significant(p, noise, fit)
    return SpotFit(is_spot, fit.chi2, fit.pixels, fit.saturated, fit.outliers, fit.size, tilted, False)
