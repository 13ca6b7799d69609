"""Fast gradient and Fisher information of a spot whose axes lie along the pixels.

The light of pixel (i, j) is A e_i e_j, the product of a pixel-integrated Gaussian along x and one along y,
and its derivatives are such products too. With the two profiles tabulated, a pixel takes a few
multiplications in single precision, which the compiler turns into vector instructions.
"""

import math

import numpy as np

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    SIGMA_X,
    SIGMA_Y,
    TILTED,
    Image,
    X,
    Y,
)

MIN_SIGMA_PX = 1.5
"""Smallest sigma for which the expansion of the pixel integral in the pixel's width is accurate enough."""
VALUE, BY_CENTRE, BY_SIGMA = range(3)
"""Rows of a profile: the pixel-integrated Gaussian and its derivatives with respect to centre and sigma."""
ALONG_Y = 3
"""First row of the profile along y in a table of both profiles; the profile along x starts at row 0."""
TABLE_ROWS = 6


@kernel(fastmath=True)
def profile(table: Singles, first: int, count: int, centre: float, sigma: float) -> None:
    """Tabulate a pixel-integrated Gaussian of unit peak density and its derivatives with respect to centre
    and sigma.

    Taylor expansion in the pixel's width gives the integral over a pixel as the density times

        1 + He2(u)/(24 sigma^2) + He4(u)/(1920 sigma^4),   u = (i - centre)/sigma,

    with the Hermite polynomials He2 = u^2 - 1 and He4 = u^4 - 6 u^2 + 3; the next term is below 3e-7
    for sigma = 3 px.

    From one pixel to the next the density exp(-u^2/2) changes by a ratio, which itself changes by the
    constant factor exp(-1/sigma^2): two multiplications replace an exponential. The recursion runs outward
    from the centre, so that rounding errors remain small relative to the falling value.
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
            # d(g h)/dcentre = g (h u - h')/sigma, with h = 1 + h2 + h4 and g the density; likewise by sigma
            slope = value * u * inverse - g * inverse * (
                2.0 * u * s2 / 24.0 + (4.0 * u2 - 12.0) * u * s2 * s2 / 1920.0
            )
            width = value * u2 * inverse - g * inverse * (
                (4.0 * u2 - 2.0) * s2 / 24.0 + ((8.0 * u2 - 36.0) * u2 + 12.0) * s2 * s2 / 1920.0
            )
            table[VALUE, i] = value
            table[BY_CENTRE, i] = slope
            table[BY_SIGMA, i] = width
            g *= ratio
            ratio *= q
            i += move


@kernel(fastmath=True)
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
    """Gradient of the log likelihood by the first TILTED parameters, written into `gradient`.

    Element p is the sum over pixels of (dmu/dp)(I - mu)/variance. The covariance c is zero here; the
    gradient by it shows whether the spot is tilted (dmu/dc = (dmu/dx)(dmu/dy)/(A f), f being the light of
    unit amplitude). Every `row_step`-th row is summed and represents the rows between. Pixels whose
    squared residual exceeds `gate` variances are left out. `dark_variance` is the variance of a pixel without
    light, `inverse_gain` and `uneven` are `dn_per_e` and `prnu2` of `PixelNoise`. Returns chi-square and
    number of the pixels used, both scaled by `row_step`.
    """
    one, zero = np.float32(1.0), np.float32(0.0)
    level, dark = np.float32(background), np.float32(dark_variance)
    shot, spread = np.float32(inverse_gain), np.float32(uneven)
    limit = np.float32(gate)
    # the compiler vectorises the loop below only with plain slices and without branches
    ex = table[VALUE, :nx]
    dx = table[BY_CENTRE, :nx]
    wx = table[BY_SIGMA, :nx]
    g_amplitude = g_x = g_y = g_sigma_x = g_sigma_y = g_background = g_covariance = np.float64(0.0)
    chi2 = kept = np.float64(0.0)
    for j in range(row_step // 2, ny, row_step):
        row = image[y0 + j, x0 : x0 + nx]
        light = np.float32(amplitude) * table[ALONG_Y + VALUE, j]
        s0 = se = sx = sw = sc = so = zero
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
        g_amplitude += table[ALONG_Y + VALUE, j] * se
        g_x += light * sx
        g_y += amplitude * table[ALONG_Y + BY_CENTRE, j] * se
        g_sigma_x += light * sw
        g_sigma_y += amplitude * table[ALONG_Y + BY_SIGMA, j] * se
        g_background += s0
        g_covariance += amplitude * table[ALONG_Y + BY_CENTRE, j] * sx
        chi2 += sc
        kept += so
    gradient[AMPLITUDE] = row_step * g_amplitude
    gradient[X] = row_step * g_x
    gradient[Y] = row_step * g_y
    gradient[SIGMA_X] = row_step * g_sigma_x
    gradient[SIGMA_Y] = row_step * g_sigma_y
    gradient[BACKGROUND] = row_step * g_background
    gradient[COVARIANCE] = row_step * g_covariance
    return float(row_step * chi2), float(row_step * kept)


@kernel(fastmath=True)
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
    """Fisher information of the first TILTED parameters, summed over every step-th row and column.

    Element (p, q) is the sum over pixels of (dmu/dp)(dmu/dq)/variance; `matrix` is overwritten. The sum of a
    Gaussian over a grid with steps of up to sigma equals its integral to many digits (Poisson summation:
    the relative error is about exp(-2 pi^2 sigma^2/step^2)), so that such steps lose no accuracy.
    """
    for k in range(TILTED):
        for m in range(k + 1):
            matrix[k, m] = 0.0
    columns = rows = 0
    for j in range(step_y // 2, ny, step_y):
        rows += 1
        columns = 0
        # Each derivative is a factor that depends on the row times a profile along x (or 1). All elements
        # of the matrix therefore follow from ten weighted sums of products of the profiles e, d, w per row.
        see = sed = sew = sdd = sdw = sww = se = sd = sw = s1 = 0.0
        for i in range(step_x // 2, nx, step_x):
            columns += 1
            e = table[VALUE, i]
            d = table[BY_CENTRE, i]
            w = table[BY_SIGMA, i]
            light = amplitude * e * table[ALONG_Y + VALUE, j]
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
        ey = table[ALONG_Y + VALUE, j]
        dy = amplitude * table[ALONG_Y + BY_CENTRE, j]
        wy = amplitude * table[ALONG_Y + BY_SIGMA, j]
        ay = amplitude * ey
        matrix[AMPLITUDE, AMPLITUDE] += ey * ey * see
        matrix[X, AMPLITUDE] += ay * ey * sed
        matrix[X, X] += ay * ay * sdd
        matrix[Y, AMPLITUDE] += dy * ey * see
        matrix[Y, X] += dy * ay * sed
        matrix[Y, Y] += dy * dy * see
        matrix[SIGMA_X, AMPLITUDE] += ay * ey * sew
        matrix[SIGMA_X, X] += ay * ay * sdw
        matrix[SIGMA_X, Y] += ay * dy * sew
        matrix[SIGMA_X, SIGMA_X] += ay * ay * sww
        matrix[SIGMA_Y, AMPLITUDE] += wy * ey * see
        matrix[SIGMA_Y, X] += wy * ay * sed
        matrix[SIGMA_Y, Y] += wy * dy * see
        matrix[SIGMA_Y, SIGMA_X] += wy * ay * sew
        matrix[SIGMA_Y, SIGMA_Y] += wy * wy * see
        matrix[BACKGROUND, AMPLITUDE] += ey * se
        matrix[BACKGROUND, X] += ay * sd
        matrix[BACKGROUND, Y] += dy * se
        matrix[BACKGROUND, SIGMA_X] += ay * sw
        matrix[BACKGROUND, SIGMA_Y] += wy * se
        matrix[BACKGROUND, BACKGROUND] += s1
        matrix[COVARIANCE, AMPLITUDE] += dy * ey * sed
        matrix[COVARIANCE, X] += dy * ay * sdd
        matrix[COVARIANCE, Y] += dy * dy * sed
        matrix[COVARIANCE, SIGMA_X] += dy * ay * sdw
        matrix[COVARIANCE, SIGMA_Y] += dy * wy * sed
        matrix[COVARIANCE, BACKGROUND] += dy * sd
        matrix[COVARIANCE, COVARIANCE] += dy * dy * sdd
    # Only the derivative with respect to the background does not vanish at the window's edge, where the grid
    # may extend beyond the window or end before it: scale its sum to the number of pixels.
    matrix[BACKGROUND, BACKGROUND] *= nx * ny / (rows * columns * step_x * step_y)
    for k in range(TILTED):
        for m in range(k + 1):
            matrix[k, m] *= step_x * step_y
            matrix[m, k] = matrix[k, m]
