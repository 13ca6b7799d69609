"""Fast fit of a clean spot by Fisher scoring with `upright_score` or, if it is tilted, `tilted_score`.

This fit serves nearly every frame of a measurement. Any other spot is left to `general_fit`.
"""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    GATE,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    TILTED,
    UPRIGHT,
    Image,
    SpotFit,
    Window,
    Workspace,
    X,
    Y,
    cholesky,
    inverse_diagonal,
    solve,
)
from processing.spot.general_fit import window_of
from processing.spot.scan import prefetch_window
from processing.spot.sensor_model import PixelNoise, background_variance
from processing.spot.tilted_score import information_tilted, score_tilted
from processing.spot.upright_score import ALONG_Y, MIN_SIGMA_PX, information, profile, score

_MAX_PASSES = 10
LARGEST_TABLE = 2048
"""Largest width or height of the fitted window in px."""
_VECTOR_PIXELS = 32
"""Largest number of pixels that one vector instruction handles."""
_MAX_OUTLIERS = 8
_MAX_CORRELATION = 0.95
"""Correlation of the light along x and y above which a spot is left to the general fit."""
_MAX_CLEAN_CHI2 = 1.3
"""Chi-square per pixel above which a spot is left to the general fit."""
_MAX_ITERATION_ERROR = 0.03
"""Allowed error of iteration, as a fraction of the standard uncertainty; it adds 0.05 % to the scatter."""
TILT_EVIDENCE = 6.0
"""Significance of the tilt, in standard deviations, above which a spot is not treated as upright."""


class CleanFit(NamedTuple):
    """Result of a fit of a clean spot."""

    fit: SpotFit
    tilt: float
    """Significance of a tilt in standard deviations: the gradient by the covariance, divided by the square
    root of its information (score test); 0 if the covariance was fitted."""
    far: bool
    """Whether the start values were too far from the spot, so that this fit may succeed from better ones."""


@kernel
def _failed(far: bool) -> CleanFit:
    return CleanFit(SpotFit(False, 0.0, 0, 0, 0, UPRIGHT, False, False), 0.0, far)


@kernel
def has_left(image: Image, p: Floats, noise: PixelNoise) -> bool:
    """Whether the light at the expected centre has fallen so far that the spot must be elsewhere.

    At a distance of 0.8 standard deviations it has fallen below three quarters. The general fit from there
    would take many passes, each of them as long as a new search for the spot.
    """
    ny, nx = image.shape
    x, y = round(p[X]), round(p[Y])
    if not (1 <= x < nx - 1 and 1 <= y < ny - 1):
        return False
    light = 0.0
    for j in range(y - 1, y + 2):
        for i in range(x - 1, x + 2):
            light += image[j, i] / 9.0
    light -= p[BACKGROUND]
    expected = min(p[AMPLITUDE], noise.full_scale_dn - p[BACKGROUND])
    variance = background_variance(p[BACKGROUND], noise) + expected * noise.dn_per_e
    return bool(light < 0.75 * expected - 5.0 * math.sqrt(variance / 9.0))


