"""Spot cut by an obstacle: search for the obstacle's edge, and fit of the light that is left.

Light that is missing on one side shifts a fit of the whole spot by far more than the residuals suggest. The
fitted spot becomes narrower, or the pixels that it cannot explain count as outliers. But the edge of an
obstacle is a step of the residuals along a line, from light to darkness, steeper and straighter than any
structure of a beam. Without the pixels behind that line the fit is unbiased again, and its information gives
the uncertainty from the rest of the light. If too little is left for a fit, the spot is lost.

The gradients of the residuals, by central differences, are summed with their sixth power as the weight: the
slopes of a beam that is not Gaussian surround it on all sides and cancel, those of a step do not.
"""

import math

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    PARAMETERS,
    REACH,
    SIGMA_X,
    SIGMA_Y,
    TILTED,
    UPRIGHT,
    HalfPlane,
    Image,
    SpotFit,
    Window,
    Workspace,
    X,
    Y,
    inverse_diagonal,
    nothing_hidden,
    poor_fit_limit,
)
from processing.spot.general_fit import fit_general, inverse_covariance, window_of
from processing.spot.sensor_model import PixelNoise, background_variance

WHOLE, CUT, HIDDEN = range(3)
"""State of a spot: without obstacle; cut, with a fit of the rest; cut, with too little left for a fit."""
MIN_OUTLIERS = 6
"""Fewest outliers that suggest an edge; fewer are hot pixels."""
_MARGIN_PX = 2
"""Pixels beyond the window of the fit in which the edge is searched for."""
_MIN_GRADIENT_SQUARE = 12.0
"""Squared gradient, relative to the variance of a pixel, below which it may be noise."""
_MIN_PARALLELISM = 0.6
"""Length of the mean unit vector of the gradients (1: all parallel) above which they belong to one edge."""
_MIN_COSINE = 0.8
"""Cosine of the angle to the mean direction above which a gradient belongs to the edge."""
_MAX_LINE_SCATTER_PX = 1.2
"""Largest scatter of the edge's pixels about a line."""
_MIN_EFFECTIVE_PIXELS = 3.0
"""Smallest effective number of pixels, by their weights, of an edge; fewer are a hot pixel."""
_MAX_LINE_DISTANCE_PX = 3.0
"""Largest distance from the line of a pixel of the edge."""
_MARGIN_BEFORE_LINE_PX = 1.0
"""Distance before the line within which pixels are left out as well, since the obstacle may cover parts of
them."""
_BEHIND_PX = 8.0
"""Distance behind an edge within which it must be dark."""
_MAX_DARK_LIGHT = 0.2
"""Light behind an edge, relative to the step, above which a pixel is lit."""
_MAX_LIT_FRACTION = 0.02
"""Largest fraction of lit pixels behind an edge."""
_MIN_MISSING_SIGNIFICANCE = 8.0
"""Smallest significance of the light that is missing."""
_MIN_STEP_HEIGHT = 0.25
"""Step, relative to the brightest light, above which the edge is that of an obstacle and not of the beam."""
_MAX_REMAINING_CHI2 = 0.5
"""Largest fraction of chi-square per pixel that remains without the pixels behind an obstacle. Of a beam that
is not Gaussian a larger fraction remains without pixels on one side."""
_MAX_U_FROM_REST = 0.1
"""Largest standard uncertainty, relative to sigma, of a position from the rest of the light."""


@kernel
def _residual_image(image: Image, window: Window, p: Floats, amplitude: float) -> Floats:
    """Image minus background and a Gaussian of `amplitude`, DN, in a window."""
    pxx, pyy, pxy = inverse_covariance(p)
    residual = np.empty((window.y1 - window.y0, window.x1 - window.x0))
    for j in range(window.y0, window.y1):
        v = j - p[Y]
        for i in range(window.x0, window.x1):
            u = i - p[X]
            light = amplitude * math.exp(-0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v))
            residual[j - window.y0, i - window.x0] = image[j, i] - p[BACKGROUND] - light
    return residual


