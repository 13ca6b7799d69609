"""Directions of the pendulum's two modes on the sensor."""

import math

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field

from calibration.light_lever import Lever
from processing.arrays import Floats


class Axes(BaseModel, frozen=True, extra="forbid"):
    """Directions of the pendulum's slow and fast mode on the sensor.

    Tilts are shown with Y (slow mode) up and X (fast mode) to the right; the sensor's y points down.
    `slow_angle_rad` is the angle of the slow mode's direction from the sensor's upward vertical, positive
    towards the sensor's +x. The fast mode's direction is at that angle plus a right angle plus
    `non_orthogonality_rad`; if `mirrored` (the camera sees the pendulum in a mirror), it has the opposite
    sign. `u_` marks standard uncertainties; 0 means not stated.
    """

    slow_angle_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)
    u_slow_angle_rad: float = Field(default=0.0, ge=0)
    non_orthogonality_rad: float = Field(default=0.0, gt=-0.5, lt=0.5)
    u_non_orthogonality_rad: float = Field(default=0.0, ge=0)
    mirrored: bool = False

    def directions(self) -> Floats:
        """Matrix (2, 2) whose columns are the unit vectors (x, y) of the fast and the slow mode on the
        sensor.
        """
        slow = self.slow_angle_rad
        fast = slow + 0.5 * math.pi + self.non_orthogonality_rad
        sign = -1.0 if self.mirrored else 1.0
        return np.array(
            [[sign * math.sin(fast), math.sin(slow)], [-sign * math.cos(fast), -math.cos(slow)]],
        )


def displacements(
    axes: Axes,
    x_px: ArrayLike,
    y_px: ArrayLike,
    u_x_px: ArrayLike,
    u_y_px: ArrayLike,
    reference_px: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Displacements of the spot along the fast and the slow mode in px, with their standard uncertainties.

    Parameters are those of `deflections`, for which this needs no lever.
    """
    inverse = np.linalg.inv(axes.directions())
    dx_px = np.asarray(x_px, dtype=float) - reference_px[0]
    dy_px = np.asarray(y_px, dtype=float) - reference_px[1]
    return (
        inverse[0, 0] * dx_px + inverse[0, 1] * dy_px,
        inverse[1, 0] * dx_px + inverse[1, 1] * dy_px,
        np.hypot(inverse[0, 0] * np.asarray(u_x_px), inverse[0, 1] * np.asarray(u_y_px)),
        np.hypot(inverse[1, 0] * np.asarray(u_x_px), inverse[1, 1] * np.asarray(u_y_px)),
    )


def deflections(
    lever: Lever,
    axes: Axes,
    x_px: ArrayLike,
    y_px: ArrayLike,
    u_x_px: ArrayLike,
    u_y_px: ArrayLike,
    reference_px: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Tilts of the pendulum along its own axes, from positions of the spot.

    Parameters
    ----------
    lever, axes
        Calibration.
    x_px, y_px, u_x_px, u_y_px
        Positions of the spot on the sensor and their standard uncertainties in px, scalars or arrays of one
        shape; NaN for a lost spot.
    reference_px
        Position (x, y) of the spot at zero tilt.

    Returns
    -------
    x_rad, y_rad, u_x_rad, u_y_rad
        Tilts of the fast and the slow mode and their standard uncertainties, of the shape of `x_px`; NaN
        where the spot is NaN. The uncertainties are those of the spot alone: the uncertainty of the lever's
        scale is common to all tilts and is a part of the fit's uncertainty budget.
    """
    fast_px, slow_px, u_fast_px, u_slow_px = displacements(axes, x_px, y_px, u_x_px, u_y_px, reference_px)
    return (
        lever.square().tilt_rad(fast_px),
        lever.tilt_rad(slow_px),
        u_fast_px * lever.square().rad_per_px(fast_px),
        u_slow_px * lever.rad_per_px(slow_px),
    )
