"""A spot that an obstacle cuts: where its edge lies, and the fit of the light that is left.

Light that is missing on one side shifts a fit that expects it, by far more than the residuals tell: the fit
becomes narrower, or takes what it cannot explain for outliers. But the edge of an obstacle is a step of the
residuals along a line, from the light to darkness, steeper and straighter than anything in a beam. Without
the pixels behind that line the fit is unbiased again, and its information says how well the rest tells the
place. A spot of which too little is left for that is lost.

The gradient of the residuals, by central differences, is summed with its sixth power as the weight: the
slopes of a beam that is no Gaussian surround it on all sides and cancel, those of a step do not.
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
"""No obstacle; cut, and fitted to what is left; cut, and too little is left."""

FEWEST_OUTLIERS = 6
"""Fewer outliers are hot pixels: an edge that costs light leaves more."""
_MARGIN_PX = 2
"""Beyond the window of the fit."""
_CLEAR = 12.0
"""Squared gradient over the variance of a pixel, below which it may be noise."""
_ONE_WAY = 0.6
"""Mean direction of the gradients (1: all alike), above which they belong to one edge."""
_ALONG = 0.8
"""Cosine of the angle to that direction up to which a gradient belongs to the edge."""
_STRAIGHT_PX = 1.2
"""Largest scatter of the edge's pixels about a line."""
_FEWEST = 3.0
"""Fewest pixels, by their weights, that are an edge and no hot pixel."""
_NEAR_PX = 3.0
_BEFORE_PX = 1.0
"""Pixels so far before the line are left out, too: the obstacle may cover a part of them."""
_BEHIND_PX = 8.0
"""Darkness is looked for so far behind an edge."""
_DARK = 0.2
"""Part of the step that may be seen behind it, in some of its pixels (`_LIT`)."""
_LIT = 0.02
_MISSING = 8.0
"""Significance of the light that is missing."""
_TALL = 0.25
"""Step, over the brightest light, that no beam of its own has along a line into darkness."""
_EXPLAINS = 0.5
"""Part of chi-square left without what an obstacle hides; of a beam that is no Gaussian it is more."""
_TOLD = 0.1
"""Largest standard uncertainty, over sigma, of a place that the rest of the light tells."""


@kernel
def _left_by(image: Image, window: Window, p: Floats, amplitude: float) -> Floats:
    """Image minus background and a spot of this amplitude, DN, in a window."""
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
    """The half-plane behind the edge of an obstacle, and the step there over the brightest light.

    Without an edge it is a half-plane without pixels. `p` is a fit of the whole spot; with an `amplitude` of
    0 it is the light that is looked at, not what the fit leaves of it.
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
            if square > _CLEAR * (floor + light * noise.dn_per_e):
                size = math.sqrt(square)
                weight = square * square * square
                weights[j, i] = weight
                total += weight
                along_x -= weight * gx / size
                along_y -= weight * gy / size
    length = math.hypot(along_x, along_y)
    if not length > _ONE_WAY * total:
        return nothing_hidden(), 0.0
    along_x /= length
    along_y /= length
    at = 0.0
    # without the pixels that point elsewhere, then with those near the line alone
    for count in range(3):
        mass = moment = second = squares = 0.0
        for j in range(1, rows - 1):
            for i in range(1, columns - 1):
                weight = weights[j, i]
                if weight == 0.0:
                    continue
                gx = 0.5 * (left[j, i + 1] - left[j, i - 1])
                gy = 0.5 * (left[j + 1, i] - left[j - 1, i])
                if -(gx * along_x + gy * along_y) < _ALONG * math.hypot(gx, gy):
                    continue
                distance = along_x * i + along_y * j
                if count > 0 and abs(distance - at) > _NEAR_PX:
                    continue
                mass += weight
                moment += weight * distance
                second += weight * distance * distance
                squares += weight * weight
        if mass == 0.0:
            return nothing_hidden(), 0.0
        at = moment / mass
    scatter = math.sqrt(max(second / mass - at * at, 0.0))
    if mass < 0.5 * total or scatter > _STRAIGHT_PX or mass * mass < _FEWEST * squares:
        return nothing_hidden(), 0.0
    edge = HalfPlane(along_x, along_y, at + along_x * window.x0 + along_y * window.y0)
    step = _step_into_dark(image, window, edge, p[BACKGROUND], floor)
    return (edge, step) if step > 0.0 else (nothing_hidden(), 0.0)


@kernel
def _step_into_dark(image: Image, window: Window, edge: HalfPlane, background: float, floor: float) -> float:
    """Light before an edge over the brightest; 0 if some pixels behind are as bright as a part of it."""
    step = brightest = 0.0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            beyond = edge.along_x * i + edge.along_y * j - edge.distance
            if -3.0 < beyond < -1.0:
                step = max(step, image[j, i] - background)
            brightest = max(brightest, image[j, i] - background)
    limit = _DARK * step + 5.0 * math.sqrt(floor)
    pixels = lit = 0
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            if 2.0 < edge.along_x * i + edge.along_y * j - edge.distance < _BEHIND_PX:
                pixels += 1
                if image[j, i] - background > limit:
                    lit += 1
    return step / brightest if step > 0.0 and pixels > 0 and lit <= _LIT * pixels else 0.0


@kernel
def _missing(image: Image, p: Floats, edge: HalfPlane, noise: PixelNoise) -> float:
    """Significance of the light that a fit expects behind an edge and that is not there."""
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
    """Fit again what an obstacle leaves of a spot; `work` holds the fit of the whole one.

    Returns WHOLE and the fit as it was, CUT and the new one, or HIDDEN. Only for CUT is `work` changed.
    """
    p = work.parameters
    edge, step = edge_of(image, p, p[AMPLITUDE], noise)
    if step == 0.0:
        # a fit to a small rest of the spot leaves more beside the light than at the edge
        edge, step = edge_of(image, p, 0.0, noise)
    if step == 0.0:
        return WHOLE, whole
    trial = p.copy()
    before = HalfPlane(edge.along_x, edge.along_y, edge.distance - _BEFORE_PX)
    information, factor = np.empty((PARAMETERS, PARAMETERS)), np.empty((PARAMETERS, PARAMETERS))
    rest = fit_general(
        image, Workspace(trial, information, factor), whole.tilted, False, noise, REACH, before
    )
    # a small step beside a beam that is no Gaussian is its own
    otherwise = HIDDEN if step > _TALL else WHOLE
    if not rest.done:
        return otherwise, whole
    unknowns = TILTED if whole.tilted else UPRIGHT
    fits = rest.chi2 < poor_fit_limit(rest.pixels) * max(rest.pixels - unknowns, 1)
    fits = fits and rest.outliers < FEWEST_OUTLIERS + 0.01 * rest.pixels
    if not fits and rest.chi2 * whole.pixels > _EXPLAINS * whole.chi2 * rest.pixels:
        return WHOLE, whole
    if _missing(image, trial, edge, noise) < _MISSING:
        # nothing is missing: a step that belongs to the light itself
        return WHOLE, whole
    sigma = min(trial[SIGMA_X], trial[SIGMA_Y])
    u_px = math.sqrt(max(inverse_diagonal(factor, PARAMETERS, X), inverse_diagonal(factor, PARAMETERS, Y)))
    if not fits or u_px > _TOLD * sigma:
        return otherwise, whole
    for k in range(PARAMETERS):
        p[k] = trial[k]
        for m in range(PARAMETERS):
            work.information[k, m] = information[k, m]
            work.factor[k, m] = factor[k, m]
    return CUT, rest