@kernel
def edge_of(image: Image, p: Floats, amplitude: float, noise: PixelNoise) -> tuple[HalfPlane, float]:
    """Half-plane behind the edge of an obstacle, and the step there relative to the brightest light.

    Without an edge the half-plane has no pixels and the step is 0. `p` is a fit of the whole spot; with an
    `amplitude` of 0 the edge is searched for in the light itself instead of the residuals.
    """
    ny, nx = image.shape
    inner = window_of(p, nx, ny, REACH)
    window = Window(
        max(0, inner.x0 - _MARGIN_PX),
        max(0, inner.y0 - _MARGIN_PX),
        min(nx, inner.x1 + _MARGIN_PX),
        min(ny, inner.y1 + _MARGIN_PX),
    )
    residual = _residual_image(image, window, p, amplitude)
    rows, columns = residual.shape
    background_var = background_variance(p[BACKGROUND], noise)
    normal_x = normal_y = total = 0.0
    weights = np.zeros((rows, columns))
    for j in range(1, rows - 1):
        for i in range(1, columns - 1):
            gx = 0.5 * (residual[j, i + 1] - residual[j, i - 1])
            gy = 0.5 * (residual[j + 1, i] - residual[j - 1, i])
            gradient2 = gx * gx + gy * gy
            light = max(image[window.y0 + j, window.x0 + i] - p[BACKGROUND], 0.0)
            if gradient2 > _MIN_GRADIENT_SQUARE * (background_var + light * noise.dn_per_e):
                gradient = math.sqrt(gradient2)
                weight = gradient2 * gradient2 * gradient2
                weights[j, i] = weight
                total += weight
                normal_x -= weight * gx / gradient
                normal_y -= weight * gy / gradient
    length = math.hypot(normal_x, normal_y)
    if not length > _MIN_PARALLELISM * total:
        return nothing_hidden(), 0.0
    normal_x /= length
    normal_y /= length
    edge_distance = 0.0
    # the sums leave out pixels whose gradient has another direction and, from the second pass on, pixels far
    # from the line
    for pass_number in range(3):
        weight_sum = moment = second_moment = weight2_sum = 0.0
        for j in range(1, rows - 1):
            for i in range(1, columns - 1):
                weight = weights[j, i]
                if weight == 0.0:
                    continue
                gx = 0.5 * (residual[j, i + 1] - residual[j, i - 1])
                gy = 0.5 * (residual[j + 1, i] - residual[j - 1, i])
                if -(gx * normal_x + gy * normal_y) < _MIN_COSINE * math.hypot(gx, gy):
                    continue
                distance = normal_x * i + normal_y * j
                if pass_number > 0 and abs(distance - edge_distance) > _MAX_LINE_DISTANCE_PX:
                    continue
                weight_sum += weight
                moment += weight * distance
                second_moment += weight * distance * distance
                weight2_sum += weight * weight
        if weight_sum == 0.0:
            return nothing_hidden(), 0.0
        edge_distance = moment / weight_sum
    scatter = math.sqrt(max(second_moment / weight_sum - edge_distance * edge_distance, 0.0))
    has_few_pixels = weight_sum * weight_sum < _MIN_EFFECTIVE_PIXELS * weight2_sum
    if weight_sum < 0.5 * total or scatter > _MAX_LINE_SCATTER_PX or has_few_pixels:
        return nothing_hidden(), 0.0
    edge = HalfPlane(normal_x, normal_y, edge_distance + normal_x * window.x0 + normal_y * window.y0)
    step = _step_into_dark(image, window, edge, p[BACKGROUND], background_var)
    return (edge, step) if step > 0.0 else (nothing_hidden(), 0.0)


