"""The balance of the pendulum at one moment: one value with its unit."""

from dataclasses import dataclass
from typing import Annotated, get_type_hints

from processing.deflections import DeflectionUnit

InUnit = Annotated[float, DeflectionUnit]
"""A number of `Balance` in its `unit`, or in that unit per s."""


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
    period_s: float
    u_period_s: float
    amplitude: InUnit
    u_amplitude: InUnit
    transverse: InUnit
    u_transverse: InUnit
    transverse_ratio: float
    u_transverse_ratio: float
    line_angle_rad: float
    u_line_angle_rad: float
    rotation_rad_per_s: float
    u_rotation_rad_per_s: float
    width_ratio: float
    u_width_ratio: float
    rest_x: InUnit
    u_rest_x: InUnit
    rest_y: InUnit
    u_rest_y: InUnit
    drift_x_per_s: InUnit
    u_drift_x_per_s: InUnit
    drift_y_per_s: InUnit
    u_drift_y_per_s: InUnit
    period_ratio: float
    u_period_ratio: float


def names_with_units(unit: DeflectionUnit) -> dict[str, str]:
    """Names under which the numbers of a `Balance` are stored, by its fields; they state the unit.

    ``rest_x`` is stored as ``rest_x_rad`` or ``rest_x_px``, ``drift_x_per_s`` as ``drift_x_rad_per_s`` or
    ``drift_x_px_per_s``; other fields under their own name. `unit` itself is not among them.
    """
    names = {}
    for name, kind in get_type_hints(Balance, include_extras=True).items():
        if kind == InUnit:
            quantity = name.removesuffix("_per_s")
            names[name] = f"{quantity}_{unit}{name[len(quantity) :]}"
        elif name != "unit":
            names[name] = name
    return names
