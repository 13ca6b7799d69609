"""The balance of the pendulum at one moment, the room that the spot has, and what is to be turned."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple, get_args, get_type_hints

import numpy as np

from processing.arrays import Floats
from processing.deflections import DeflectionUnit
from processing.quantity import Quantity

InUnit = Annotated[float, DeflectionUnit]
"""A number of `Balance` in its `unit`, or in that unit per s."""
_ANGLE = ("arcsec", "rad")
_DRIFT = ("arcsec/min", "rad/s")
"""Unit shown, and unit with a lever."""


@dataclass(frozen=True, slots=True)
class Balance:
    """State of the balance, from two slow periods about `time_ns`.

    `amplitude` is the slow mode's amplitude along Y, `transverse` the fast mode's amplitude along X
    and `transverse_ratio` the second divided by the first. `line_angle_rad` is the angle of the line from Y
    towards X, `rotation_rad_per_s` its rate of change, `width_ratio` the minor over the major axis of the
    slow mode's ellipse, positive if the spot runs from +Y towards +X. `rest_` is the rest position, `drift_`
    its drift. `period_ratio` is T_V/T_U. `u_` are standard uncertainties, enlarged if the residuals exceed
    the samples' uncertainties. If no fast mode is significant, `transverse` is 0, with the amplitude
    of the strongest spectral line as uncertainty. NaN if the samples do not determine a quantity
    (`period_ratio` without a fast mode, rates of change before the fourth period).

    The fields of type `InUnit` are in `unit`, the unit of the deflections: rad, or px without a lever. The
    angle of the line is in rad in either case.
    """

    time_ns: int
    unit: DeflectionUnit
    period_s: Annotated[float, Quantity("period", "period of the slow mode")]
    u_period_s: float
    amplitude: Annotated[InUnit, Quantity("amplitude", "amplitude of the slow mode along Y", *_ANGLE)]
    u_amplitude: InUnit
    transverse: Annotated[InUnit, Quantity("transverse", "amplitude of the fast mode along X", *_ANGLE)]
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
    u_width_ratio: float
    rest_x: Annotated[InUnit, Quantity("rest X", "rest position along X", *_ANGLE)]
    u_rest_x: InUnit
    rest_y: Annotated[InUnit, Quantity("rest Y", "rest position along Y", *_ANGLE)]
    u_rest_y: InUnit
    drift_x_per_s: Annotated[InUnit, Quantity("drift X", "drift of the rest position", *_DRIFT)]
    u_drift_x_per_s: InUnit
    drift_y_per_s: Annotated[InUnit, Quantity("drift Y", "drift of the rest position", *_DRIFT)]
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
    """The rest positions at which the spot is on the sensor: a polygon of tilts (X, Y).

    `normals` (n, 2) are unit vectors towards its edges, `distances_arcsec` (n,) those of the edges from zero
    tilt.
    """

    normals: Floats
    distances_arcsec: Floats

    def holds(self, rest_arcsec: Floats) -> bool:
        """Whether a rest position (2,) lies on the sensor."""
        return bool(np.all(self.normals @ rest_arcsec <= self.distances_arcsec))

    def largest_swing_arcsec(self, rest_arcsec: Floats, u_arcsec: Floats) -> Floats:
        """Largest amplitude along Y with which the spot stays on the sensor; negative: it is off it at rest.

        `rest_arcsec` and `u_arcsec` (..., 2): predicted rest positions and their standard uncertainties, of
        which two are kept clear. Returns (...,).
        """
        doubt = 2.0 * np.sqrt(u_arcsec**2 @ (self.normals**2).T)
        left = self.distances_arcsec - rest_arcsec @ self.normals.T - doubt
        along = np.abs(self.normals[:, 1])
        # an edge along which the pendulum swings limits no amplitude, only the rest position
        swing = np.where(
            (left < 0) | (along < 0.02), np.where(left < 0, left, np.inf), left / np.maximum(along, 0.02)
        )
        return np.asarray(np.min(swing, axis=-1))


class Doubt(StrEnum):
    """What a turn of a weight shows instead of what was stated."""

    STUCK = "does not move"
    REVERSED = "was turned the other way"
    OPEN = "may have been turned either way"


class Turn(NamedTuple):
    """The next adjustment: the weight, the number of turns (positive: clockwise) and the reason (`why`).

    `then` is a second part, the other way, which takes the play out of the screw; 0: none. `swing_arcsec` is
    the largest amplitude with which the spot will stay on the sensor afterwards (inf: not known).
    """

    weight: str
    turns: float
    why: str
    then: float = 0.0
    swing_arcsec: float = math.inf

    @property
    def parts(self) -> tuple[float, ...]:
        """The turns in sequence."""
        return (self.turns, self.then) if self.then else (self.turns,)


class Unreachable(NamedTuple):
    """No turn of the weights leads to balance; `why` says what is wrong with them."""

    why: str
