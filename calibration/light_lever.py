"""Light lever: conversion of the spot's position on the sensor into the pendulum's tilt.

Only this module uses the mirror's factor of 2, the arm and the pixel pitch.
"""

import math
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field

from processing.arrays import Floats
from processing.deflections import DeflectionUnit


class Lever(BaseModel, frozen=True, extra="forbid"):
    """Geometry of the light lever.

    A tilt phi of the mirror turns the beam by 2 phi: the spot moves by ``arm (t + skew t^2)`` with
    ``t = tan(2 phi)``. The skew is 0 if the sensor is perpendicular to the beam, otherwise about the tangent
    of the sensor's tilt. The arm of a calibrated lever is the effective one: it includes all effects that
    are a constant factor. Standard uncertainties `u_` have the unit of their value; 0 means not stated. Those
    of a calibrated arm or pitch have degrees of freedom if they follow from the scatter of the steps.
    """

    arm_m: float = Field(gt=0, lt=100, description="mirror to sensor, along the beam")
    u_arm_m: float = Field(default=0.0, ge=0)
    arm_dof: float | None = Field(
        default=None, gt=2, description="degrees of freedom of u_arm_m; None: it is known"
    )
    pixel_pitch_m: float = Field(gt=0, lt=1e-3, description="distance of neighbouring pixels")
    u_pixel_pitch_m: float = Field(default=0.0, ge=0)
    pixel_pitch_dof: float | None = Field(default=None, gt=2)
    skew: float = Field(
        default=0.0,
        gt=-10,
        lt=10,
        description="of the slow axis, from a sensor not perpendicular to the beam",
    )
    u_skew: float = Field(default=0.0, ge=0)
    reference_x_px: float | None = Field(
        default=None, description="spot at zero tilt; None: the sensor's middle"
    )
    reference_y_px: float | None = None
    binning: int = Field(
        default=1, ge=1, le=32, description="of the camera, with which pitch and reference hold"
    )

    def at_binning(self, binning: int) -> Self:
        """The same lever seen with another binning: the pitch is that of the pixels of the image."""
        times = binning / self.binning
        if times == 1.0:
            return self
        x_px, y_px = (
            None if at is None else (at + 0.5) / times - 0.5
            for at in (self.reference_x_px, self.reference_y_px)
        )
        return self.model_copy(
            update={
                "binning": binning,
                "pixel_pitch_m": self.pixel_pitch_m * times,
                "u_pixel_pitch_m": self.u_pixel_pitch_m * times,
                "reference_x_px": x_px,
                "reference_y_px": y_px,
            }
        )

    def tilt_rad(self, displacement_px: ArrayLike) -> Floats:
        """Tilt for a displacement of the spot from the reference, exact (arc tangent), of any shape; NaN
        stays NaN.
        """
        return 0.5 * np.arctan(self._tangent(displacement_px)[0])

    def displacement_px(self, tilt_rad: ArrayLike) -> Floats:
        """Displacement of the spot from the reference for a tilt, of any shape: the inverse of `tilt_rad`."""
        tangent = np.tan(2.0 * np.asarray(tilt_rad, dtype=float))
        return tangent * (1.0 + self.skew * tangent) * (self.arm_m / self.pixel_pitch_m)

    def rad_per_px(self, displacement_px: ArrayLike = 0.0) -> Floats:
        """Derivative of the tilt with respect to the displacement, at displacements of any shape."""
        tangent, root = self._tangent(displacement_px)
        return 0.5 * (self.pixel_pitch_m / self.arm_m) / root / (1.0 + tangent**2)

    def square(self) -> Self:
        """The same lever without skew, for the fast axis, which is across the tilt of the sensor."""
        return self.model_copy(update={"skew": 0.0}) if self.skew else self

    def _tangent(self, displacement_px: ArrayLike) -> tuple[Floats, Floats]:
        """t = tan(2 phi), and the derivative of the displacement by t divided by that at the reference."""
        part = np.asarray(displacement_px, dtype=float) * (self.pixel_pitch_m / self.arm_m)
        root = np.sqrt(1.0 + 4.0 * self.skew * part)
        # this form of the quadratic's root loses no digits, and is exactly `part` without skew
        return 2.0 * part / (1.0 + root), root

    @property
    def u_scale_relative(self) -> float:
        """Relative standard uncertainty of the scale, rad per px, from arm and pitch."""
        return math.hypot(self.u_arm_m / self.arm_m, self.u_pixel_pitch_m / self.pixel_pitch_m)


def deflection_unit(lever: Lever | None) -> DeflectionUnit:
    """The unit of deflections: rad, or px without a lever. No other place decides it."""
    return DeflectionUnit.PX if lever is None else DeflectionUnit.RAD
