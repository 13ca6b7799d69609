"""Maximum-likelihood fit of a beam's own profile: shift, amplitude and a background that is a plane.

The light of a pixel at distance (u, v) from the centre is A T(u, v), with T a cubic spline on a grid of one
pixel: the beam's image as the sensor integrates it. All pixels of a frame have the same phase on the grid, so
that T and its derivatives are sums of four values along x and along y, with weights that are common to all
pixels. With the derivatives d of A T + B + B_x i + B_y j by the six parameters, Fisher scoring is that of
`general_fit`.
"""

import math

import numpy as np

from processing.arrays import Floats, Singles
from processing.kernel import kernel
from processing.spot.fit_values import GATE, cholesky, inverse_diagonal, solve
from processing.spot.sensor_model import background_variance, pixel_noise_of

LIGHT, CENTRE_X, CENTRE_Y, LEVEL, SLOPE_X, SLOPE_Y = range(6)
"""Fitted parameters: amplitude in DN, centre in px from the window's first pixel, background in DN in the
window's middle and its slopes in DN/px."""
PROFILE_PARAMETERS = 6
MARGIN_PX = 4
"""Margin of the spline beyond the window of the fit: two pixels that cubic pieces need at each end, and two
by which the spot may be off the window's middle."""
_MAX_PASSES = 25
_MIN_PIXELS = 24  # four for each fitted parameter
_NO_GATE = 1e30


