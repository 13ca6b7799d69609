"""Tracking of a beam from frame to frame by its learned profile."""

import math

import numpy as np

from processing.arrays import Floats
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    DISPLACEMENT_X,
    DISPLACEMENT_Y,
    HAS_LAST_SPOT,
    HAS_SECOND,
    IS_TILTED,
    LAST,
    POOR_FRAMES,
    SIGMA_X,
    SIGMA_Y,
    Image,
    Placement,
    Spot,
    SpotFlag,
    X,
    Y,
    poor_fit_limit,
)
from processing.spot.hot_pixels import HotPixels
from processing.spot.outcome import principal_axes
from processing.spot.profile import BeamProfile, ProfileFit, dark_variance, fit_at
from processing.spot.profile_fit import CENTRE_X, CENTRE_Y, LEVEL, LIGHT, PROFILE_PARAMETERS, SLOPE_X, SLOPE_Y
from processing.spot.sensor_model import PixelNoise

_MAX_RATIO = 2.0
"""Largest factor by which the amplitude changes from frame to frame; beyond it the fit is not of the spot."""


class ProfileFollower:
    """Fit of a profile to each frame, started where the tracker's memory expects the spot."""

    def __init__(self, profile: BeamProfile, noise: PixelNoise, hot: HotPixels | None = None) -> None:
        self._profile = profile
        self._noise = noise
        self._hot = hot
        self._noise_values = np.array(noise)
        self._slopes = (0.0, 0.0)
        shape = profile.shape
        self._sigma_x, self._sigma_y = math.sqrt(shape.xx), math.sqrt(shape.yy)
        self._axes = principal_axes(shape.xx, shape.yy, shape.xy)

    def follow(
        self, image: Image, placement: Placement, memory: Floats, *, has_this_spot: bool = False
    ) -> Spot | None:
        """Spot of one frame, stored in `memory` too; None if it is not at the expected position.

        With `has_this_spot` the memory holds the spot of this very frame, fitted by a Gaussian.
        """
        start = np.zeros(PROFILE_PARAMETERS)
        start[LIGHT], start[LEVEL] = memory[LAST + AMPLITUDE], memory[LAST + BACKGROUND]
        start[CENTRE_X], start[CENTRE_Y] = memory[LAST + X], memory[LAST + Y]
        if not has_this_spot:
            start[CENTRE_X] += memory[DISPLACEMENT_X]
            start[CENTRE_Y] += memory[DISPLACEMENT_Y]
            start[SLOPE_X], start[SLOPE_Y] = self._slopes
        origin_px = placement.origin_x, placement.origin_y
        fit = fit_at(self._profile, image, origin_px, start, self._noise_values, self._hot)
        if fit is None or not 1.0 / _MAX_RATIO < fit.p[LIGHT] / memory[LAST + AMPLITUDE] < _MAX_RATIO:
            return None
        spot = self._report(fit, placement)
        self._slopes = fit.p[SLOPE_X], fit.p[SLOPE_Y]
        if not has_this_spot:
            memory[DISPLACEMENT_X] = spot.x_px - memory[LAST + X]
            memory[DISPLACEMENT_Y] = spot.y_px - memory[LAST + Y]
        memory[HAS_LAST_SPOT] = 1.0
        memory[LAST + X], memory[LAST + Y] = spot.x_px, spot.y_px
        memory[LAST + AMPLITUDE], memory[LAST + BACKGROUND] = fit.p[LIGHT], fit.p[LEVEL]
        memory[LAST + SIGMA_X], memory[LAST + SIGMA_Y] = self._sigma_x, self._sigma_y
        memory[LAST + COVARIANCE] = self._profile.shape.xy
        memory[IS_TILTED] = 1.0 if self._axes[2] else 0.0
        memory[HAS_SECOND] = 0.0
        memory[POOR_FRAMES] = memory[POOR_FRAMES] + 1.0 if spot.flags & SpotFlag.POOR_FIT else 0.0
        return spot

    def _report(self, fit: ProfileFit, placement: Placement) -> Spot:
        """Fields of the spot; uncertainties and flags by the same rules as those of a Gaussian."""
        x, y = float(fit.p[CENTRE_X]), float(fit.p[CENTRE_Y])
        flags = SpotFlag.LEARNED
        if fit.saturated > 0:
            flags |= SpotFlag.SATURATED
        reach_x, reach_y = 3.0 * self._sigma_x, 3.0 * self._sigma_y
        if (
            min(x - reach_x, y - reach_y) < -0.5
            or x + reach_x > placement.sensor_nx - 0.5
            or y + reach_y > placement.sensor_ny - 0.5
        ):
            flags |= SpotFlag.EDGE
        if fit.p[LIGHT] < 5.0 * math.sqrt(dark_variance(float(fit.p[LEVEL]), self._noise)):
            flags |= SpotFlag.LOW_SNR
        if fit.chi2_per_dof > poor_fit_limit(fit.used_pixels):
            flags |= SpotFlag.POOR_FIT
        if fit.outliers > 0:
            flags |= SpotFlag.OUTLIERS
        u_inflation = math.sqrt(max(1.0, fit.chi2_per_dof))
        u_x, u_y = u_inflation * fit.u_x_px, u_inflation * fit.u_y_px
        light, level = float(fit.p[LIGHT]), float(fit.p[LEVEL])
        return Spot(x, y, u_x, u_y, *self._axes, light, level, fit.chi2_per_dof, int(flags))
