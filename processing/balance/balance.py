"""Balance of the pendulum at one moment with its limits, rest positions on the sensor, a turn of a weight."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, NamedTuple, get_args, get_type_hints

import numpy as np

from processing.arrays import Floats
from processing.deflections import DeflectionUnit
from processing.quantity import Quantity
from processing.units import ARCSEC_RAD

InUnit = Annotated[float, DeflectionUnit]
"""Number of a `Balance` in its `unit`, or in that unit per s."""
_ANGLE_UNITS = ("arcsec", "rad")
_DRIFT_UNITS = ("arcsec/min", "rad/s")
"""Unit in which a number is shown, and its unit with a lever."""


@dataclass(frozen=True, slots=True)
class Balance:
    """State of the balance, from two slow periods about `time_ns`.

    `u_` are standard uncertainties, enlarged if the residuals exceed the samples' uncertainties. A quantity
    that the samples do not determine is NaN (`period_ratio` without a fast mode, rates of change before the
    fourth period). The fields of type `InUnit` are in `unit`, the unit of the deflections: rad, or px without
    a lever. The angle of the line is in rad in either case.
    """

    time_ns: int
    unit: DeflectionUnit
    period_s: Annotated[float, Quantity("period", "period of the slow mode")]
    u_period_s: float
    amplitude: Annotated[InUnit, Quantity("amplitude", "amplitude of the slow mode along Y", *_ANGLE_UNITS)]
    u_amplitude: InUnit
    transverse: Annotated[InUnit, Quantity("transverse", "amplitude of the fast mode along X", *_ANGLE_UNITS)]
    """0 if no fast mode is significant, with the amplitude of the strongest spectral line as uncertainty."""
    u_transverse: InUnit
    transverse_ratio: Annotated[float, Quantity("transverse ratio", "transverse over amplitude", "%")]
    u_transverse_ratio: float
    line_angle_rad: Annotated[
        float, Quantity("tilt of the line", "direction of the line, from Y to X", "deg")
    ]
    u_line_angle_rad: float
    rotation_rad_per_s: Annotated[float, Quantity("rotation", "turning of the line", "deg/min")]
    u_rotation_rad_per_s: float
    width_ratio: Annotated[
        float, Quantity("ellipticity", "width of the slow mode's ellipse over its length", "%")
    ]
    """Positive if the spot runs from +Y towards +X."""
    u_width_ratio: float
    rest_x: Annotated[InUnit, Quantity("rest X", "rest position along X", *_ANGLE_UNITS)]
    u_rest_x: InUnit
    rest_y: Annotated[InUnit, Quantity("rest Y", "rest position along Y", *_ANGLE_UNITS)]
    u_rest_y: InUnit
    drift_x_per_s: Annotated[InUnit, Quantity("drift X", "drift of the rest position", *_DRIFT_UNITS)]
    u_drift_x_per_s: InUnit
    drift_y_per_s: Annotated[InUnit, Quantity("drift Y", "drift of the rest position", *_DRIFT_UNITS)]
    u_drift_y_per_s: InUnit
    period_ratio: Annotated[float, Quantity("T_V / T_U", "period of the fast mode over that of the slow one")]
    u_period_ratio: float


def names_with_units(unit: DeflectionUnit) -> dict[str, str]:
    """Names under which the numbers of a `Balance` are stored, by its fields; they state the unit.

    ``rest_x`` is stored as ``rest_x_rad`` or ``rest_x_px``, ``drift_x_per_s`` as ``drift_x_rad_per_s`` or
    ``drift_x_px_per_s``; other fields under their own name. `unit` itself is not among them.
    """
    names = {}
    for name, kind in get_type_hints(Balance, include_extras=True).items():
        if DeflectionUnit in get_args(kind):
            quantity = name.removesuffix("_per_s")
            names[name] = f"{quantity}_{unit}{name[len(quantity) :]}"
        elif name != "unit":
            names[name] = name
    return names


@dataclass(frozen=True)
class Room:
    """Polygon of the rest positions (X, Y), as tilts, at which the spot is on the sensor."""

    normals: Floats
    """Unit vectors (n, 2) towards its edges."""
    distances_arcsec: Floats
    """Distances (n,) of the edges from zero."""

    def holds(self, rest_arcsec: Floats) -> bool:
        """Whether a rest position (2,) lies on the sensor."""
        return bool(np.all(self.normals @ rest_arcsec <= self.distances_arcsec))

    def largest_swing_arcsec(self, rest_arcsec: Floats, u_arcsec: Floats) -> Floats:
        """Largest amplitude (...,) along Y with which the spot stays on the sensor.

        `rest_arcsec` and `u_arcsec` (..., 2) are predicted rest positions and their standard uncertainties;
        twice the uncertainty is a margin. A negative value means that the spot is off the sensor at rest.
        """
        margin = 2.0 * np.sqrt(u_arcsec**2 @ (self.normals**2).T)
        distance = self.distances_arcsec - rest_arcsec @ self.normals.T - margin
        y_normal = np.abs(self.normals[:, 1])
        # an edge along which the pendulum swings limits no amplitude, only the rest position
        swing = np.where(y_normal < 0.02, np.inf, distance / np.maximum(y_normal, 0.02))
        return np.asarray(np.min(np.where(distance < 0, distance, swing), axis=-1))


class Doubt(StrEnum):
    """Doubt about a turn of a weight: what the measurements show instead of the stated turn."""

    STUCK = "does not move"
    REVERSED = "was turned the other way"
    OPEN = "may have been turned either way"


class Turn(NamedTuple):
    """Next adjustment of a weight."""

    weight: str
    turns: float
    """Number of turns, positive clockwise."""
    why: str
    """Reason."""
    then: float = 0.0
    """Second turn in the opposite direction, which takes up the play of the screw, or 0."""
    swing_arcsec: float = math.inf
    """Largest amplitude with which the spot stays on the sensor after the turn; infinite if unknown."""

    @property
    def parts(self) -> tuple[float, ...]:
        """Turns in sequence."""
        return (self.turns, self.then) if self.then else (self.turns,)


class Unreachable(NamedTuple):
    """Advice that no turn of the weights leads to balance, with the reason (`why`)."""

    why: str


_MAX_HEIGHT_RATIO = 0.2
"""Largest height of the mass centre, relative to the ball's radius, that a pendulum can have."""