@kernel
def spline_weights(phase: float, weights: Singles, slopes: Singles) -> None:
    """Values and derivatives of the four cubic B-splines that are not zero at `phase` beyond a grid point."""
    t, s = phase, 1.0 - phase
    weights[0] = s * s * s / 6.0
    weights[1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
    weights[2] = (4.0 + s * s * (3.0 * s - 6.0)) / 6.0
    weights[3] = t * t * t / 6.0
    slopes[0] = -0.5 * s * s
    slopes[1] = 0.5 * t * (3.0 * t - 4.0)
    slopes[2] = -0.5 * s * (3.0 * s - 4.0)
    slopes[3] = 0.5 * t * t


@kernel(fastmath=True)
def score_profile(
    pixels: Singles,
    spline: Singles,
    base_x: int,
    base_y: int,
    weights: Singles,
    p: Floats,
    noise_values: Floats,
    gate: float,
    rows: Singles,
    gradient: Floats,
    matrix: Floats,
) -> tuple[float, float, float]:
    """Gradient and Fisher information of the log likelihood, summed over a window.

    Returns chi-square and number of the pixels used, and the number of those near full scale.

    Parameters
    ----------
    pixels : (ny, nx) the window, DN
    spline : coefficients of T; those from (base_x, base_y) on reach the window's first pixel
    weights : (4, 4) `spline_weights` along x, derivatives along x, along y, derivatives along y
    p : (PROFILE_PARAMETERS,)
    noise_values : fields of `PixelNoise`
    gate : limit of a pixel's squared residual, in variances. Pixels beyond it are left out, like those that
        the model expects within three standard deviations of full scale.
    rows : (2, nx + 3) working memory
    gradient, matrix : (PROFILE_PARAMETERS,), (PROFILE_PARAMETERS, PROFILE_PARAMETERS), overwritten
    """
    noise = pixel_noise_of(noise_values)
    ny, nx = pixels.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    amplitude = np.float32(p[LIGHT])
    slope = np.float32(p[SLOPE_X])
    dark = np.float32(background_variance(p[LEVEL], noise))
    shot, spread = np.float32(noise.dn_per_e), np.float32(noise.prnu2)
    full = np.float32(noise.full_scale_dn)
    three_squared = np.float32(9.0)
    limit = np.float32(gate)
    a0, a1, a2, a3 = weights[0, 0], weights[0, 1], weights[0, 2], weights[0, 3]
    d0, d1, d2, d3 = weights[1, 0], weights[1, 1], weights[1, 2], weights[1, 3]
    b0, b1, b2, b3 = weights[2, 0], weights[2, 1], weights[2, 2], weights[2, 3]
    e0, e1, e2, e3 = weights[3, 0], weights[3, 1], weights[3, 2], weights[3, 3]
    value, down = rows[0], rows[1]
    for k in range(PROFILE_PARAMETERS):
        gradient[k] = 0.0
        for m in range(PROFILE_PARAMETERS):
            matrix[k, m] = 0.0
    chi2 = kept = saturated = np.float64(0.0)
    middle = np.float32(0.5 * (nx - 1))
    for j in range(ny):
        first = spline[base_y + j, base_x : base_x + nx + 3]
        second = spline[base_y + j + 1, base_x : base_x + nx + 3]
        third = spline[base_y + j + 2, base_x : base_x + nx + 3]
        fourth = spline[base_y + j + 3, base_x : base_x + nx + 3]
        for i in range(nx + 3):
            value[i] = b0 * first[i] + b1 * second[i] + b2 * third[i] + b3 * fourth[i]
            down[i] = e0 * first[i] + e1 * second[i] + e2 * third[i] + e3 * fourth[i]
        row = pixels[j]
        v = j - 0.5 * (ny - 1)
        level = np.float32(p[LEVEL] + p[SLOPE_Y] * v)
        g0 = g1 = g2 = g3 = g4 = zero
        h00 = h01 = h02 = h03 = h04 = h11 = h12 = h13 = h14 = h22 = h23 = h24 = h33 = h34 = h44 = zero
        sc = so = ss = zero
        for i in range(nx):
            u = np.float32(i) - middle
            f = a0 * value[i] + a1 * value[i + 1] + a2 * value[i + 2] + a3 * value[i + 3]
            fx = -amplitude * (d0 * value[i] + d1 * value[i + 1] + d2 * value[i + 2] + d3 * value[i + 3])
            fy = -amplitude * (a0 * down[i] + a1 * down[i + 1] + a2 * down[i + 2] + a3 * down[i + 3])
            light = amplitude * f
            lit = light if light > zero else zero
            variance = dark + lit * (shot + lit * spread)
            mu = level + slope * u + light
            r = row[i] - mu
            room = full - mu
            below = one if room > zero and room * room > three_squared * variance else zero
            z = r * r / variance
            keep = below if z <= limit else zero
            w = keep / variance
            wr = w * r
            sc += z * keep
            so += keep
            ss += one - below
            wf, wx, wy, wu = w * f, w * fx, w * fy, w * u
            g0 += wr * f
            g1 += wr * fx
            g2 += wr * fy
            g3 += wr
            g4 += wr * u
            h00 += wf * f
            h01 += wf * fx
            h02 += wf * fy
            h03 += wf
            h04 += wf * u
            h11 += wx * fx
            h12 += wx * fy
            h13 += wx
            h14 += wx * u
            h22 += wy * fy
            h23 += wy
            h24 += wy * u
            h33 += w
            h34 += wu
            h44 += wu * u
        chi2 += sc
        kept += so
        saturated += ss
        gradient[0] += g0
        gradient[1] += g1
        gradient[2] += g2
        gradient[3] += g3
        gradient[4] += g4
        gradient[5] += v * g3
        matrix[0, 0] += h00
        matrix[1, 0] += h01
        matrix[2, 0] += h02
        matrix[3, 0] += h03
        matrix[4, 0] += h04
        matrix[5, 0] += v * h03
        matrix[1, 1] += h11
        matrix[2, 1] += h12
        matrix[3, 1] += h13
        matrix[4, 1] += h14
        matrix[5, 1] += v * h13
        matrix[2, 2] += h22
        matrix[3, 2] += h23
        matrix[4, 2] += h24
        matrix[5, 2] += v * h23
        matrix[3, 3] += h33
        matrix[4, 3] += h34
        matrix[5, 3] += v * h33
        matrix[4, 4] += h44
        matrix[5, 4] += v * h34
        matrix[5, 5] += v * v * h33
    return float(chi2), float(kept), float(saturated)


@kernel
def fit_profile(
    pixels: Singles, spline: Singles, centre: Floats, p: Floats, noise_values: Floats
) -> tuple[bool, float, float, float, float, float, float]:
    """Fisher scoring until convergence; `p` holds the start values and is updated in place.

    Parameters
    ----------
    pixels : (ny, nx) the window of the fit, DN
    spline : coefficients of T; it must reach MARGIN_PX beyond the window on all sides
    centre : (2,) coordinates (x, y) of the spot's centre in the spline's grid
    p : (PROFILE_PARAMETERS,)
    noise_values : fields of `PixelNoise`

    Returns
    -------
    converged, chi2, kept, saturated, outliers, u_x, u_y
        `converged` is False also if the spline ends within the window or too few pixels are left. u_x and u_y
        are the bounds of Cramer and Rao in px.
    """
    ny, nx = pixels.shape
    rows = np.empty((2, nx + 3), dtype=np.float32)
    weights = np.empty((4, 4), dtype=np.float32)
    gradient, step = np.zeros(PROFILE_PARAMETERS), np.zeros(PROFILE_PARAMETERS)
    matrix, factor = (
        np.zeros((PROFILE_PARAMETERS, PROFILE_PARAMETERS)),
        np.zeros((PROFILE_PARAMETERS, PROFILE_PARAMETERS)),
    )
    gate = _NO_GATE
    failed = (False, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan)
    for _ in range(_MAX_PASSES):
        start_x, start_y = centre[0] - p[CENTRE_X], centre[1] - p[CENTRE_Y]
        reach_y, reach_x = spline.shape
        # checked before the conversion to whole numbers, which NaN would break
        if not (1.0 <= start_x < reach_x - nx - 1 and 1.0 <= start_y < reach_y - ny - 1):
            return failed
        floor_x, floor_y = math.floor(start_x), math.floor(start_y)
        base_x, base_y = int(floor_x) - 1, int(floor_y) - 1
        spline_weights(start_x - floor_x, weights[0], weights[1])
        spline_weights(start_y - floor_y, weights[2], weights[3])
        chi2, kept, saturated = score_profile(
            pixels, spline, base_x, base_y, weights, p, noise_values, gate, rows, gradient, matrix
        )
        if kept < _MIN_PIXELS or not cholesky(matrix, PROFILE_PARAMETERS, factor):
            return failed
        solve(factor, PROFILE_PARAMETERS, gradient, step)
        u_x = math.sqrt(inverse_diagonal(factor, PROFILE_PARAMETERS, CENTRE_X))
        u_y = math.sqrt(inverse_diagonal(factor, PROFILE_PARAMETERS, CENTRE_Y))
        worst = max(abs(step[CENTRE_X]), abs(step[CENTRE_Y]), abs(step[LIGHT]) / (0.5 * p[LIGHT]))
        shrink = 1.0 if worst <= 1.0 else 1.0 / worst
        for k in range(PROFILE_PARAMETERS):
            p[k] += shrink * step[k]
        if not p[LIGHT] > 0.0:
            return failed
        scatter = max(1.0, chi2 / max(kept - PROFILE_PARAMETERS, 1.0))
        gate_is_final = gate <= 1.05 * GATE * scatter
        if worst < 0.5:
            gate = GATE * scatter
        tolerance = 0.01 * math.sqrt(scatter)
        if gate_is_final and abs(step[CENTRE_X]) < tolerance * u_x and abs(step[CENTRE_Y]) < tolerance * u_y:
            return True, chi2, kept, saturated, nx * ny - kept - saturated, u_x, u_y
    return failed
