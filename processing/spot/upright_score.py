"""Quick scoring of a spot whose axes lie along the pixels: rows times columns.

The pixel-integrated Gaussian is the product of one profile along x and one along y, so that a pixel
costs a handful of multiplications in single precision, which the compiler makes vectors of.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.spot import Image

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SMALLEST_SIGMA_PX = 1.5
"""Below it the expansion of the pixel integral has no accuracy to speak of."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def profile(table: Singles, first: int, count: int, centre: float, sigma: float) -> None:
    """Pixel-integrated Gaussian of unit peak density, its derivatives in centre and sigma.

    The integral over a pixel is the density times 1 + h2/24 + h4/1920, h2 and h4 being Hermite
    polynomials of u = (i - centre)/sigma over sigma^2 and sigma^4 (Taylor in the pixel's width;
    the next term is below 3e-7 for sigma of 3 px). The exponential goes from pixel to pixel by two
    multiplications, outward from the centre.
    """
    s2 = 1.0 / (sigma * sigma)
    inverse = 1.0 / sigma
    middle = min(max(round(centre) - first, 0), count - 1)
    q = math.exp(-s2)
    d = first + middle - centre
    start = math.exp(-0.5 * d * d * s2)
    for direction in range(2):
        step = 1.0 if direction == 0 else -1.0
        g = start
        ratio = math.exp(-(step * d + 0.5) * s2)
        i = middle
        stop = count if direction == 0 else -1
        move = 1 if direction == 0 else -1
        while i != stop:
            u = (first + i - centre) * inverse
            u2 = u * u
            h2 = (u2 - 1.0) * s2 / 24.0
            h4 = ((u2 - 6.0) * u2 + 3.0) * s2 * s2 / 1920.0
            value = g * (1.0 + h2 + h4)
            # derivative of the density is u/sigma times it; of the correction, its own derivative
            slope = value * u * inverse - g * inverse * (
                2.0 * u * s2 / 24.0 + (4.0 * u2 - 12.0) * u * s2 * s2 / 1920.0
            )
            width = value * u2 * inverse - g * inverse * (
                (4.0 * u2 - 2.0) * s2 / 24.0 + ((8.0 * u2 - 36.0) * u2 + 12.0) * s2 * s2 / 1920.0
            )
            table[0, i] = value
            table[1, i] = slope
            table[2, i] = width
            g *= ratio
            ratio *= q
            i += move


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def score(
    image: Image,
    x0: int,
    y0: int,
    nx: int,
    ny: int,
    row_step: int,
    table: Singles,
    amplitude: float,
    background: float,
    dark_variance: float,
    inverse_gain: float,
    uneven: float,
    gate: float,
    gradient: Floats,
) -> tuple[float, float]:
    """Gradient of the log likelihood in (A, x, y, sigma_x, sigma_y, B, c), chi2, pixels kept.

    c is the covariance of the spot's axes, 0 here; its gradient tells whether the spot is tilted. Every
    `row_step`-th row stands for those between. Pixels whose squared residual exceeds `gate` variances are
    left out.
    """
    one = np.float32(1.0)
    zero = np.float32(0.0)
    level = np.float32(background)
    dark = np.float32(dark_variance)
    shot = np.float32(inverse_gain)
    spread = np.float32(uneven)
    limit = np.float32(gate)
    # plain slices and counts instead of a maximum: the loop below must become vector code
    ex = table[0, :nx]
    dx = table[1, :nx]
    wx = table[2, :nx]
    g0 = g1 = g2 = g3 = g4 = g5 = g6 = np.float64(0.0)
    chi2 = np.float64(0.0)
    kept = np.float64(0.0)
    for j in range(row_step // 2, ny, row_step):
        row = image[y0 + j, x0 : x0 + nx]
        light = np.float32(amplitude) * table[3, j]
        s0 = np.float32(0.0)
        se = np.float32(0.0)
        sx = np.float32(0.0)
        sw = np.float32(0.0)
        sc = np.float32(0.0)
        so = np.float32(0.0)
        for i in range(nx):
            m = light * ex[i]
            r = np.float32(row[i]) - level - m
            d = r / (dark + m * (shot + m * spread))
            z = d * r
            keep = one if z <= limit else zero
            d *= keep
            s0 += d
            se += d * ex[i]
            sx += d * dx[i]
            sw += d * wx[i]
            sc += z * keep
            so += keep
        g0 += table[3, j] * se
        g1 += light * sx
        g2 += amplitude * table[4, j] * se
        g3 += light * sw
        g4 += amplitude * table[5, j] * se
        g5 += s0
        g6 += amplitude * table[4, j] * sx
        chi2 += sc
        kept += so
    gradient[0] = row_step * g0
    gradient[1] = row_step * g1
    gradient[2] = row_step * g2
    gradient[3] = row_step * g3
    gradient[4] = row_step * g4
    gradient[5] = row_step * g5
    gradient[6] = row_step * g6
    return float(row_step * chi2), float(row_step * kept)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def information(
    nx: int,
    ny: int,
    table: Singles,
    amplitude: float,
    dark_variance: float,
    inverse_gain: float,
    uneven: float,
    step_x: int,
    step_y: int,
    matrix: Floats,
) -> None:
    """Fisher information of (A, x, y, sigma_x, sigma_y, B, c), symmetric, from every step-th row and column.

    Sums of Gaussians over a grid that is finer than sigma are exact to many digits, so the steps
    cost nothing but time saved.
    """
    for k in range(7):
        for m in range(k + 1):
            matrix[k, m] = 0.0
    columns = 0
    rows = 0
    for j in range(step_y // 2, ny, step_y):
        rows += 1
        columns = 0
        # along a row the information is made of ten sums of products of three profiles
        see = sed = sew = sdd = sdw = sww = se = sd = sw = s1 = 0.0
        for i in range(step_x // 2, nx, step_x):
            columns += 1
            e = table[0, i]
            d = table[1, i]
            w = table[2, i]
            light = amplitude * e * table[3, j]
            weight = 1.0 / (dark_variance + light * (inverse_gain + light * uneven))
            we = weight * e
            wd = weight * d
            ww = weight * w
            see += we * e
            sed += we * d
            sew += we * w
            sdd += wd * d
            sdw += wd * w
            sww += ww * w
            se += we
            sd += wd
            sw += ww
            s1 += weight
        ey = table[3, j]
        dy = amplitude * table[4, j]
        wy = amplitude * table[5, j]
        ay = amplitude * ey
        matrix[0, 0] += ey * ey * see
        matrix[1, 0] += ay * ey * sed
        matrix[1, 1] += ay * ay * sdd
        matrix[2, 0] += dy * ey * see
        matrix[2, 1] += dy * ay * sed
        matrix[2, 2] += dy * dy * see
        matrix[3, 0] += ay * ey * sew
        matrix[3, 1] += ay * ay * sdw
        matrix[3, 2] += ay * dy * sew
        matrix[3, 3] += ay * ay * sww
        matrix[4, 0] += wy * ey * see
        matrix[4, 1] += wy * ay * sed
        matrix[4, 2] += wy * dy * see
        matrix[4, 3] += wy * ay * sew
        matrix[4, 4] += wy * wy * see
        matrix[5, 0] += ey * se
        matrix[5, 1] += ay * sd
        matrix[5, 2] += dy * se
        matrix[5, 3] += ay * sw
        matrix[5, 4] += wy * se
        matrix[5, 5] += s1
        matrix[6, 0] += dy * ey * sed
        matrix[6, 1] += dy * ay * sdd
        matrix[6, 2] += dy * dy * sed
        matrix[6, 3] += dy * ay * sdw
        matrix[6, 4] += dy * wy * sed
        matrix[6, 5] += dy * sd
        matrix[6, 6] += dy * dy * sdd
    # the background alone reaches to the window's edge, where the last step sticks out or falls short
    matrix[5, 5] *= nx * ny / (rows * columns * step_x * step_y)
    for k in range(7):
        for m in range(k + 1):
            matrix[k, m] *= step_x * step_y
            matrix[m, k] = matrix[k, m]
