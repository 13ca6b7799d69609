"""Fast fit of a clean spot whose axes lie along the pixels, by Fisher scoring with `upright_score`.

It serves nearly every frame of a measurement. A spot that it does not suit is left to `general_fit`.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    Fitted,
    Workspace,
    X,
    Y,
)
from processing.spot.general_fit import window_of
from processing.spot.linear_algebra import cholesky, inverse_diagonal, solve
from processing.spot.prefetch import prefetch_window
from processing.spot.sensor_model import PixelNoise, background_variance
from processing.spot.spot import Image
from processing.spot.upright_score import ALONG_Y, SMALLEST_SIGMA_PX, information, profile, score

_PASSES = 10
LARGEST_TABLE = 2048
_VECTOR = 32
"""Largest number of pixels that one vector instruction handles."""

_MOST_OUTLIERS = 8
_LARGEST_SCATTER = 1.3
"""Chi-square per pixel above which the spot is not treated as clean and upright."""

_LEFT_OVER = 0.03
"""Allowed numerical error as a fraction of the standard uncertainty; it adds 0.05 % to the scatter."""

TILT_EVIDENCE = 6.0
"""Significance of the tilt, in standard deviations, above which a spot is not treated as upright."""


class UprightFit(NamedTuple):
    """Result of an upright fit."""

    fitted: Fitted
    tilt: float
    """Significance of a tilt in standard deviations: the gradient by the covariance, divided by the square
    root of its information (score test)."""
    far: bool
    """The start values were too far from the spot: from better ones the same fit may well succeed."""


@njit(cache=True, nogil=True, error_model="numpy")
def _not_done(far: bool) -> UprightFit:
    return UprightFit(Fitted(False, 0.0, 0, 0, 0, UPRIGHT, False, False), 0.0, far)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_upright(
    image: Image, work: Workspace, rough: bool, noise: PixelNoise, tables: NDArray[np.float32]
) -> UprightFit:
    """Fisher scoring; `work.parameters` holds the start values and is updated in place.

    With rough start values (`rough`) the first passes read only some of the rows. The result has
    ``done = False`` if the model reaches full scale, too many pixels are outliers, or the fit does not
    converge; the general fit is needed then.
    """
    ny, nx = image.shape
    p = work.parameters
    gradient = np.empty(TILTED)
    step = np.empty(UPRIGHT)
    informed = False
    fetched = False
    opened = rough
    gate = GATE
    if rough:
        # Rough start values leave large residuals on the spot itself. But a residual of half the amplitude
        # on a dark pixel cannot come from them: it is a hot pixel.
        floor = background_variance(p[BACKGROUND], noise)
        gate = max(4.0 * GATE, 0.25 * p[AMPLITUDE] * p[AMPLITUDE] / floor)
    for _ in range(_PASSES):
        floor = background_variance(p[BACKGROUND], noise)
        peak_variance = floor + p[AMPLITUDE] * (noise.dn_per_e + p[AMPLITUDE] * noise.prnu2)
        if p[AMPLITUDE] + p[BACKGROUND] + 3.0 * math.sqrt(peak_variance) >= noise.full_scale_dn:
            return _not_done(False)
        window = window_of(p, nx, ny, REACH)
        x0, y0 = window.x0, window.y0
        wx, wy = window.x1 - x0, window.y1 - y0
        # widen rows to whole vectors: the remaining pixels one by one would take longer than a wider row
        wider = (wx + _VECTOR - 1) // _VECTOR * _VECTOR
        left = x0 - (wider - wx) // 2
        if left >= 0 and left + wider <= nx:
            x0, wx = left, wider
        if min(p[SIGMA_X], p[SIGMA_Y]) < SMALLEST_SIGMA_PX or max(wx, wy) > LARGEST_TABLE or min(wx, wy) < 4:
            return _not_done(False)
        if not fetched:
            prefetch_window(image, x0, y0, wx, wy)
            fetched = True
        profile(tables[:ALONG_Y], x0, wx, p[X], p[SIGMA_X])
        profile(tables[ALONG_Y:], y0, wy, p[Y], p[SIGMA_Y])
        row_step = max(1, int(0.7 * p[SIGMA_Y])) if rough else 1
        chi2, kept = score(
            image, x0, y0, wx, wy, row_step, tables, p[AMPLITUDE], p[BACKGROUND], floor, noise.dn_per_e,
            noise.prnu2, gate, gradient,
        )  # fmt: skip
        outliers = wx * wy - int(kept)
        many = outliers > _MOST_OUTLIERS + 0.002 * wx * wy
        if many and not opened:
            # The spot has moved further than expected, and much of its light is rejected as outliers. The
            # remaining pixels would hardly tell where it went: repeat once without a limit for outliers.
            opened = True
            gate = math.inf
            continue
        if not informed:
            # sums over a grid with steps of sigma are exact (see `information`), unless the image's edge cuts
            # the spot
            step_x = max(1, int(p[SIGMA_X])) if x0 > 0 and x0 + wx < nx else 1
            step_y = max(1, int(p[SIGMA_Y])) if y0 > 0 and y0 + wy < ny else 1
            information(
                wx, wy, tables, p[AMPLITUDE], floor, noise.dn_per_e, noise.prnu2, step_x, step_y,
                work.information,
            )  # fmt: skip
            if not cholesky(work.information, UPRIGHT, work.factor):
                return _not_done(False)
            informed = True
        solve(work.factor, UPRIGHT, gradient, step)
        largest = 0.5 if rough else 0.2
        if (
            abs(step[SIGMA_X]) > largest * p[SIGMA_X]
            or abs(step[SIGMA_Y]) > largest * p[SIGMA_Y]
            or abs(step[AMPLITUDE]) > 1.5 * largest * p[AMPLITUDE]
        ):
            return _not_done(True)
        if abs(step[X]) > p[SIGMA_X] or abs(step[Y]) > p[SIGMA_Y]:
            return _not_done(True)
        # Scoring neglects the second derivatives of the model, which couple the parameters. The error
        # left in x after a step is therefore about the product of its own step and the sum of all
        # steps, in units of sigma.
        sigma = min(p[SIGMA_X], p[SIGMA_Y])
        others = (
            abs(step[X])
            + abs(step[Y])
            + abs(step[SIGMA_X])
            + abs(step[SIGMA_Y])
            + sigma * abs(step[AMPLITUDE]) / p[AMPLITUDE]
        )
        u_x = math.sqrt(inverse_diagonal(work.factor, UPRIGHT, X))
        u_y = math.sqrt(inverse_diagonal(work.factor, UPRIGHT, Y))
        small = (
            abs(step[X]) * others < _LEFT_OVER * u_x * sigma
            and abs(step[Y]) * others < _LEFT_OVER * u_y * sigma
        )
        changed = (
            max(
                abs(step[AMPLITUDE]) / p[AMPLITUDE],
                abs(step[SIGMA_X]) / p[SIGMA_X],
                abs(step[SIGMA_Y]) / p[SIGMA_Y],
            )
            > 0.03
        )
        for k in range(UPRIGHT):
            p[k] += step[k]
        scatter = chi2 / max(kept, 1.0)
        settled = gate <= GATE * _LARGEST_SCATTER
        # within the range where the model is linear, a step reduces chi-square by gradient . step
        expected = chi2
        if others < 0.5 * sigma:
            for k in range(UPRIGHT):
                expected -= gradient[k] * step[k]
        gate = GATE * max(1.0, expected / max(kept, 1.0))
        if changed:
            # the information matrix depends on size and amplitude, hardly on the position: compute it again
            # only when these have changed
            informed = False
        elif rough:
            rough = False
        elif small and settled:
            if many or scatter > _LARGEST_SCATTER:
                return _not_done(False)
            for k in range(UPRIGHT):
                chi2 -= gradient[k] * step[k]
            tilt = gradient[COVARIANCE] / math.sqrt(max(work.information[COVARIANCE, COVARIANCE], 1e-300))
            return UprightFit(Fitted(True, chi2, int(kept), 0, outliers, UPRIGHT, False, False), tilt, False)
    return _not_done(False)
