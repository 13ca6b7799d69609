"""Fast gradient and Fisher information of a spot whose axes are turned against the pixels.

Along a row the light of a tilted Gaussian is a Gaussian too: with P the inverse of the covariance matrix and
(u, v) the distance from the centre, completing the square gives

    (u, v) P (u, v)^T = P_xx w^2 + C v^2,   w = u + (P_xy/P_xx) v,   C = P_yy - P_xy^2/P_xx.

The second term is constant in a row. Each pixel then takes one exponential in single precision, written as a
polynomial so that the compiler turns it into vector instructions.
"""

import math

import numpy as np

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    PARAMETERS,
    SIGMA_X,
    SIGMA_Y,
    TILTED,
    Image,
    Window,
    X,
    Y,
    nothing_hidden,
)
from processing.spot.general_fit import inverse_covariance, score_general
from processing.spot.sensor_model import PixelNoise

_EXPONENT_DIVISOR = 32.0
"""Divisor of the exponent before the exponential series; the sum is then squared five times."""
_MAX_EXPONENT = np.float32(20.7 / _EXPONENT_DIVISOR)
"""Divided exponent beyond which the light is less than 1e-9 of the peak."""


@kernel(fastmath=True)
def score_tilted(
    image: Image,
    x0: int,
    y0: int,
    nx: int,
    ny: int,
    columns: Singles,
    p: Floats,
    floor: float,
    noise: PixelNoise,
    gate: float,
    gradient: Floats,
) -> tuple[float, float]:
    """Gradient of the log likelihood by the first TILTED parameters, written into `gradient`.

    Model and derivatives are those of `general_fit`, for a spot that stays below full scale. `columns` is
    working memory, `floor` the variance of a pixel without light. Pixels whose squared residual exceeds
    `gate` variances are left out. Returns chi-square and number of the pixels used.
    """
    pxx, pyy, pxy = inverse_covariance(p)
    across = pyy - pxy * pxy / pxx
    one, zero = np.float32(1.0), np.float32(0.0)
    level, dark = np.float32(p[BACKGROUND]), np.float32(floor)
    shot, spread = np.float32(noise.dn_per_e), np.float32(noise.prnu2)
    limit = np.float32(gate)
    largest = np.float32(_MAX_EXPONENT)
    # the unit of w is that whose square is the divided exponent
    unit = math.sqrt(2.0 * _EXPONENT_DIVISOR / pxx)
    curvature = (pxx * pxx + pxy * pxy) / 24.0 * unit * unit
    # 1/2, 1/6 and 1/24 of the exponential series: with exponents divided by _EXPONENT_DIVISOR the error is
    # below 2e-7
    half = np.float32(0.5)
    sixth = np.float32(1.0 / 6.0)
    twenty_fourth = np.float32(1.0 / 24.0)
    for i in range(nx):
        columns[i] = np.float32(i / unit)
    column = columns[:nx]
    for k in range(TILTED):
        gradient[k] = 0.0
    chi2 = kept = np.float64(0.0)
    for j in range(ny):
        row = image[y0 + j, x0 : x0 + nx]
        v = y0 + j - p[Y]
        slope = across * v
        light = p[AMPLITUDE] * math.exp(-0.5 * slope * v)
        first = np.float32((x0 - p[X] + pxy / pxx * v) / unit)
        # the square bracket of `general_fit` is a polynomial in w
        flat = np.float32(light * (1.0 + (slope * slope - pxx - pyy) / 24.0))
        skew = np.float32(light * 2.0 * pxy * slope / 24.0 * unit)
        curved = np.float32(light * curvature)
        s0 = sm = s1 = s2 = sc = so = zero
        for i in range(nx):
            w = column[i] + first
            t = w * w
            t = t if t < largest else largest
            e = one - t * (one - t * (half - t * (sixth - t * twenty_fourth)))
            e *= e
            e *= e
            e *= e
            e *= e
            e *= e
            m = e * (flat + w * (skew + w * curved))
            r = np.float32(row[i]) - level - m
            d = r / (dark + m * (shot + m * spread))
            z = d * r
            keep = one if z <= limit else zero
            d *= keep
            dm = d * m
            s0 += d
            sm += dm
            s1 += dm * w
            s2 += dm * w * w
            sc += z * keep
            so += keep
        by_w = unit * s1
        by_w2 = unit * unit * s2
        gradient[AMPLITUDE] += sm / p[AMPLITUDE]
        gradient[X] += pxx * by_w
        gradient[Y] += pxy * by_w + slope * sm
        gradient[SIGMA_X] += p[SIGMA_X] * pxx * pxx * by_w2
        gradient[SIGMA_Y] += p[SIGMA_Y] * (pxy * pxy * by_w2 + 2.0 * pxy * slope * by_w + slope * slope * sm)
        gradient[BACKGROUND] += s0
        gradient[COVARIANCE] += pxx * (pxy * by_w2 + slope * by_w)
        chi2 += sc
        kept += so
    return float(chi2), float(kept)


@kernel
def information_tilted(
    image: Image, window: Window, p: Floats, noise: PixelNoise, step_x: int, step_y: int, matrix: Floats
) -> None:
    """Fisher information of the first TILTED parameters, summed over every step-th row and column.

    Like that of `upright_score.information` it is exact to many digits, for steps of up to the sigma of the
    light along a row or column.
    """
    score_general(
        image, window, p, True, False, noise, math.inf, nothing_hidden(), np.empty(PARAMETERS), matrix,
        step_x, step_y,
    )  # fmt: skip
    width, height = window.x1 - window.x0, window.y1 - window.y0
    columns = (width - step_x // 2 + step_x - 1) // step_x
    rows = (height - step_y // 2 + step_y - 1) // step_y
    matrix[BACKGROUND, BACKGROUND] *= width * height / (rows * columns * step_x * step_y)
    for k in range(TILTED):
        for m in range(TILTED):
            matrix[k, m] *= step_x * step_y
