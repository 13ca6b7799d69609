"""Steps from a converged fit to the reported spot: test for a second spot, flags, standard uncertainties."""

import math
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    DISPLACEMENT_X,
    DISPLACEMENT_Y,
    GATE,
    HAS_LAST_SPOT,
    PARAMETERS,
    POOR_FRAMES,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    SINGLE_ONLY,
    UPRIGHT,
    Image,
    Placement,
    SpotFit,
    SpotFlag,
    Workspace,
    X,
    Y,
    as_kind,
    chi2_limit,
    cholesky,
    inverse_diagonal,
    nothing_hidden,
    poor_fit_limit,
    remember,
)
from processing.spot.general_fit import fit_general, inverse_covariance, score_general, window_of
from processing.spot.obstacle import CUT, HIDDEN, MIN_OUTLIERS, fit_uncovered
from processing.spot.sensor_model import PixelNoise, background_variance

Result = tuple[float, float, float, float, float, float, float, float, float, float, int]
"""Fields of a `Spot` in order. It is a plain tuple because numba returns that faster than a NamedTuple."""
FLAGS: Final = -1
"""Index of the flags in a `Result`."""
MAX_REMAINING_EXCESS = 0.5
"""Largest fraction of the excess of chi2/dof over 1 that a better model than one Gaussian leaves."""
# numba does not support IntFlag
_SATURATED, _EDGE, _LOST, _LOW_SNR, _POOR_FIT, _OUTLIERS, _MULTIPLE, _, _CUT = (
    flag.value for flag in SpotFlag
)


@kernel
def without_spot(flags: int) -> Result:
    """Result with `flags`, and NaN for every other field."""
    nan = math.nan
    return nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, flags


@kernel
def _lost(memory: Floats) -> Result:
    """Result for a frame without a spot, after which the next frame is searched as a whole."""
    memory[HAS_LAST_SPOT] = 0.0
    memory[DISPLACEMENT_X] = 0.0
    memory[DISPLACEMENT_Y] = 0.0
    return without_spot(_LOST)


@kernel
def significant(p: Floats, noise: PixelNoise, fit: SpotFit) -> bool:
    """Whether the spot is significant against the background noise and does not consist of outliers.

    A matched filter detects a Gaussian spot of amplitude A on a background of standard deviation s with the
    signal-to-noise ratio A sqrt(pi sigma_x sigma_y)/s, which must exceed 4. (In the code both sides are
    multiplied by 2.)
    """
    floor = background_variance(p[BACKGROUND], noise)
    area = 4.0 * math.pi * p[SIGMA_X] * p[SIGMA_Y]
    return p[AMPLITUDE] * math.sqrt(area) > 8.0 * math.sqrt(floor) and fit.outliers < 0.3 * fit.pixels


@kernel
def finish(
    image: Image,
    placement: Placement,
    memory: Floats,
    work: Workspace,
    noise: PixelNoise,
    fit: SpotFit,
    followed: bool,
) -> Result:
    """Store the spot in `memory` and return its fields.

    After a search a second spot is fitted if the residuals indicate one. Later frames use the same number of
    spots: if it were chosen in every frame, it would change with the noise, and the position with it.
    """
    p = work.parameters
    limit = chi2_limit(fit.pixels) * max(fit.pixels - UPRIGHT, 1)
    if fit.chi2 > limit or fit.outliers >= MIN_OUTLIERS:
        state, fit = fit_uncovered(image, work, noise, fit)
        if state == HIDDEN:
            return _lost(memory)
        if state == CUT:
            remember(memory, placement, p, fit, followed)
            return _report(image, placement, work, noise, fit, _CUT)
    if not (followed or fit.has_second or memory[SINGLE_ONLY] > 0.0) and fit.chi2 > limit:
        fit = try_second(image, work, noise, fit)
        # the fit of two spots has overwritten the information matrix, which the uncertainties are taken from
        ny, nx = image.shape
        window = window_of(p, nx, ny, REACH)
        gate = GATE * max(1.0, fit.chi2 / max(fit.pixels - UPRIGHT, 1))
        score_general(
            image, window, p, fit.tilted, fit.has_second, noise, gate, nothing_hidden(), np.empty(PARAMETERS),
            work.information,
        )  # fmt: skip
        if not cholesky(work.information, PARAMETERS, work.factor):
            return _lost(memory)
        fit = as_kind(fit, PARAMETERS, fit.tilted, fit.has_second)
    elif fit.has_second and not p[SECOND_AMPLITUDE] > 0.003 * p[AMPLITUDE]:
        # the second spot has become negligible: fit a single spot from the next frame on
        fit = as_kind(fit, fit.size, fit.tilted, False)
    remember(memory, placement, p, fit, followed)
    result = _report(image, placement, work, noise, fit, 0)
    memory[POOR_FRAMES] = memory[POOR_FRAMES] + 1.0 if result[FLAGS] & _POOR_FIT else 0.0
    return result


