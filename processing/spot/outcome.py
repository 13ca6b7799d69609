"""Steps from a converged fit to the reported spot: test for a second spot, flags, standard uncertainties."""

import math
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import (
    ALONE,
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    GATE,
    PARAMETERS,
    POOR_FRAMES,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    UPRIGHT,
    Fitted,
    Image,
    Place,
    SpotFlag,
    Workspace,
    X,
    Y,
    as_kind,
    chi2_limit,
    cholesky,
    forget,
    inverse_diagonal,
    nothing_hidden,
    poor_fit_limit,
    remember,
)
from processing.spot.general_fit import fit_general, inverse_covariance, score_general, window_of
from processing.spot.obstacle import CUT, FEWEST_OUTLIERS, HIDDEN, fit_uncovered
from processing.spot.sensor_model import PixelNoise, background_variance

Result = tuple[float, float, float, float, float, float, float, float, float, float, int]
"""Fields of a `Spot` in order. It is a plain tuple because numba returns that faster than a NamedTuple."""
FLAGS: Final = -1
"""Index of the flags in a `Result`."""

# numba does not support IntFlag
_SATURATED = SpotFlag.SATURATED.value
_EDGE = SpotFlag.EDGE.value
_LOST = SpotFlag.LOST.value
_LOW_SNR = SpotFlag.LOW_SNR.value
_POOR_FIT = SpotFlag.POOR_FIT.value
_OUTLIERS = SpotFlag.OUTLIERS.value
_MULTIPLE = SpotFlag.MULTIPLE.value
_CUT = SpotFlag.CUT.value


@kernel
def without_spot(flags: int) -> Result:
    """Result with `flags`, and NaN for every other field."""
    nan = math.nan
    return nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, flags


@kernel
def lost(memory: Floats) -> Result:
    """Result for a frame without a spot: NaN and the flag LOST; the next frame is searched as a whole."""
    forget(memory)
    return without_spot(_LOST)


@kernel
def significant(p: Floats, noise: PixelNoise, fitted: Fitted) -> bool:
    """Whether the spot is significant against the background noise and does not consist of outliers.

    A matched filter detects a Gaussian spot of amplitude A on a background of standard deviation s with the
    signal-to-noise ratio A sqrt(pi sigma_x sigma_y)/s, which must exceed 4. (In the code both sides are
    multiplied by 2.)
    """
    floor = background_variance(p[BACKGROUND], noise)
    area = 4.0 * math.pi * p[SIGMA_X] * p[SIGMA_Y]
    return p[AMPLITUDE] * math.sqrt(area) > 8.0 * math.sqrt(floor) and fitted.outliers < 0.3 * fitted.pixels


@kernel
def finish(
    image: Image,
    place: Place,
    memory: Floats,
    work: Workspace,
    noise: PixelNoise,
    fitted: Fitted,
    followed: bool,
) -> Result:
    """Store the spot in `memory` and return its fields.

    After a search a second spot is fitted if the residuals indicate one. Later frames use the same number of
    spots: if it were chosen in every frame, it would change with the noise, and the position with it.
    """
    p = work.parameters
    limit = chi2_limit(fitted.pixels) * max(fitted.pixels - UPRIGHT, 1)
    if fitted.chi2 > limit or fitted.outliers >= FEWEST_OUTLIERS:
        seen, fitted = fit_uncovered(image, work, noise, fitted)
        if seen == HIDDEN:
            return lost(memory)
        if seen == CUT:
            remember(memory, place, p, fitted, followed)
            return _report(image, place, work, noise, fitted, _CUT)
    if not (followed or fitted.two or memory[ALONE] > 0.0) and fitted.chi2 > limit:
        fitted = try_second(image, work, noise, fitted)
        # the fit of two spots has overwritten the information matrix, which the uncertainties are taken from
        _information(image, work, noise, fitted)
        if not cholesky(work.information, PARAMETERS, work.factor):
            return lost(memory)
        fitted = as_kind(fitted, PARAMETERS, fitted.tilted, fitted.two)
    elif fitted.two and not p[SECOND_AMPLITUDE] > 0.003 * p[AMPLITUDE]:
        # the second spot has become negligible: fit a single spot from the next frame on
        fitted = as_kind(fitted, fitted.size, fitted.tilted, False)
    remember(memory, place, p, fitted, followed)
    result = _report(image, place, work, noise, fitted, 0)
    memory[POOR_FRAMES] = memory[POOR_FRAMES] + 1.0 if result[FLAGS] & _POOR_FIT else 0.0
    return result


