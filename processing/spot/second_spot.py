"""A second spot that overlaps: seen in the residuals, then fitted together with the first."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.spot.general_fit import background_variance, fit_general, window_of
from processing.spot.spot import Image

Floats = NDArray[np.float64]

REACH = 4.5


@njit(cache=True, nogil=True, error_model="numpy")
def find_second(
    image: Image, p: Floats, floor: float, inverse_gain: float, uneven: float, full_scale: float
) -> bool:
    """Where the residuals of a fit hold a second spot, put a start for it into `p`.

    Residuals are averaged over blocks of about one sigma; one must stand out by eight standard
    deviations.
    """
    ny, nx = image.shape
    x0, y0, x1, y1 = window_of(p, nx, ny, REACH)
    block = max(2, int(0.7 * min(p[3], p[4])))
    det = p[3] * p[3] * p[4] * p[4] - p[6] * p[6]
    pxx, pyy, pxy = p[4] * p[4] / det, p[3] * p[3] / det, -p[6] / det
    best = 8.0
    found = False
    for by in range(y0, y1 - block + 1, block):
        for bx in range(x0, x1 - block + 1, block):
            total = 0.0
            variance = 0.0
            for j in range(by, by + block):
                for i in range(bx, bx + block):
                    u = i - p[1]
                    v = j - p[2]
                    f = p[0] * math.exp(-0.5 * (pxx * u * u + 2 * pxy * u * v + pyy * v * v))
                    if p[5] + f < 0.9 * full_scale:
                        total += image[j, i] - p[5] - f
                        variance += floor + f * (inverse_gain + f * uneven)
            u = bx + 0.5 * block - 0.5 - p[1]
            v = by + 0.5 * block - 0.5 - p[2]
            if variance > 0.0 and pxx * u * u + 2 * pxy * u * v + pyy * v * v > 2.25:
                significance = total / math.sqrt(variance)
                if significance > best:
                    best = significance
                    found = True
                    p[7] = max(total / (block * block), 1e-3)
                    p[8] = bx + 0.5 * block - 0.5
                    p[9] = by + 0.5 * block - 0.5
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def try_second(
    image: Image,
    state: Floats,
    work: Floats,
    tilted: bool,
    chi2: float,
    pixels: int,
    saturated: int,
    outliers: int,
) -> tuple[bool, float, int, int, int]:
    """Joint fit of two spots; taken where it explains at least half of what one spot leaves over."""
    p = work[0]
    trial = p.copy()
    floor = background_variance(p, state[16], state[17])
    if not find_second(image, trial, floor, state[17], state[20], state[18]):
        return False, chi2, pixels, saturated, outliers
    ok, chi2_two, pixels_two, saturated_two, outliers_two = fit_general(
        image,
        trial,
        tilted,
        True,
        state[16],
        state[17],
        state[20],
        state[18],
        REACH + 1.0,
        work[1:11],
        work[11:21],
    )
    if not ok:
        return False, chi2, pixels, saturated, outliers
    excess = chi2 / (pixels - 6) - 1.0
    apart = math.hypot((trial[8] - trial[1]) / trial[3], (trial[9] - trial[2]) / trial[4])
    if chi2_two / (pixels_two - 9) - 1.0 < 0.5 * excess and 0.0 < trial[7] <= trial[0] and apart > 1.2:
        p[:] = trial
        return True, chi2_two, pixels_two, saturated_two, outliers_two
    return False, chi2, pixels, saturated, outliers