@kernel
def fit_clean(
    image: Image, work: Workspace, rough: bool, tilted: bool, noise: PixelNoise, tables: Singles
) -> CleanFit:
    """Fisher scoring; `work.parameters` holds the start values and is updated in place.

    With rough start values (`rough`) the first passes read only some of the rows of an upright spot. With
    `tilted` the covariance is fitted too. The result has ``converged = False`` also if the model reaches full
    scale or too many pixels are outliers; the general fit is needed then.
    """
    ny, nx = image.shape
    p = work.parameters
    gradient = np.empty(TILTED)
    size = TILTED if tilted else UPRIGHT
    step = np.zeros(TILTED)
    has_information = False
    has_prefetched = False
    gate_opened = rough
    gate = GATE
    if rough:
        # Rough start values leave large residuals on the spot itself. But a residual of half the amplitude
        # on a dark pixel cannot come from them: it is a hot pixel.
        floor = background_variance(p[BACKGROUND], noise)
        gate = max(4.0 * GATE, 0.25 * p[AMPLITUDE] * p[AMPLITUDE] / floor)
    for _ in range(_MAX_PASSES):
        floor = background_variance(p[BACKGROUND], noise)
        peak_variance = floor + p[AMPLITUDE] * (noise.dn_per_e + p[AMPLITUDE] * noise.prnu2)
        if p[AMPLITUDE] + p[BACKGROUND] + 3.0 * math.sqrt(peak_variance) >= noise.full_scale_dn:
            return _failed(False)
        window = window_of(p, nx, ny, REACH)
        x0, y0 = window.x0, window.y0
        wx, wy = window.x1 - x0, window.y1 - y0
        # widen rows to whole vectors: the remaining pixels one by one would take longer than a wider row
        whole_vectors = (wx + _VECTOR_PIXELS - 1) // _VECTOR_PIXELS * _VECTOR_PIXELS
        left = x0 - (whole_vectors - wx) // 2
        if left >= 0 and left + whole_vectors <= nx:
            x0, wx = left, whole_vectors
        if min(p[SIGMA_X], p[SIGMA_Y]) < MIN_SIGMA_PX or max(wx, wy) > LARGEST_TABLE or min(wx, wy) < 4:
            return _failed(False)
        if not has_prefetched:
            prefetch_window(image, x0, y0, wx, wy)
            has_prefetched = True
        if tilted:
            chi2, pixels = score_tilted(image, x0, y0, wx, wy, tables[0], p, floor, noise, gate, gradient)
        else:
            profile(tables[:ALONG_Y], x0, wx, p[X], p[SIGMA_X])
            profile(tables[ALONG_Y:], y0, wy, p[Y], p[SIGMA_Y])
            row_step = max(1, int(0.7 * p[SIGMA_Y])) if rough else 1
            chi2, pixels = score(
                image, x0, y0, wx, wy, row_step, tables, p[AMPLITUDE], p[BACKGROUND], floor, noise.dn_per_e,
                noise.prnu2, gate, gradient,
            )  # fmt: skip
        outliers = wx * wy - int(pixels)
        many = outliers > _MAX_OUTLIERS + 0.002 * wx * wy
        if many and not gate_opened:
            if has_left(image, p, noise):
                return _failed(True)
            # The spot has moved further than expected, and much of its light is rejected as outliers. The
            # remaining pixels would hardly tell where it went: repeat once without a limit for outliers.
            gate_opened = True
            gate = math.inf
            continue
        if not has_information:
            # Sums over a grid with steps of sigma are exact (see `information`), unless the image's edge cuts
            # the spot. Of a tilted spot the sigma along a row or column counts.
            narrow = math.sqrt(1.0 - (p[COVARIANCE] / (p[SIGMA_X] * p[SIGMA_Y])) ** 2)
            step_x = max(1, int(narrow * p[SIGMA_X])) if x0 > 0 and x0 + wx < nx else 1
            step_y = max(1, int(narrow * p[SIGMA_Y])) if y0 > 0 and y0 + wy < ny else 1
            if tilted:
                grid = Window(x0, y0, x0 + wx, y0 + wy)
                information_tilted(image, grid, p, noise, step_x, step_y, work.information)
            else:
                information(
                    wx, wy, tables, p[AMPLITUDE], floor, noise.dn_per_e, noise.prnu2, step_x, step_y,
                    work.information,
                )  # fmt: skip
            if not cholesky(work.information, size, work.factor):
                return _failed(False)
            has_information = True
        solve(work.factor, size, gradient, step)
        max_step = 0.5 if rough else 0.2
        if (
            abs(step[SIGMA_X]) > max_step * p[SIGMA_X]
            or abs(step[SIGMA_Y]) > max_step * p[SIGMA_Y]
            or abs(step[AMPLITUDE]) > 1.5 * max_step * p[AMPLITUDE]
        ):
            return _failed(True)
        if abs(step[X]) > p[SIGMA_X] or abs(step[Y]) > p[SIGMA_Y]:
            return _failed(True)
        # Scoring neglects the second derivatives of the model, which couple the parameters. The error
        # left in x after a step is therefore about the product of its own step and the sum of all
        # steps, in units of sigma.
        sigma = min(p[SIGMA_X], p[SIGMA_Y])
        step_sum = (
            abs(step[X])
            + abs(step[Y])
            + abs(step[SIGMA_X])
            + abs(step[SIGMA_Y])
            + abs(step[COVARIANCE]) / sigma
            + sigma * abs(step[AMPLITUDE]) / p[AMPLITUDE]
        )
        u_x = math.sqrt(inverse_diagonal(work.factor, size, X))
        u_y = math.sqrt(inverse_diagonal(work.factor, size, Y))
        small = (
            abs(step[X]) * step_sum < _MAX_ITERATION_ERROR * u_x * sigma
            and abs(step[Y]) * step_sum < _MAX_ITERATION_ERROR * u_y * sigma
        )
        width_change = max(abs(step[SIGMA_X]) / p[SIGMA_X], abs(step[SIGMA_Y]) / p[SIGMA_Y])
        changed = max(abs(step[AMPLITUDE]) / p[AMPLITUDE], width_change) > 0.03
        for k in range(size):
            p[k] += step[k]
        if abs(p[COVARIANCE]) > _MAX_CORRELATION * p[SIGMA_X] * p[SIGMA_Y]:
            return _failed(False)
        scatter = chi2 / max(pixels, 1.0)
        gate_is_final = gate <= GATE * _MAX_CLEAN_CHI2
        # within the range where the model is linear, a step reduces chi-square by gradient . step
        expected = chi2
        if step_sum < 0.5 * sigma:
            for k in range(size):
                expected -= gradient[k] * step[k]
        gate = GATE * max(1.0, expected / max(pixels, 1.0))
        if changed:
            # the information matrix depends on size and amplitude, and hardly on the position
            has_information = False
        elif rough:
            rough = False
        elif small and gate_is_final:
            if many or scatter > _MAX_CLEAN_CHI2:
                return _failed(False)
            for k in range(size):
                chi2 -= gradient[k] * step[k]
            tilt = 0.0
            if not tilted:
                tilt = gradient[COVARIANCE] / math.sqrt(max(work.information[COVARIANCE, COVARIANCE], 1e-300))
            return CleanFit(SpotFit(True, chi2, int(pixels), 0, outliers, size, tilted, False), tilt, False)
    return _failed(False)