@kernel
def _information(image: Image, work: Workspace, noise: PixelNoise, fitted: Fitted) -> None:
    """Fisher information at the final parameters, written into `work.information`."""
    ny, nx = image.shape
    p = work.parameters
    gate = GATE * max(1.0, fitted.chi2 / max(fitted.pixels - UPRIGHT, 1))
    score_general(
        image,
        window_of(p, nx, ny, REACH),
        p,
        fitted.tilted,
        fitted.two,
        noise,
        gate,
        nothing_hidden(),
        np.empty(PARAMETERS),
        work.information,
    )


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
    image: Image, place: Place, work: Workspace, noise: PixelNoise, fitted: Fitted, flags: int
) -> Result:
    """Fields of the `Spot`: position on the sensor, uncertainties, principal axes; flags added to `flags`."""
    p = work.parameters
    x = p[X] + place.origin_x
    y = p[Y] + place.origin_y
    unknowns = UPRIGHT + (1 if fitted.tilted else 0) + (3 if fitted.two else 0)
    chi2_per_dof = fitted.chi2 / max(fitted.pixels - unknowns, 1)
    # u^2 = (information^-1)_kk max(1, excess): noise beyond the model's enlarges the uncertainty, but a
    # chi-square that happens to be small does not reduce it
    excess = chi2_per_dof
    if chi2_per_dof > chi2_limit(fitted.pixels):
        excess = min(excess, excess_noise(image, p, fitted.two, noise, chi2_per_dof))
    inflate = math.sqrt(max(1.0, excess))
    u_x = inflate * math.sqrt(inverse_diagonal(work.factor, fitted.size, X))
    u_y = inflate * math.sqrt(inverse_diagonal(work.factor, fitted.size, Y))
    # the model of a beam that is not Gaussian may reach full scale where no pixel does
    if fitted.saturated > 0 and _is_saturated(image, p, noise):
        flags |= _SATURATED
    if (
        x - 3.0 * p[SIGMA_X] < -0.5
        or y - 3.0 * p[SIGMA_Y] < -0.5
        or x + 3.0 * p[SIGMA_X] > place.sensor_nx - 0.5
        or y + 3.0 * p[SIGMA_Y] > place.sensor_ny - 0.5
    ):
        flags |= _EDGE
    if p[AMPLITUDE] < 5.0 * math.sqrt(background_variance(p[BACKGROUND], noise)):
        flags |= _LOW_SNR
    if chi2_per_dof > poor_fit_limit(fitted.pixels):
        flags |= _POOR_FIT
    if fitted.outliers > 0:
        flags |= _OUTLIERS
    if fitted.two:
        flags |= _MULTIPLE
    sigma_1, sigma_2, rotation = p[SIGMA_X], p[SIGMA_Y], 0.0
    if fitted.tilted:
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


