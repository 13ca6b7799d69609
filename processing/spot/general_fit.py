"""Maximum-likelihood fit of any spot: tilted, saturated, with outliers, or with a second spot.

This fit works in double precision and is slower than that of `clean_fit`.

The expected value of a pixel at distance (u, v) from the centre of a spot with covariance matrix C is, with
P = C^-1, background B and amplitude A,

    mu = B + A f,   f = g [1 + (q_x^2 - P_xx + q_y^2 - P_yy)/24],   g = exp(-(u, v) P (u, v)^T / 2)

with (q_x, q_y) = P (u, v): the Gaussian integrated over the pixel, to second order in the pixel's
width (the square bracket holds 1 + (1/24) Laplacian of g, over g).

Fisher scoring: with the variance s^2 of each pixel from the model itself, and derivatives d = dmu/dp,

    gradient = sum d (I - mu)/s^2,   information = sum d d^T/s^2,   p <- p + information^-1 gradient

until the step is a small fraction of the standard uncertainty. The derivatives are those of g, multiplied
by the square bracket; the derivative of the bracket itself is neglected. This causes no bias: at the
true parameters the residuals I - mu have the expectation zero, so that the gradient vanishes on average
whatever factors the residuals are multiplied by.
"""

import math

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    GATE,
    PARAMETERS,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
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
    cholesky,
    inverse_diagonal,
    solve,
)
from processing.spot.sensor_model import PixelNoise, background_variance

_MAX_PASSES = 80
_PASSES_BEFORE_HALVING = 12
"""Number of passes after which the fit is assumed to oscillate; steps are then halved."""
_MAX_MAHALANOBIS2 = 2.0 * 20.7
"""Squared Mahalanobis distance (u, v) P (u, v)^T beyond which the light is less than 1e-9 of the peak."""


@kernel
def inverse_covariance(p: Floats) -> tuple[float, float, float]:
    """Elements xx, yy and xy of the inverse covariance matrix P = C^-1, px^-2."""
    xx, yy = p[SIGMA_X] * p[SIGMA_X], p[SIGMA_Y] * p[SIGMA_Y]
    determinant = xx * p[SIGMA_Y] * p[SIGMA_Y] - p[COVARIANCE] * p[COVARIANCE]
    return yy / determinant, xx / determinant, -p[COVARIANCE] / determinant


@kernel
def _add_pixel(
    size: int, weight: float, weighted_residual: float, derivative: Floats, gradient: Floats, matrix: Floats
) -> None:
    """Add a pixel to the sums of the first `size` parameters; these sums take most of the time of a fit."""
    for k in range(size):
        gradient[k] += weighted_residual * derivative[k]
        weighted = weight * derivative[k]
        for m in range(k + 1):
            matrix[k, m] += weighted * derivative[m]


@kernel
def _light_at(u: float, v: float, pxx: float, pyy: float, pxy: float) -> tuple[float, float, float]:
    """Light f of unit amplitude, q_x and q_y at a distance (u, v) from the centre."""
    qx = pxx * u + pxy * v
    qy = pxy * u + pyy * v
    mahalanobis2 = u * qx + v * qy
    f = 0.0
    if mahalanobis2 < _MAX_MAHALANOBIS2:
        f = math.exp(-0.5 * mahalanobis2) * (1.0 + (qx * qx - pxx + qy * qy - pyy) / 24.0)
    return f, qx, qy