@kernel
def _step_into_dark(
    image: Image, window: Window, edge: HalfPlane, background: float, background_var: float
) -> float:
    """Light before an edge over the brightest; 0 if more than `_MAX_LIT_FRACTION` behind it is lit."""
    step = brightest = 0.0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            if -3.0 < edge.normal_x * i + edge.normal_y * j - edge.distance < -1.0:
                step = max(step, image[j, i] - background)
            brightest = max(brightest, image[j, i] - background)
    limit = _MAX_DARK_LIGHT * step + 5.0 * math.sqrt(background_var)
    pixels = lit = 0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            if 2.0 < edge.normal_x * i + edge.normal_y * j - edge.distance < _BEHIND_PX:
                pixels += 1
                if image[j, i] - background > limit:
                    lit += 1
    return step / brightest if step > 0.0 and pixels > 0 and lit <= _MAX_LIT_FRACTION * pixels else 0.0


@kernel
def _missing_significance(image: Image, p: Floats, edge: HalfPlane, noise: PixelNoise) -> float:
    """Significance of the light that a fit expects behind an edge and that is missing there."""
    ny, nx = image.shape
    window = window_of(p, nx, ny, REACH)
    pxx, pyy, pxy = inverse_covariance(p)
    background_var = background_variance(p[BACKGROUND], noise)
    total = variance = 0.0
    for j in range(window.y0, window.y1):
        v = j - p[Y]
        for i in range(window.x0, window.x1):
            if edge.normal_x * i + edge.normal_y * j > edge.distance:
                u = i - p[X]
                light = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v))
                total += p[BACKGROUND] + light - image[j, i]
                variance += background_var + light * (noise.dn_per_e + light * noise.prnu2)
    return total / math.sqrt(variance) if variance > 0.0 else 0.0


@kernel
def fit_uncovered(image: Image, work: Workspace, noise: PixelNoise, whole: SpotFit) -> tuple[int, SpotFit]:
    """Fit the rest of a spot that an obstacle cuts; `work` holds the fit of the whole one.

    Returns (WHOLE, whole), (HIDDEN, whole) or (CUT, fit of the rest); in the last case `work` holds that fit.
    """
    p = work.parameters
    edge, step = edge_of(image, p, p[AMPLITUDE], noise)
    if step == 0.0:
        # a fit to a small rest of the spot has larger residuals beside the light than at the edge
        edge, step = edge_of(image, p, 0.0, noise)
    if step == 0.0:
        return WHOLE, whole
    trial = p.copy()
    left_out = HalfPlane(edge.normal_x, edge.normal_y, edge.distance - _MARGIN_BEFORE_LINE_PX)
    information, factor = np.empty((PARAMETERS, PARAMETERS)), np.empty((PARAMETERS, PARAMETERS))
    trial_work = Workspace(trial, information, factor)
    rest = fit_general(image, trial_work, whole.tilted, False, noise, REACH, left_out)
    # a small step may be a structure of a beam that is not Gaussian
    state_without_fit = HIDDEN if step > _MIN_STEP_HEIGHT else WHOLE
    if not rest.converged:
        return state_without_fit, whole
    free_parameters = TILTED if whole.tilted else UPRIGHT
    fits = rest.chi2 < poor_fit_limit(rest.pixels) * max(rest.pixels - free_parameters, 1)
    fits = fits and rest.outliers < MIN_OUTLIERS + 0.01 * rest.pixels
    if not fits and rest.chi2 * whole.pixels > _MAX_REMAINING_CHI2 * whole.chi2 * rest.pixels:
        return WHOLE, whole
    if _missing_significance(image, trial, edge, noise) < _MIN_MISSING_SIGNIFICANCE:
        # no light is missing: the step is a structure of the beam
        return WHOLE, whole
    sigma = min(trial[SIGMA_X], trial[SIGMA_Y])
    u_px = math.sqrt(max(inverse_diagonal(factor, PARAMETERS, X), inverse_diagonal(factor, PARAMETERS, Y)))
    if not fits or u_px > _MAX_U_FROM_REST * sigma:
        return state_without_fit, whole
    for k in range(PARAMETERS):
        p[k] = trial[k]
        for m in range(PARAMETERS):
            work.information[k, m] = information[k, m]
            work.factor[k, m] = factor[k, m]
    return CUT, rest
