"""A second spot that overlaps: seen in the residuals, then fitted together with the first."""

import math

from numba import njit

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
)
from processing.spot.general_fit import fit_general, inverse_covariance, window_of
from processing.spot.sensor_model import PixelNoise, background_variance
from processing.spot.spot import Image

_ONE, _TWO = 6, 9
"""Unknowns with one upright spot, and with a second one of the same shape."""


@njit(cache=True, nogil=True, error_model="numpy")
def find_second(image: Image, p: Floats, noise: PixelNoise) -> bool:
    """Where the residuals of a fit show a second spot, put a start for it into `p`.

    Residuals are averaged over blocks of about one sigma, which gathers most of the light of a spot of
    the same size; one must stand out by eight standard deviations, 1.5 sigma or further from the centre,
    where residuals are not the first spot's own misfit.
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


@njit(cache=True, nogil=True, error_model="numpy")
def try_second(image: Image, work: Workspace, noise: PixelNoise, one: Fitted) -> Fitted:
    """Joint fit of two spots, where it removes at least half of what one spot leaves; else `one` again.

    What is left is the excess of chi-square per degree of freedom over 1. The second spot must be the
    fainter one and lie more than 1.2 sigma away, or both would describe the same light.
    """
    p = work.parameters
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
    if (
        two.chi2 / (two.pixels - _TWO) - 1.0 < 0.5 * excess
        and 0.0 < trial[SECOND_AMPLITUDE] <= trial[AMPLITUDE]
        and apart > 1.2
    ):
        p[:] = trial
        return two
    return one
