"""Which quantities of the balance exceed their limits, and whether a measured balance can be true at all."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.balance.balance import Balance, Room
from processing.deflections import DeflectionUnit
from processing.units import ARCSEC_RAD

_MOST_HEIGHT = 0.2
"""Height of the mass centre over the ball's radius: beyond it the period was not the pendulum's."""


@dataclass(frozen=True)
class BalanceLimits:
    """Limits within which the rig counts as balanced; units as in the names, ratios without a unit."""

    rest_arcsec: float = field(default=10.0, metadata={"gt": 0})
    height_m: float = field(default=20e-6, metadata={"gt": 0})
    line_angle_deg: float = field(default=0.5, metadata={"gt": 0})
    transverse_ratio: float = field(default=0.01, metadata={"gt": 0})
    width_ratio: float = field(default=0.01, metadata={"gt": 0})
    spin_deg_per_min: float = field(default=0.2, metadata={"gt": 0})


class Fault(NamedTuple):
    """A quantity that describes the balance, with its limit and the meaning of its sign."""

    name: str
    value: float
    u_value: float
    unit: str
    limit: float
    meaning: str

    @property
    def ok(self) -> bool:
        """Whether nothing is known against it: within its limit, or not determined (`is_known`)."""
        return not abs(self.value) > self.limit

    @property
    def is_known(self) -> bool:
        """Whether the value was determined."""
        return not math.isnan(self.value)


def mass_centre_height_m(
    period0_s: float, inertia_kg_m2: float, mass_kg: float, ball_radius_m: float, gravity_m_per_s2: float
) -> float:
    """Height of the centre of mass above the contact spot in m, from I = m g l T0^2 / (4 pi^2).

    l is the distance from the ball's centre down to the centre of mass; it equals the ball's radius if the
    centre of mass lies at the contact spot (Eq. 4). Negative: the centre of mass is below the contact spot.
    """
    arm_m = 4.0 * math.pi**2 * inertia_kg_m2 / (mass_kg * gravity_m_per_s2 * period0_s**2)
    return ball_radius_m - arm_m


def find_faults(balance: Balance, height: tuple[float, float], limits: BalanceLimits) -> list[Fault]:
    """All quantities of the balance with their limits. `height` is (value, standard uncertainty) in m.

    Raises ValueError for a balance in px: its limits are in arcsec.
    """
    if balance.unit is not DeflectionUnit.RAD:
        raise ValueError(
            f"a balance in {balance.unit} has no limits: they are in arcsec, calibrate the lever"
        )
    arcsec, degree = ARCSEC_RAD, math.pi / 180.0
    b = balance
    per_min = 60.0 / degree
    return [
        Fault(
            "rest position X", b.rest_x / arcsec, b.u_rest_x / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+X" if b.rest_x > 0 else "-X"),
        ),
        Fault(
            "rest position Y", b.rest_y / arcsec, b.u_rest_y / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+Y" if b.rest_y > 0 else "-Y"),
        ),
        Fault(
            "mass centre", height[0] * 1e6, height[1] * 1e6, "µm", limits.height_m * 1e6,
            "too high: the period is long" if height[0] > 0 else "too low: the period is short",
        ),
        Fault(
            "angle of the line", b.line_angle_rad / degree, b.u_line_angle_rad / degree, "deg",
            limits.line_angle_deg, "turn the camera, or the mirror, "
            + ("back from X towards Y" if b.line_angle_rad > 0 else "from Y towards X"),
        ),
        Fault(
            "transverse motion", b.transverse_ratio, b.u_transverse_ratio, "", limits.transverse_ratio,
            "the start pushes sideways: release along Y",
        ),
        Fault(
            "leakage", b.width_ratio, b.u_width_ratio, "", limits.width_ratio,
            "the slow mode leaks into X: the axes of inertia lie askew to the contact",
        ),
        Fault(
            "spin", b.rotation_rad_per_s * per_min, b.u_rotation_rad_per_s * per_min, "deg/min",
            limits.spin_deg_per_min, "turns about the vertical: let it settle before the release",
        ),
    ]  # fmt: skip


def implausible(
    state: Floats, u_state: Floats, limits: BalanceLimits, ball_radius_m: float, room: Room | None
) -> str:
    """Why a measured state (rest X, rest Y in arcsec, height in m) is not to be believed; empty if it is.

    NaN: a height that cannot be computed, or a radius that is not known, is not judged.
    """
    rest, height_m = state[:2], float(state[2])
    if not np.all(np.isfinite(rest)):
        return "the rest position was not determined"
    if np.any(u_state[:2] > limits.rest_arcsec):
        return f"the rest position is uncertain by {np.max(u_state[:2]):.2g} arcsec"
    if room is not None and not room.holds(rest):
        return f"a rest position of ({rest[0]:.0f}, {rest[1]:.0f}) arcsec is not on the sensor"
    if abs(height_m) > _MOST_HEIGHT * ball_radius_m:
        return (
            f"a mass centre {height_m * 1e6:+.0f} um from the contact of a ball of"
            f" {ball_radius_m * 1e6:.0f} um cannot be: the period that was found is not the pendulum's,"
            " or balance.inertia_kg_m2 is not its inertia"
        )
    return ""