@kernel
def score_general(
    image: Image,
    window: Window,
    p: Floats,
    tilted: bool,
    has_second: bool,
    noise: PixelNoise,
    gate: float,
    hidden: HalfPlane,
    gradient: Floats,
    information: Floats,
    step_x: int = 1,
    step_y: int = 1,
) -> tuple[float, int, int, int]:
    """Gradient and Fisher information of the log likelihood, summed over a window.

    Returns chi-square, the number of the pixels used, and those of pixels near full scale and of outliers.
    Two kinds of pixels are left out. The first are those that the model expects within three standard
    deviations of full scale. The model decides and not the measured value: choosing by the data would
    keep the pixels whose noise happened to be negative, and bias the fit. The second are outliers, whose
    squared residual exceeds `gate` variances.

    Parameters
    ----------
    image : (ny, nx), DN
    window : pixels to sum over
    p : (PARAMETERS,) parameters of the model (see `fit_values`)
    tilted, has_second : whether the covariance and the second spot are fitted
    noise : noise model of a pixel
    gate : limit of the squared residual, in variances
    hidden : half-plane of pixels that are neither used nor counted
    gradient, information : (PARAMETERS,), (PARAMETERS, PARAMETERS), overwritten. Of a parameter that is not
        fitted the gradient is 0, the row and column of the information are those of a unit matrix.
    step_x, step_y : columns and rows from one pixel of the sum to the next
    """
    pxx, pyy, pxy = inverse_covariance(p)
    for k in range(PARAMETERS):
        gradient[k] = 0.0
        for m in range(PARAMETERS):
            information[k, m] = 0.0
    derivative = np.zeros(PARAMETERS)
    derivative[BACKGROUND] = 1.0
    floor = background_variance(p[BACKGROUND], noise)
    chi2 = 0.0
    pixels = saturated = outliers = 0
    for j in range(window.y0 + step_y // 2, window.y1, step_y):
        v = j - p[Y]
        v_second = j - p[SECOND_Y]
        limit = hidden.distance - hidden.normal_y * j
        for i in range(window.x0 + step_x // 2, window.x1, step_x):
            if hidden.normal_x * i > limit:
                continue
            f, qx, qy = _light_at(i - p[X], v, pxx, pyy, pxy)
            light = p[AMPLITUDE] * f
            # dg/dC = g q q^T / 2. With C_xx = sigma_x^2 this gives dg/dsigma_x = g q_x^2 sigma_x. The
            # covariance stands in C twice (C_xy and C_yx), hence dg/dc = g q_x q_y.
            derivative[AMPLITUDE] = f
            derivative[X] = light * qx
            derivative[Y] = light * qy
            derivative[SIGMA_X] = light * qx * qx * p[SIGMA_X]
            derivative[SIGMA_Y] = light * qy * qy * p[SIGMA_Y]
            derivative[COVARIANCE] = light * qx * qy
            if has_second:
                f_second, qx_second, qy_second = _light_at(i - p[SECOND_X], v_second, pxx, pyy, pxy)
                light_second = p[SECOND_AMPLITUDE] * f_second
                light += light_second
                derivative[SIGMA_X] += light_second * qx_second * qx_second * p[SIGMA_X]
                derivative[SIGMA_Y] += light_second * qy_second * qy_second * p[SIGMA_Y]
                derivative[COVARIANCE] += light_second * qx_second * qy_second
                derivative[SECOND_AMPLITUDE] = f_second
                derivative[SECOND_X] = light_second * qx_second
                derivative[SECOND_Y] = light_second * qy_second
            # shot noise and uneven response need a positive light; the second spot's amplitude, or the
            # bracket of f far from the centre, can make the model negative
            positive_light = max(light, 0.0)
            variance = floor + positive_light * (noise.dn_per_e + positive_light * noise.prnu2)
            mu = p[BACKGROUND] + light
            if mu + 3.0 * math.sqrt(variance) >= noise.full_scale_dn:
                saturated += 1
                continue
            residual = image[j, i] - mu
            pixel_chi2 = residual * residual / variance
            if pixel_chi2 > gate:
                outliers += 1
                continue
            weight = 1.0 / variance
            chi2 += pixel_chi2
            pixels += 1
            weighted_residual = weight * residual
            # a constant number of parameters each, for which the compiler unrolls the sums
            if has_second:
                _add_pixel(PARAMETERS, weight, weighted_residual, derivative, gradient, information)
            elif tilted:
                _add_pixel(TILTED, weight, weighted_residual, derivative, gradient, information)
            else:
                _add_pixel(UPRIGHT, weight, weighted_residual, derivative, gradient, information)
    # a row and column of the unit matrix give a parameter that is not fitted the step zero
    for k in range(PARAMETERS):
        if (k == COVARIANCE and not tilted) or (k >= SECOND_AMPLITUDE and not has_second):
            for m in range(PARAMETERS):
                information[max(k, m), min(k, m)] = 0.0
            information[k, k] = 1.0
            gradient[k] = 0.0
    for k in range(PARAMETERS):
        for m in range(k):
            information[m, k] = information[k, m]
    return chi2, pixels, saturated, outliers


@kernel
def window_of(p: Floats, nx: int, ny: int, reach: float) -> Window:
    """Pixels within `reach` standard deviations of the centre, cut at the image's edges."""
    hx = math.ceil(reach * p[SIGMA_X])
    hy = math.ceil(reach * p[SIGMA_Y])
    cx = round(p[X])
    cy = round(p[Y])
    return Window(max(0, cx - hx), max(0, cy - hy), min(nx, cx + hx + 1), min(ny, cy + hy + 1))


@kernel
def fit_general(
    image: Image,
    work: Workspace,
    tilted: bool,
    has_second: bool,
    noise: PixelNoise,
    reach: float,
    hidden: HalfPlane,
) -> SpotFit:
    """Fisher scoring until convergence; `work.parameters` holds the start values and is updated in place.

    `gate`, the limit for outliers, follows the scatter of the pixels used. It is infinite at first, so that
    large residuals of poor start values are not taken for outliers, and it stays wide where the beam is not
    Gaussian, in proportion to chi-square.

    `reach` is the half-width of the window in standard deviations of the spot; `hidden` pixels are ignored.
    The result has ``converged = False`` also if too few pixels are left or parameters leave their range.
    """
    ny, nx = image.shape
    p = work.parameters
    gradient, step = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    gate = math.inf
    chi2 = 0.0
    pixels = saturated = outliers = 0
    window = window_of(p, nx, ny, reach)
    for count in range(_MAX_PASSES):
        if window.x1 - window.x0 < 3 or window.y1 - window.y0 < 3:
            break
        chi2, pixels, saturated, outliers = score_general(
            image, window, p, tilted, has_second, noise, gate, hidden, gradient, work.information
        )
        if pixels < 12 or not cholesky(work.information, PARAMETERS, work.factor):
            break
        solve(work.factor, PARAMETERS, gradient, step)
        # Limit the step in each parameter: further away the linear expansion about p is not valid. `worst` is
        # the largest step in units of its limit.
        limit = 0.5 * min(p[SIGMA_X], p[SIGMA_Y])
        worst = max(
            max(abs(step[X]), abs(step[Y])) / limit,
            abs(step[SIGMA_X]) / (0.3 * p[SIGMA_X]),
            abs(step[SIGMA_Y]) / (0.3 * p[SIGMA_Y]),
            abs(step[AMPLITUDE]) / (0.7 * p[AMPLITUDE]),
        )
        if has_second:
            worst = max(worst, max(abs(step[SECOND_X]), abs(step[SECOND_Y])) / limit)
        shrink = 1.0 if worst <= 1.0 else 1.0 / worst
        # pixels that are left out in one pass and used in the next can make the fit oscillate
        damping = 1.0 if count < _PASSES_BEFORE_HALVING else 0.5
        for k in range(PARAMETERS):
            p[k] += damping * shrink * step[k]
        # the covariance matrix is positive definite only for |c| < sigma_x sigma_y
        bound = 0.98 * p[SIGMA_X] * p[SIGMA_Y]
        p[COVARIANCE] = min(max(p[COVARIANCE], -bound), bound)
        if not (
            p[SIGMA_X] > 0.3
            and p[SIGMA_Y] > 0.3
            and p[SIGMA_X] < 4 * nx + 10
            and p[SIGMA_Y] < 4 * ny + 10
            and p[AMPLITUDE] > 0.0
            and -2 * p[SIGMA_X] <= p[X] <= nx - 1 + 2 * p[SIGMA_X]
            and -2 * p[SIGMA_Y] <= p[Y] <= ny - 1 + 2 * p[SIGMA_Y]
        ):
            break
        # a window that moved with the last small steps could also make the fit oscillate
        if count < 3 or worst > 0.1:
            window = window_of(p, nx, ny, reach)
        scatter = max(1.0, chi2 / max(pixels - UPRIGHT, 1))
        new_gate = GATE * scatter
        gate_is_stable = gate < math.inf and abs(new_gate - gate) <= 0.02 * gate
        if worst <= 0.5:
            gate = new_gate
        # an oscillation of 0.2 standard uncertainties is accepted: it adds 2 % to the scatter
        tolerance = (1e-3 if count < _PASSES_BEFORE_HALVING else 0.2) * math.sqrt(scatter)
        u_x = math.sqrt(max(inverse_diagonal(work.factor, PARAMETERS, X), 1e-30))
        u_y = math.sqrt(max(inverse_diagonal(work.factor, PARAMETERS, Y), 1e-30))
        small = abs(step[X]) < tolerance * u_x and abs(step[Y]) < tolerance * u_y
        if small and worst <= 1.0 and (gate_is_stable or count > 2 * _PASSES_BEFORE_HALVING):
            return SpotFit(True, chi2, pixels, saturated, outliers, PARAMETERS, tilted, has_second)
    return SpotFit(False, chi2, pixels, saturated, outliers, PARAMETERS, tilted, has_second)
