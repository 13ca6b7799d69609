"""Scoring that knows everything: tilt, saturation, outliers, a second spot. Slower, double precision.

Parameters, always ten: 0 amplitude, 1 x, 2 y, 3 a, 4 b, 5 background, 6 c, 7 second amplitude, 8 second
x, 9 second y. The spot's covariance matrix is [[a^2, c], [c, b^2]]; the second spot has the same shape.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.sensor_model import LEAST_VARIANCE_DN2
from processing.spot.spot import Image

Floats = NDArray[np.float64]

PARAMETERS = 10
_GATE = 25.0
_PASSES = 80
_SWINGING = 12


@njit(cache=True, nogil=True, error_model="numpy")
def _shape(p: Floats) -> tuple[float, float, float]:
    """Inverse covariance (xx, yy, xy)."""
    determinant = p[3] * p[3] * p[4] * p[4] - p[6] * p[6]
    return p[4] * p[4] / determinant, p[3] * p[3] / determinant, -p[6] / determinant


@njit(cache=True, nogil=True, error_model="numpy")
def background_variance(p: Floats, zero_variance: float, inverse_gain: float) -> float:
    """Variance of a pixel that holds the background alone, from the line's value at level 0."""
    return float(max(zero_variance + p[5] * inverse_gain, LEAST_VARIANCE_DN2))


@njit(cache=True, nogil=True, error_model="numpy")
def score_general(
    image: Image,
    x0: int,
    y0: int,
    x1: int,
    y1: int,
    p: Floats,
    tilted: bool,
    two: bool,
    zero_variance: float,
    inverse_gain: float,
    uneven: float,
    full_scale: float,
    gate: float,
    gradient: Floats,
    matrix: Floats,
) -> tuple[float, int, int, int]:
    """Gradient and Fisher information over a window.

    `uneven` is the squared relative spread of the pixels' response.
    Pixels that the MODEL expects within three standard deviations of full scale are left out (a mask
    from the data would bias), and those whose squared residual exceeds `gate` variances.

    Returns
    -------
    chi2, pixels, saturated, outliers
        Of the pixels that were kept; how many were left out.
    """
    pxx, pyy, pxy = _shape(p)
    for k in range(PARAMETERS):
        gradient[k] = 0.0
        for m in range(PARAMETERS):
            matrix[k, m] = 0.0
    derivative = np.zeros(PARAMETERS)
    derivative[5] = 1.0
    floor = background_variance(p, zero_variance, inverse_gain)
    # what is not fitted is not summed
    size = PARAMETERS if two else (7 if tilted else 6)
    chi2 = 0.0
    pixels = 0
    saturated = 0
    outliers = 0
    # beyond this the light is less than 1e-9 of the peak
    far = 2.0 * 20.7
    for j in range(y0, y1):
        v = j - p[2]
        v2 = j - p[9]
        for i in range(x0, x1):
            u = i - p[1]
            qx = pxx * u + pxy * v
            qy = pxy * u + pyy * v
            exponent = u * qx + v * qy
            f = 0.0
            if exponent < far:
                f = math.exp(-0.5 * exponent) * (1.0 + (qx * qx - pxx + qy * qy - pyy) / 24.0)
            light = p[0] * f
            derivative[0] = f
            derivative[1] = light * qx
            derivative[2] = light * qy
            derivative[3] = light * qx * qx * p[3]
            derivative[4] = light * qy * qy * p[4]
            derivative[6] = light * qx * qy
            if two:
                u2 = i - p[8]
                qx2 = pxx * u2 + pxy * v2
                qy2 = pxy * u2 + pyy * v2
                exponent2 = u2 * qx2 + v2 * qy2
                f2 = 0.0
                if exponent2 < far:
                    f2 = math.exp(-0.5 * exponent2) * (1.0 + (qx2 * qx2 - pxx + qy2 * qy2 - pyy) / 24.0)
                light2 = p[7] * f2
                light += light2
                derivative[3] += light2 * qx2 * qx2 * p[3]
                derivative[4] += light2 * qy2 * qy2 * p[4]
                derivative[6] += light2 * qx2 * qy2
                derivative[7] = f2
                derivative[8] = light2 * qx2
                derivative[9] = light2 * qy2
            lit = max(light, 0.0)
            variance = floor + lit * (inverse_gain + lit * uneven)
            mu = p[5] + light
            if mu + 3.0 * math.sqrt(variance) >= full_scale:
                saturated += 1
                continue
            r = image[j, i] - mu
            z = r * r / variance
            if z > gate:
                outliers += 1
                continue
            weight = 1.0 / variance
            chi2 += z
            pixels += 1
            wr = weight * r
            for k in range(size):
                gradient[k] += wr * derivative[k]
                wk = weight * derivative[k]
                for m in range(k + 1):
                    matrix[k, m] += wk * derivative[m]
    for k in range(PARAMETERS):
        if (k == 6 and not tilted) or (k >= 7 and not two):
            for m in range(PARAMETERS):
                matrix[max(k, m), min(k, m)] = 0.0
            matrix[k, k] = 1.0
            gradient[k] = 0.0
    for k in range(PARAMETERS):
        for m in range(k):
            matrix[m, k] = matrix[k, m]
    return chi2, pixels, saturated, outliers


