"""Noise beyond the model's, told from a beam's own shape."""

import math

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    GATE,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    X,
    Y,
)
from processing.spot.general_fit import inverse_covariance, window_of
from processing.spot.sensor_model import PixelNoise, background_variance
from processing.spot.spot import Image


@kernel
def excess_noise(image: Image, p: Floats, two: bool, noise: PixelNoise, chi2_per_dof: float) -> float:
    """Variance of the residuals from pixel to pixel, over that of the noise model.

    Of a beam that is no Gaussian, chi-square per degree of freedom is large because the residuals have a
    shape. It moves with the spot and does not scatter the place: what scatters it is the noise. Differences
    of four neighbours, across rows and columns, take a smooth shape out and leave the noise.
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
            # the noise is that of the light there is, which here is not what the model expects
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