@kernel
def _is_saturated(image: Image, p: Floats, noise: PixelNoise) -> bool:
    """Whether a pixel of the spot's window is at full scale in the image itself."""
    ny, nx = image.shape
    window = window_of(p, nx, ny, REACH)
    for j in range(window.y0, window.y1):
        for i in range(window.x0, window.x1):
            if image[j, i] >= noise.full_scale_dn:
                return True
    return False


@kernel
def _report(
    image: Image, placement: Placement, work: Workspace, noise: PixelNoise, fit: SpotFit, flags: int
) -> Result:
    """Fields of the `Spot`; `flags` are those that are already known."""
    p = work.parameters
    x = p[X] + placement.origin_x
    y = p[Y] + placement.origin_y
    free_parameters = UPRIGHT + (1 if fit.tilted else 0) + (3 if fit.has_second else 0)
    chi2_per_dof = fit.chi2 / max(fit.pixels - free_parameters, 1)
    # u^2 = (information^-1)_kk max(1, excess): noise beyond the model's enlarges the uncertainty, but a
    # chi-square that happens to be small does not reduce it
    excess = chi2_per_dof
    if chi2_per_dof > chi2_limit(fit.pixels):
        excess = min(excess, excess_noise(image, p, fit.has_second, noise, chi2_per_dof))
    inflate = math.sqrt(max(1.0, excess))
    u_x = inflate * math.sqrt(inverse_diagonal(work.factor, fit.size, X))
    u_y = inflate * math.sqrt(inverse_diagonal(work.factor, fit.size, Y))
    # the model of a beam that is not Gaussian may reach full scale where no pixel does
    if fit.saturated > 0 and _is_saturated(image, p, noise):
        flags |= _SATURATED
    if (
        x - 3.0 * p[SIGMA_X] < -0.5
        or y - 3.0 * p[SIGMA_Y] < -0.5
        or x + 3.0 * p[SIGMA_X] > placement.sensor_nx - 0.5
        or y + 3.0 * p[SIGMA_Y] > placement.sensor_ny - 0.5
    ):
        flags |= _EDGE
    if p[AMPLITUDE] < 5.0 * math.sqrt(background_variance(p[BACKGROUND], noise)):
        flags |= _LOW_SNR
    if chi2_per_dof > poor_fit_limit(fit.pixels):
        flags |= _POOR_FIT
    if fit.outliers > 0:
        flags |= _OUTLIERS
    if fit.has_second:
        flags |= _MULTIPLE
    sigma_1, sigma_2, rotation = p[SIGMA_X], p[SIGMA_Y], 0.0
    if fit.tilted:
        sigma_1, sigma_2, rotation = principal_axes(
            p[SIGMA_X] * p[SIGMA_X], p[SIGMA_Y] * p[SIGMA_Y], p[COVARIANCE]
        )
    return x, y, u_x, u_y, sigma_1, sigma_2, rotation, p[AMPLITUDE], p[BACKGROUND], chi2_per_dof, flags


@kernel
def principal_axes(xx: float, yy: float, xy: float) -> tuple[float, float, float]:
    """Standard deviations along the principal axes of a covariance matrix, and the first axis's angle, rad.

    The angle counts from x towards y. The first axis is the nearer one to x, so that axes are never swapped.
    """
    # eigenvalues of [[xx, xy], [xy, yy]]: mean +- sqrt(half^2 + xy^2)
    mean = 0.5 * (xx + yy)
    half = 0.5 * (xx - yy)
    root = math.hypot(half, xy)
    sign = 1.0 if half >= 0.0 else -1.0
    return (
        math.sqrt(max(mean + sign * root, 1e-12)),
        math.sqrt(max(mean - sign * root, 1e-12)),
        0.5 * math.atan2(sign * xy, sign * half),
    )


@kernel
def find_second(image: Image, p: Floats, noise: PixelNoise) -> bool:
    """Look for a second spot in the residuals of a fit; if there is one, write start values for it into `p`.

    Residuals are summed over blocks of about 0.7 sigma, which gather much of the light of a spot of the
    same size. With r the residuals and s^2 their variances from the noise model, a block's significance is

        sum r / sqrt(sum s^2),

    which must exceed 8, at a distance of more than 1.5 sigma from the centre: nearer to it, residuals come
    from the first spot's own deviation from a Gaussian. Pixels near full scale do not count.
    """
    ny, nx = image.shape
    window = window_of(p, nx, ny, REACH)
    floor = background_variance(p[BACKGROUND], noise)
    block = max(2, int(0.7 * min(p[SIGMA_X], p[SIGMA_Y])))
    pxx, pyy, pxy = inverse_covariance(p)
    best = 8.0
    has_second = False
    for block_y in range(window.y0, window.y1 - block + 1, block):
        for block_x in range(window.x0, window.x1 - block + 1, block):
            total = variance = 0.0
            for j in range(block_y, block_y + block):
                for i in range(block_x, block_x + block):
                    u = i - p[X]
                    v = j - p[Y]
                    light = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2 * pxy * u * v + pyy * v * v))
                    if p[BACKGROUND] + light < 0.9 * noise.full_scale_dn:
                        total += image[j, i] - p[BACKGROUND] - light
                        variance += floor + light * (noise.dn_per_e + light * noise.prnu2)
            u = block_x + 0.5 * block - 0.5 - p[X]
            v = block_y + 0.5 * block - 0.5 - p[Y]
            if variance > 0.0 and pxx * u * u + 2 * pxy * u * v + pyy * v * v > 2.25:
                significance = total / math.sqrt(variance)
                if significance > best:
                    best = significance
                    has_second = True
                    p[SECOND_AMPLITUDE] = max(total / (block * block), 1e-3)
                    p[SECOND_X] = block_x + 0.5 * block - 0.5
                    p[SECOND_Y] = block_y + 0.5 * block - 0.5
    return has_second


