"""Light lever: conversion of the spot's position on the sensor into the pendulum's tilt.

Only this module uses the mirror's factor of 2, the arm and the pixel pitch.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field

from processing.arrays import Floats
from processing.deflections import DeflectionUnit
from processing.errors import DataError


class Lever(BaseModel, frozen=True, extra="forbid"):
    """Geometry of the light lever.

    A tilt phi of the mirror turns the beam by 2 phi: the spot moves by ``arm (t + skew t^2)`` with
    ``t = tan(2 phi)``. The skew is 0 if the sensor is perpendicular to the beam, otherwise about the tangent
    of the sensor's tilt. The arm of a calibrated lever is the effective one: it includes all effects that
    are a constant factor. Standard uncertainties `u_` have the unit of their value; 0 means not stated. The
    uncertainty of a calibrated arm or pitch has degrees of freedom if it was derived from scatter.
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

    def with_binning(self, binning: int) -> Self:
        """The same lever for another binning, with pitch and reference in pixels of that image."""
        factor = binning / self.binning
        if factor == 1.0:
            return self
        x_px, y_px = (
            None if reference_px is None else (reference_px + 0.5) / factor - 0.5
            for reference_px in (self.reference_x_px, self.reference_y_px)
        )
        return self.model_copy(
            update={
                "binning": binning,
                "pixel_pitch_m": self.pixel_pitch_m * factor,
                "u_pixel_pitch_m": self.u_pixel_pitch_m * factor,
                "reference_x_px": x_px,
                "reference_y_px": y_px,
            }
        )

    def tilt_rad(self, displacement_px: ArrayLike) -> Floats:
        """Exact tilt (arc tangent) for displacements of the spot from its reference; any shape, NaN stays."""
        return 0.5 * np.arctan(self._tangent(displacement_px)[0])

    def displacement_px(self, tilt_rad: ArrayLike) -> Floats:
        """Displacement of the spot from the reference for a tilt, of any shape: the inverse of `tilt_rad`."""
        tangent = np.tan(2.0 * np.asarray(tilt_rad, dtype=float))
        return tangent * (1.0 + self.skew * tangent) * (self.arm_m / self.pixel_pitch_m)

    def rad_per_px(self, displacement_px: ArrayLike = 0.0) -> Floats:
        """Derivative of the tilt with respect to the displacement, at displacements of any shape."""
        tangent, root = self._tangent(displacement_px)
        return 0.5 * (self.pixel_pitch_m / self.arm_m) / root / (1.0 + tangent**2)

    def _tangent(self, displacement_px: ArrayLike) -> tuple[Floats, Floats]:
        """t = tan(2 phi), and the displacement's derivative with respect to t over that at the reference."""
        linear = np.asarray(displacement_px, dtype=float) * (self.pixel_pitch_m / self.arm_m)
        root = np.sqrt(1.0 + 4.0 * self.skew * linear)
        # this form of the root of the quadratic loses no digits, and is exactly `linear` without skew
        return 2.0 * linear / (1.0 + root), root

    @property
    def u_scale_relative(self) -> float:
        """Relative standard uncertainty of the scale, rad per px, from arm and pitch."""
        return math.hypot(self.u_arm_m / self.arm_m, self.u_pixel_pitch_m / self.pixel_pitch_m)


def deflection_unit(lever: Lever | None) -> DeflectionUnit:
    """The unit of deflections: rad, or px without a lever."""
    return DeflectionUnit.PX if lever is None else DeflectionUnit.RAD


_EVALUATION_TILT_RAD = 7e-4
"""Tilt at which scale and skew are evaluated, about 150 arcsec."""