@dataclass(frozen=True)
class BalanceLimits:
    """Limits within which the rig counts as balanced; units as in the names, ratios without a unit."""

    rest_arcsec: float = field(default=10.0, metadata={"gt": 0})
    height_m: float = field(default=20e-6, metadata={"gt": 0})
    line_angle_deg: float = field(default=0.5, metadata={"gt": 0})
    transverse_ratio: float = field(default=0.01, metadata={"gt": 0})
    width_ratio: float = field(default=0.01, metadata={"gt": 0})
    spin_deg_per_min: float = field(default=0.2, metadata={"gt": 0})


class BalanceCheck(NamedTuple):
    """A quantity of the balance checked against its limit, with the meaning of its sign."""

    name: str
    value: float
    u_value: float
    unit: str
    limit: float
    meaning: str

    @property
    def ok(self) -> bool:
        """Whether the value is within its limit, or not determined (`is_known`)."""
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
    centre of mass lies at the contact spot (Eq. 4). It is negative if the centre of mass is below the spot.
    """
    arm_m = 4.0 * math.pi**2 * inertia_kg_m2 / (mass_kg * gravity_m_per_s2 * period0_s**2)
    return ball_radius_m - arm_m


def balance_checks(
    balance: Balance, height: tuple[float, float], limits: BalanceLimits
) -> list[BalanceCheck]:
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
        BalanceCheck(
            "rest position X", b.rest_x / arcsec, b.u_rest_x / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+X" if b.rest_x > 0 else "-X"),
        ),
        BalanceCheck(
            "rest position Y", b.rest_y / arcsec, b.u_rest_y / arcsec, "arcsec",
            limits.rest_arcsec, "mass centre too far towards " + ("+Y" if b.rest_y > 0 else "-Y"),
        ),
        BalanceCheck(
            "mass centre", height[0] * 1e6, height[1] * 1e6, "µm", limits.height_m * 1e6,
            "too high: the period is long" if height[0] > 0 else "too low: the period is short",
        ),
        BalanceCheck(
            "angle of the line", b.line_angle_rad / degree, b.u_line_angle_rad / degree, "deg",
            limits.line_angle_deg, "turn the camera, or the mirror, "
            + ("back from X towards Y" if b.line_angle_rad > 0 else "from Y towards X"),
        ),
        BalanceCheck(
            "transverse motion", b.transverse_ratio, b.u_transverse_ratio, "", limits.transverse_ratio,
            "the start pushes sideways: release along Y",
        ),
        BalanceCheck(
            "leakage", b.width_ratio, b.u_width_ratio, "", limits.width_ratio,
            "the slow mode leaks into X: the axes of inertia lie askew to the contact",
        ),
        BalanceCheck(
            "spin", b.rotation_rad_per_s * per_min, b.u_rotation_rad_per_s * per_min, "deg/min",
            limits.spin_deg_per_min, "turns about the vertical: let it settle before the release",
        ),
    ]  # fmt: skip


def implausible(
    state: Floats, u_state: Floats, limits: BalanceLimits, ball_radius_m: float, room: Room | None
) -> str:
    """Reason why a measured state (rest X, rest Y in arcsec, height in m) is implausible; empty if it is not.

    A height or a radius that is NaN (not known) is not checked.
    """
    rest, height_m = state[:2], float(state[2])
    if not np.all(np.isfinite(rest)):
        return "the rest position was not determined"
    if np.any(u_state[:2] > limits.rest_arcsec):
        return f"the rest position is uncertain by {np.max(u_state[:2]):.2g} arcsec"
    if room is not None and not room.holds(rest):
        return f"a rest position of ({rest[0]:.0f}, {rest[1]:.0f}) arcsec is not on the sensor"
    if abs(height_m) > _MAX_HEIGHT_RATIO * ball_radius_m:
        return (
            f"a mass centre {height_m * 1e6:+.0f} um from the contact of a ball of"
            f" {ball_radius_m * 1e6:.0f} um cannot be: the period that was found is not the pendulum's,"
            " or balance.inertia_kg_m2 is not its inertia"
        )
    return ""