@njit(cache=True, nogil=True, error_model="numpy")
def cholesky(matrix: Floats, size: int, factor: Floats) -> bool:
    """Lower factor of a symmetric positive matrix; False where it is none."""
    for k in range(size):
        for m in range(k + 1):
            total = matrix[k, m]
            for n in range(m):
                total -= factor[k, n] * factor[m, n]
            if k == m:
                if not total > 1e-14 * matrix[k, k]:
                    return False
                factor[k, k] = math.sqrt(total)
            else:
                factor[k, m] = total / factor[m, m]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def solve(factor: Floats, size: int, right: Floats, solution: Floats) -> None:
    """Solution of (factor factor^T) x = right."""
    for k in range(size):
        total = right[k]
        for n in range(k):
            total -= factor[k, n] * solution[n]
        solution[k] = total / factor[k, k]
    for k in range(size - 1, -1, -1):
        total = solution[k]
        for n in range(k + 1, size):
            total -= factor[n, k] * solution[n]
        solution[k] = total / factor[k, k]


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_diagonal(factor: Floats, size: int, index: int) -> float:
    """Element (index, index) of the inverse: the squared norm of one column of the factor's inverse."""
    column = np.zeros(size)
    total = 0.0
    for k in range(index, size):
        value = 1.0 if k == index else 0.0
        for n in range(index, k):
            value -= factor[k, n] * column[n]
        column[k] = value / factor[k, k]
        total += column[k] * column[k]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def window_of(p: Floats, nx: int, ny: int, reach: float) -> tuple[int, int, int, int]:
    """Pixels within `reach` standard deviations of the centre, cut at the image: x0, y0, x1, y1."""
    hx = math.ceil(reach * p[3])
    hy = math.ceil(reach * p[4])
    cx = round(p[1])
    cy = round(p[2])
    return max(0, cx - hx), max(0, cy - hy), min(nx, cx + hx + 1), min(ny, cy + hy + 1)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_general(
    image: Image,
    p: Floats,
    tilted: bool,
    two: bool,
    zero_variance: float,
    inverse_gain: float,
    uneven: float,
    full_scale: float,
    reach: float,
    matrix: Floats,
    factor: Floats,
) -> tuple[bool, float, int, int, int]:
    """Fisher scoring to convergence. `p` is improved in place; False where it failed.

    The gate follows the scatter of what it keeps: it starts wide, so that a poor start is not taken for
    outliers, and where the beam is no Gaussian it stays as wide as the misfit.
    """
    ny, nx = image.shape
    size = PARAMETERS
    gradient = np.zeros(size)
    step = np.zeros(size)
    gate = math.inf
    chi2 = 0.0
    pixels = saturated = outliers = 0
    x0, y0, x1, y1 = window_of(p, nx, ny, reach)
    for count in range(_PASSES):
        if x1 - x0 < 3 or y1 - y0 < 3:
            return False, chi2, pixels, saturated, outliers
        chi2, pixels, saturated, outliers = score_general(
            image, x0, y0, x1, y1, p, tilted, two, zero_variance, inverse_gain, uneven, full_scale, gate,
            gradient, matrix,
        )  # fmt: skip
        if pixels < 12 or not cholesky(matrix, size, factor):
            return False, chi2, pixels, saturated, outliers
        solve(factor, size, gradient, step)
        limit = 0.5 * min(p[3], p[4])
        worst = max(abs(step[1]), abs(step[2])) / limit
        worst = max(
            worst, abs(step[3]) / (0.3 * p[3]), abs(step[4]) / (0.3 * p[4]), abs(step[0]) / (0.7 * p[0])
        )
        if two:
            worst = max(worst, max(abs(step[8]), abs(step[9])) / limit)
        shrink = 1.0 if worst <= 1.0 else 1.0 / worst
        # pixels that come and go with the mask or the gate can make the fit swing between two places
        damping = 1.0 if count < _SWINGING else 0.5
        for k in range(size):
            p[k] += damping * shrink * step[k]
        bound = 0.98 * p[3] * p[4]
        p[6] = min(max(p[6], -bound), bound)
        if not (p[3] > 0.3 and p[4] > 0.3 and p[3] < 4 * nx + 10 and p[4] < 4 * ny + 10 and p[0] > 0.0):
            return False, chi2, pixels, saturated, outliers
        if not (-2 * p[3] <= p[1] <= nx - 1 + 2 * p[3] and -2 * p[4] <= p[2] <= ny - 1 + 2 * p[4]):
            return False, chi2, pixels, saturated, outliers
        # a window that still moved with the last steps would make the fit swing, too
        if count < 3 or worst > 0.1:
            x0, y0, x1, y1 = window_of(p, nx, ny, reach)
        scatter = max(1.0, chi2 / max(pixels - 6, 1))
        new_gate = _GATE * scatter
        settled = gate < math.inf and abs(new_gate - gate) <= 0.02 * gate
        if worst <= 0.5:
            gate = new_gate
        tolerance = (1e-3 if count < _SWINGING else 0.2) * math.sqrt(scatter)
        u_x = math.sqrt(max(inverse_diagonal(factor, size, 1), 1e-30))
        u_y = math.sqrt(max(inverse_diagonal(factor, size, 2), 1e-30))
        small = abs(step[1]) < tolerance * u_x and abs(step[2]) < tolerance * u_y
        if small and worst <= 1.0 and (settled or count > 2 * _SWINGING):
            return True, chi2, pixels, saturated, outliers
    return False, chi2, pixels, saturated, outliers
