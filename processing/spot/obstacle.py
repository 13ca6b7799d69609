"""Spot cut by an obstacle: search for the obstacle's edge, and fit of the light that is left.

Light that is missing on one side shifts a fit that expects it, by far more than the residuals suggest: the
fit becomes narrower, or treats as outliers what it cannot explain. But the edge of an obstacle is a step of
the residuals along a line, from light to darkness, steeper and straighter than any structure of a beam.
Without the pixels behind that line the fit is unbiased again, and its information gives the uncertainty from
the rest of the light. If too little is left for a fit, the spot is lost.

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
    Fitted,
    HalfPlane,
    Image,
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
"""State of a spot: without obstacle; cut, with a fit of the rest; cut, with too little left."""

FEWEST_OUTLIERS = 6
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
"""Distance before the line within which pixels are left out, too: the obstacle may cover a part of them."""
_BEHIND_PX = 8.0
"""Distance behind an edge within which it must be dark."""
_MAX_DARK_LIGHT = 0.2
"""Light behind an edge, relative to the step, above which a pixel is lit."""
_MAX_LIT_FRACTION = 0.02
"""Largest fraction of lit pixels behind an edge."""
_MIN_MISSING_SIGNIFICANCE = 8.0
"""Smallest significance of the light that is missing."""
_MIN_STEP_HEIGHT = 0.25
"""Step, relative to the brightest light, above which it is not a structure of the beam itself."""
_MAX_REMAINING_CHI2 = 0.5
"""Largest fraction of chi-square that remains without the hidden pixels if there is an obstacle; in a beam
that is not Gaussian more remains."""
_MAX_U_FROM_REST = 0.1
"""Largest standard uncertainty, relative to sigma, of a position from the rest of the light."""


@kernel
def _left_by(image: Image, window: Window, p: Floats, amplitude: float) -> Floats:
    """Image minus background and a Gaussian of `amplitude`, DN, in a window."""
    pxx, pyy, pxy = inverse_covariance(p)
    found = np.empty((window.y1 - window.y0, window.x1 - window.x0))
    for j in range(window.y0, window.y1):
        v = j - p[Y]
        for i in range(window.x0, window.x1):
            u = i - p[X]
            square = pxx * u * u + 2.0 * pxy * u * v + pyy * v * v
            found[j - window.y0, i - window.x0] = (
                image[j, i] - p[BACKGROUND] - amplitude * math.exp(-0.5 * square)
            )
    return found


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
    left = _left_by(image, window, p, amplitude)
    rows, columns = left.shape
    floor = background_variance(p[BACKGROUND], noise)
    along_x = along_y = total = 0.0
    weights = np.zeros((rows, columns))
    for j in range(1, rows - 1):
        for i in range(1, columns - 1):
            gx = 0.5 * (left[j, i + 1] - left[j, i - 1])
            gy = 0.5 * (left[j + 1, i] - left[j - 1, i])
            square = gx * gx + gy * gy
            light = max(image[window.y0 + j, window.x0 + i] - p[BACKGROUND], 0.0)
            if square > _MIN_GRADIENT_SQUARE * (floor + light * noise.dn_per_e):
                size = math.sqrt(square)
                weight = square * square * square
                weights[j, i] = weight
                total += weight
                along_x -= weight * gx / size
                along_y -= weight * gy / size
    length = math.hypot(along_x, along_y)
    if not length > _MIN_PARALLELISM * total:
        return nothing_hidden(), 0.0
    along_x /= length
    along_y /= length
    at = 0.0
    # without the pixels whose gradient has another direction, and from the second pass on only near the line
    for count in range(3):
        mass = moment = second = squares = 0.0
        for j in range(1, rows - 1):
            for i in range(1, columns - 1):
                weight = weights[j, i]
                if weight == 0.0:
                    continue
                gx = 0.5 * (left[j, i + 1] - left[j, i - 1])
                gy = 0.5 * (left[j + 1, i] - left[j - 1, i])
                if -(gx * along_x + gy * along_y) < _MIN_COSINE * math.hypot(gx, gy):
                    continue
                distance = along_x * i + along_y * j
                if count > 0 and abs(distance - at) > _MAX_LINE_DISTANCE_PX:
                    continue
                mass += weight
                moment += weight * distance
                second += weight * distance * distance
                squares += weight * weight
        if mass == 0.0:
            return nothing_hidden(), 0.0
        at = moment / mass
    scatter = math.sqrt(max(second / mass - at * at, 0.0))
    if mass < 0.5 * total or scatter > _MAX_LINE_SCATTER_PX or mass * mass < _MIN_EFFECTIVE_PIXELS * squares:
        return nothing_hidden(), 0.0
    edge = HalfPlane(along_x, along_y, at + along_x * window.x0 + along_y * window.y0)
    step = _step_into_dark(image, window, edge, p[BACKGROUND], floor)
    return (edge, step) if step > 0.0 else (nothing_hidden(), 0.0)


@kernel
def _step_into_dark(image: Image, window: Window, edge: HalfPlane, background: float, floor: float) -> float:
    """Light before an edge over the brightest; 0 if more than `_MAX_LIT_FRACTION` behind it is lit."""
    step = brightest = 0.0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            beyond = edge.along_x * i + edge.along_y * j - edge.distance
            if -3.0 < beyond < -1.0:
                step = max(step, image[j, i] - background)
            brightest = max(brightest, image[j, i] - background)
    limit = _MAX_DARK_LIGHT * step + 5.0 * math.sqrt(floor)
    pixels = lit = 0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            if 2.0 < edge.along_x * i + edge.along_y * j - edge.distance < _BEHIND_PX:
                pixels += 1
                if image[j, i] - background > limit:
                    lit += 1
    return step / brightest if step > 0.0 and pixels > 0 and lit <= _MAX_LIT_FRACTION * pixels else 0.0


@kernel
def _missing(image: Image, p: Floats, edge: HalfPlane, noise: PixelNoise) -> float:
    """Significance of the light that a fit expects behind an edge and that is missing there."""
    ny, nx = image.shape
    window = window_of(p, nx, ny, REACH)
    pxx, pyy, pxy = inverse_covariance(p)
    floor = background_variance(p[BACKGROUND], noise)
    total = variance = 0.0
    for j in range(window.y0, window.y1):
        v = j - p[Y]
        for i in range(window.x0, window.x1):
            if edge.along_x * i + edge.along_y * j > edge.distance:
                u = i - p[X]
                light = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v))
                total += p[BACKGROUND] + light - image[j, i]
                variance += floor + light * (noise.dn_per_e + light * noise.prnu2)
    return total / math.sqrt(variance) if variance > 0.0 else 0.0


@kernel
def fit_uncovered(image: Image, work: Workspace, noise: PixelNoise, whole: Fitted) -> tuple[int, Fitted]:
    """Fit the rest of a spot that an obstacle cuts; `work` holds the fit of the whole one.

    Returns the state and a fit: WHOLE or HIDDEN and `whole`, or CUT and the new fit, which is in `work` then.
    """
    p = work.parameters
    edge, step = edge_of(image, p, p[AMPLITUDE], noise)
    if step == 0.0:
        # a fit to a small rest of the spot has larger residuals beside the light than at the edge
        edge, step = edge_of(image, p, 0.0, noise)
    if step == 0.0:
        return WHOLE, whole
    trial = p.copy()
    before = HalfPlane(edge.along_x, edge.along_y, edge.distance - _MARGIN_BEFORE_LINE_PX)
    information, factor = np.empty((PARAMETERS, PARAMETERS)), np.empty((PARAMETERS, PARAMETERS))
    rest = fit_general(
        image, Workspace(trial, information, factor), whole.tilted, False, noise, REACH, before
    )
    # a small step may be a structure of a beam that is not Gaussian
    otherwise = HIDDEN if step > _MIN_STEP_HEIGHT else WHOLE
    if not rest.done:
        return otherwise, whole
    unknowns = TILTED if whole.tilted else UPRIGHT
    fits = rest.chi2 < poor_fit_limit(rest.pixels) * max(rest.pixels - unknowns, 1)
    fits = fits and rest.outliers < FEWEST_OUTLIERS + 0.01 * rest.pixels
    if not fits and rest.chi2 * whole.pixels > _MAX_REMAINING_CHI2 * whole.chi2 * rest.pixels:
        return WHOLE, whole
    if _missing(image, trial, edge, noise) < _MIN_MISSING_SIGNIFICANCE:
        # no light is missing: the step is a structure of the beam
        return WHOLE, whole
    sigma = min(trial[SIGMA_X], trial[SIGMA_Y])
    u_px = math.sqrt(max(inverse_diagonal(factor, PARAMETERS, X), inverse_diagonal(factor, PARAMETERS, Y)))
    if not fits or u_px > _MAX_U_FROM_REST * sigma:
        return otherwise, whole
    for k in range(PARAMETERS):
        p[k] = trial[k]
        for m in range(PARAMETERS):
            work.information[k, m] = information[k, m]
            work.factor[k, m] = factor[k, m]
    return CUT, rest