class LeverGeometry(BaseModel, frozen=True, extra="forbid"):
    """Measured lengths and angles of the light lever. `u_` are standard uncertainties.

    "Along" means in the plane in which the slow mode moves the beam, "across" perpendicular to it. Angles of
    incidence are measured from the mirror's normal, the sensor's tilts from the plane perpendicular to the
    beam. The ball of `ball_radius_m` rolls on its flat. The beam hits the mirror `beam_height_m` above the
    ball's centre and the horizontal distance `beam_reach_m` in front of it.
    """

    arm_m: float = Field(gt=0, lt=100, description="mirror to sensor, along the beam at rest")
    u_arm_m: float = Field(default=0.0, ge=0)
    pixel_pitch_m: float = Field(gt=0, lt=1e-3)
    u_pixel_pitch_m: float = Field(default=0.0, ge=0)
    incidence_along_rad: float = Field(default=0.0, gt=-1.4, lt=1.4)
    u_incidence_along_rad: float = Field(default=0.0, ge=0)
    incidence_across_rad: float = Field(default=0.0, gt=-1.4, lt=1.4)
    u_incidence_across_rad: float = Field(default=0.0, ge=0)
    sensor_tilt_along_rad: float = Field(default=0.0, gt=-1.4, lt=1.4)
    u_sensor_tilt_along_rad: float = Field(default=0.0, ge=0)
    sensor_tilt_across_rad: float = Field(default=0.0, gt=-1.4, lt=1.4)
    u_sensor_tilt_across_rad: float = Field(default=0.0, ge=0)
    ball_radius_m: float = Field(default=0.0, ge=0, lt=1)
    u_ball_radius_m: float = Field(default=0.0, ge=0)
    beam_height_m: float = Field(default=0.0, gt=-10, lt=10)
    u_beam_height_m: float = Field(default=0.0, ge=0)
    beam_reach_m: float = Field(default=0.0, gt=-10, lt=10)
    u_beam_reach_m: float = Field(default=0.0, ge=0)


@dataclass(frozen=True, slots=True)
class GeometryLine:
    """One input of the uncertainty budget."""

    name: str
    value: float
    u: float
    effect: float
    """Relative change of the scale from the same lever with 0 for this input; 0 for arm and pitch."""
    contribution: float
    """Relative standard uncertainty of the scale due to `u`."""


@dataclass(frozen=True, slots=True)
class GeometryLever:
    """The effective lever and its uncertainty budget, largest contribution first."""

    lever: Lever
    cross: float
    """Displacement across over displacement along for a tilt of the slow mode."""
    budget: tuple[GeometryLine, ...]


def trace_m(geometry: LeverGeometry, tilt_rad: float) -> tuple[float, float]:
    """Displacement (across, along) of the spot on the sensor, in m, from its position at zero tilt."""
    across_m, along_m = _spot_on_sensor_m(geometry, tilt_rad) - _spot_on_sensor_m(geometry, 0.0)
    return float(across_m), float(along_m)


def lever_from_geometry(geometry: LeverGeometry) -> GeometryLever:
    """Effective lever for a geometry, with its uncertainty budget.

    Raises
    ------
    DataError
        In this geometry the beam does not reach the sensor, or a tilt moves it the wrong way.
    """
    arm, skew, cross = _effective(geometry)
    lines = []
    u_arm_2 = u_skew_2 = 0.0
    for name in LeverGeometry.model_fields:
        if name.startswith("u_"):
            continue
        value, u = getattr(geometry, name), getattr(geometry, f"u_{name}")
        effect = contribution = 0.0
        if name not in {"arm_m", "pixel_pitch_m"} and value != 0.0:
            effect = arm / _effective(geometry.model_copy(update={name: 0.0}))[0] - 1.0
        if u > 0 and name == "pixel_pitch_m":
            contribution = u / value
        elif u > 0:
            low = _effective(geometry.model_copy(update={name: value - u}))
            high = _effective(geometry.model_copy(update={name: value + u}))
            # half the second difference is included, because near an extremum the first derivative vanishes
            slope = 0.5 * abs(high[0] - low[0])
            curvature = 0.5 * abs(high[0] + low[0] - 2.0 * arm)
            contribution = math.hypot(slope, curvature) / arm
            u_arm_2 += (contribution * arm) ** 2
            u_skew_2 += (0.5 * (high[1] - low[1])) ** 2
        lines.append(GeometryLine(name, value, u, effect, contribution))
    lever = Lever(
        arm_m=arm,
        u_arm_m=math.sqrt(u_arm_2),
        pixel_pitch_m=geometry.pixel_pitch_m,
        u_pixel_pitch_m=geometry.u_pixel_pitch_m,
        skew=skew if abs(skew) > 1e-12 else 0.0,
        # rounding errors of the traced beam are no uncertainty
        u_skew=round(math.sqrt(u_skew_2), 9),
    )
    return GeometryLever(lever, cross, tuple(sorted(lines, key=lambda line: -line.contribution)))