@kernel
def try_second(image: Image, work: Workspace, noise: PixelNoise, single: SpotFit) -> SpotFit:
    """Fit two spots jointly and return that fit if it is clearly better than `single`, else `single`.

    It is clearly better if at most `MAX_REMAINING_EXCESS` of the excess of chi-square per degree of freedom
    over 1 remains, and if two spots fit well: in any other beam their positions would depend on the noise.
    The second spot must be the fainter one, and the two must lie more than 1.2 sigma apart; otherwise
    both would describe the same light. `work.information` and `work.factor` are overwritten in any case.
    """
    p = work.parameters
    # fit a copy, so that the single spot's parameters remain if the second spot is rejected
    trial = p.copy()
    if not find_second(image, trial, noise):
        return single
    trial_work = Workspace(trial, work.information, work.factor)
    double = fit_general(image, trial_work, single.tilted, True, noise, REACH + 1.0, nothing_hidden())
    if not double.converged:
        return single
    excess = single.chi2 / (single.pixels - UPRIGHT) - 1.0
    distance = math.hypot(
        (trial[SECOND_X] - trial[X]) / trial[SIGMA_X], (trial[SECOND_Y] - trial[Y]) / trial[SIGMA_Y]
    )
    chi2_per_dof = double.chi2 / (double.pixels - UPRIGHT - 3)
    if (
        chi2_per_dof - 1.0 < MAX_REMAINING_EXCESS * excess
        and chi2_per_dof < chi2_limit(double.pixels)
        and 0.0 < trial[SECOND_AMPLITUDE] <= trial[AMPLITUDE]
        and distance > 1.2
    ):
        for k in range(len(p)):
            p[k] = trial[k]
        return double
    return single


@kernel
def excess_noise(image: Image, p: Floats, has_second: bool, noise: PixelNoise, chi2_per_dof: float) -> float:
    """Variance of the residuals' scatter from pixel to pixel, relative to that of the noise model.

    If the beam is not Gaussian, chi-square per degree of freedom is large because the residuals have a shape.
    The shape moves with the spot and does not scatter its position; only the noise does. Differences of four
    neighbours, across rows and columns, remove a smooth shape and leave the noise.
    """
    ny, nx = image.shape
    window = window_of(p, nx, ny, REACH)
    pxx, pyy, pxy = inverse_covariance(p)
    floor = background_variance(p[BACKGROUND], noise)
    gate = 4.0 * GATE * max(chi2_per_dof, 1.0)
    # residuals and variances of the row above, and those of the pixel to the left
    above = np.zeros((2, window.x1 - window.x0))
    total = expected = 0.0
    for j in range(window.y0, window.y1):
        left = left_variance = 0.0
        for i in range(window.x0, window.x1):
            k = i - window.x0
            u, v = i - p[X], j - p[Y]
            light = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v))
            if has_second:
                u, v = i - p[SECOND_X], j - p[SECOND_Y]
                light += p[SECOND_AMPLITUDE] * math.exp(
                    -0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v)
                )
            residual = image[j, i] - p[BACKGROUND] - light
            # the noise is that of the measured light, since the model of the light is wrong here
            measured_light = max(light + residual, 0.0)
            variance = floor + measured_light * (noise.dn_per_e + measured_light * noise.prnu2)
            if j > window.y0 and i > window.x0:
                difference = residual - left - above[0, k] + above[0, k - 1]
                variance_sum = variance + left_variance + above[1, k] + above[1, k - 1]
                saturated = image[j, i] + 3.0 * math.sqrt(variance) >= noise.full_scale_dn
                if difference * difference < gate * variance_sum and not saturated:
                    total += difference * difference
                    expected += variance_sum
            if i > window.x0:
                above[0, k - 1], above[1, k - 1] = left, left_variance
            left, left_variance = residual, variance
        above[0, window.x1 - window.x0 - 1], above[1, window.x1 - window.x0 - 1] = left, left_variance
    return total / expected if expected > 0.0 else chi2_per_dof
