"""Second spot (such as a reflection) that overlaps the first: found in the residuals, then fitted jointly."""

import math

from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    Fitted,
    Floats,
    Workspace,
    X,
    Y,
    misfit_limit,
)
from processing.spot.general_fit import fit_general, inverse_covariance, window_of
from processing.spot.sensor_model import PixelNoise, background_variance
from processing.spot.spot import Image

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
    if two spots fit well: a beam of any other form would get two places that depend on the noise.
    The second spot must be the fainter one, and the two must lie more than 1.2 sigma apart; otherwise
    both would describe the same light. `work.information` and `work.factor` are overwritten in any case.
    """
    p = work.parameters
    # fit a copy, so that the single spot's parameters remain if the second spot is rejected
    trial = p.copy()
    if not find_second(image, trial, noise):
        return one
    two = fit_general(
        image, Workspace(trial, work.information, work.factor), one.tilted, True, noise, REACH + 1.0
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
        and scatter < misfit_limit(two.pixels)
        and 0.0 < trial[SECOND_AMPLITUDE] <= trial[AMPLITUDE]
        and apart > 1.2
    ):
        for k in range(len(p)):
            p[k] = trial[k]
        return two
    return one