def _effective(geometry: LeverGeometry) -> tuple[float, float, float]:
    """Effective arm in m, skew, and displacement across over displacement along."""
    tangent = math.tan(2.0 * _EVALUATION_TILT_RAD)
    across_up, up = trace_m(geometry, _EVALUATION_TILT_RAD)
    across_down, down = trace_m(geometry, -_EVALUATION_TILT_RAD)
    arm = (up - down) / (2.0 * tangent)
    if not arm > 0:
        raise DataError(
            f"lever geometry: a tilt moves the spot by {up:.3g} m; check the angles of incidence and sensor"
        )
    skew = (up + down) / (2.0 * tangent**2) / arm
    return arm, skew, (across_up - across_down) / (up - down)


def _spot_on_sensor_m(geometry: LeverGeometry, tilt_rad: float) -> Floats:
    """Intersection (across, along) of the reflected beam with the sensor, in m from the sensor's centre.

    At rest the reflected beam runs along +z; the slow mode moves it along y, which points up. A tilt rotates
    the body about the ball's centre, which itself moves by radius times tilt.
    """
    across, along = geometry.incidence_across_rad, geometry.incidence_along_rad
    normal = np.array(
        [math.sin(across) * math.cos(along), math.sin(along), math.cos(across) * math.cos(along)]
    )
    incoming = np.array([0.0, 0.0, 1.0]) - 2.0 * normal[2] * normal
    axis = np.array([-math.cos(across), 0.0, math.sin(across)])
    forward = np.cross(axis, [0.0, 1.0, 0.0])
    horizontal = np.array([math.sin(across), 0.0, math.cos(across)])
    mirror_point = geometry.beam_reach_m * horizontal + geometry.beam_height_m * np.array([0.0, 1.0, 0.0])
    tilted_normal = _rotate(normal, axis, tilt_rad)
    shift = geometry.ball_radius_m * tilt_rad * forward + _rotate(mirror_point, axis, tilt_rad) - mirror_point
    hit = incoming * (shift @ tilted_normal) / (incoming @ tilted_normal)
    outgoing = incoming - 2.0 * (incoming @ tilted_normal) * tilted_normal
    t_along, t_across = geometry.sensor_tilt_along_rad, geometry.sensor_tilt_across_rad
    up = np.array([0.0, math.cos(t_along), math.sin(t_along)])
    right = np.array(
        [math.cos(t_across), -math.sin(t_across) * math.sin(t_along), math.sin(t_across) * math.cos(t_along)]
    )
    sensor_normal = np.cross(right, up)
    centre = np.array([0.0, 0.0, geometry.arm_m])
    cos_incidence = float(outgoing @ sensor_normal)
    if abs(cos_incidence) < 1e-3:
        raise DataError(
            "lever geometry: the beam is parallel to the sensor; check sensor_tilt_along_rad and "
            "sensor_tilt_across_rad"
        )
    spot = hit + outgoing * float((centre - hit) @ sensor_normal) / cos_incidence - centre
    return np.array([spot @ right, spot @ up])


def _rotate(vector: Floats, axis: Floats, angle: float) -> Floats:
    """The vector rotated about a unit `axis` (Rodrigues' formula), angle in rad."""
    rotated: Floats = (
        vector * math.cos(angle)
        + np.cross(axis, vector) * math.sin(angle)
        + axis * (axis @ vector) * (1.0 - math.cos(angle))
    )
    return rotated