_ONE, _TWO = 6, 9
"""Number of unknowns of one upright spot, and of two of the same shape."""


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
    found = False
    for by in range(window.y0, window.y1 - block + 1, block):
        for bx in range(window.x0, window.x1 - block + 1, block):
            total = 0.0
            variance = 0.0
            for j in range(by, by + block):
                for i in range(bx, bx + block):
                    u = i - p[X]
                    v = j - p[Y]
                    f = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2 * pxy * u * v + pyy * v * v))
                    if p[BACKGROUND] + f < 0.9 * noise.full_scale_dn:
                        total += image[j, i] - p[BACKGROUND] - f
                        variance += floor + f * (noise.dn_per_e + f * noise.prnu2)
            u = bx + 0.5 * block - 0.5 - p[X]
            v = by + 0.5 * block - 0.5 - p[Y]
            if variance > 0.0 and pxx * u * u + 2 * pxy * u * v + pyy * v * v > 2.25:
                significance = total / math.sqrt(variance)
                if significance > best:
                    best = significance
                    found = True
                    p[SECOND_AMPLITUDE] = max(total / (block * block), 1e-3)
                    p[SECOND_X] = bx + 0.5 * block - 0.5
                    p[SECOND_Y] = by + 0.5 * block - 0.5
    return found


@kernel
def try_second(image: Image, work: Workspace, noise: PixelNoise, one: Fitted) -> Fitted:
    """Fit two spots jointly and return that fit if it is clearly better; otherwise return `one` unchanged.

    It is clearly better if the excess of chi-square per degree of freedom over 1 falls by at least half, and
    if two spots fit well: in a beam of any other form their positions would depend on the noise.
    The second spot must be the fainter one, and the two must lie more than 1.2 sigma apart; otherwise
    both would describe the same light. `work.information` and `work.factor` are overwritten in any case.
    """
    p = work.parameters
    # fit a copy, so that the single spot's parameters remain if the second spot is rejected
    trial = p.copy()
    if not find_second(image, trial, noise):
        return one
    two = fit_general(
        image,
        Workspace(trial, work.information, work.factor),
        one.tilted,
        True,
        noise,
        REACH + 1.0,
        nothing_hidden(),
    )
    if not two.done:
        return one
    excess = one.chi2 / (one.pixels - _ONE) - 1.0
    apart = math.hypot(
        (trial[SECOND_X] - trial[X]) / trial[SIGMA_X], (trial[SECOND_Y] - trial[Y]) / trial[SIGMA_Y]
    )
    scatter = two.chi2 / (two.pixels - _TWO)
    if (
        scatter - 1.0 < 0.5 * excess
        and scatter < chi2_limit(two.pixels)
        and 0.0 < trial[SECOND_AMPLITUDE] <= trial[AMPLITUDE]
        and apart > 1.2
    ):
        for k in range(len(p)):
            p[k] = trial[k]
        return two
    return one


@kernel
def excess_noise(image: Image, p: Floats, two: bool, noise: PixelNoise, chi2_per_dof: float) -> float:
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
    before = np.zeros((2, window.x1 - window.x0))
    total = expected = 0.0
    for j in range(window.y0, window.y1):
        last = last_variance = 0.0
        for i in range(window.x0, window.x1):
            k = i - window.x0
            u, v = i - p[X], j - p[Y]
            light = p[AMPLITUDE] * math.exp(-0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v))
            if two:
                u, v = i - p[SECOND_X], j - p[SECOND_Y]
                light += p[SECOND_AMPLITUDE] * math.exp(
                    -0.5 * (pxx * u * u + 2.0 * pxy * u * v + pyy * v * v)
                )
            left = image[j, i] - p[BACKGROUND] - light
            # the noise is that of the measured light, since the model of the light is wrong here
            lit = max(light + left, 0.0)
            variance = floor + lit * (noise.dn_per_e + lit * noise.prnu2)
            if j > window.y0 and i > window.x0:
                difference = left - last - before[0, k] + before[0, k - 1]
                four = variance + last_variance + before[1, k] + before[1, k - 1]
                saturated = image[j, i] + 3.0 * math.sqrt(variance) >= noise.full_scale_dn
                if difference * difference < gate * four and not saturated:
                    total += difference * difference
                    expected += four
            if i > window.x0:
                before[0, k - 1], before[1, k - 1] = last, last_variance
            last, last_variance = left, variance
        before[0, window.x1 - window.x0 - 1], before[1, window.x1 - window.x0 - 1] = last, last_variance
    return total / expected if expected > 0.0 else chi2_per_dof
