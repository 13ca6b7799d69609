"""A ladder: steps of known tilts, or of known shifts, with the places of the spot."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.errors import DataError

Floats = NDArray[np.float64]
FEWEST_STEPS = 5
"""Along the motion at most origin, scale, skew and hysteresis are fitted: one degree of freedom remains."""


@dataclass(frozen=True, slots=True)
class LadderSteps:
    """Steps of a ladder in the order of the measurement, arrays (n,).

    `reference` is the known tilt in rad or the known shift in m, `u_reference` its standard uncertainty in
    one setting (`u_reference_relative` of `fit_ladder` is that of a factor common to all settings). `x_px`
    and `y_px` are the mean positions of the spot, `u_x_px` and `u_y_px` their standard uncertainties.
    """

    reference: Floats
    u_reference: Floats
    x_px: Floats
    y_px: Floats
    u_x_px: Floats
    u_y_px: Floats


def check_steps(steps: LadderSteps, kind: str) -> None:
    """Raise DataError for a ladder that cannot be fitted."""
    count = len(steps.reference)
    if count < FEWEST_STEPS:
        raise DataError(f"lever: the ladder has {count} steps; at least {FEWEST_STEPS} are needed")
    for name in ("reference", "u_reference", "x_px", "y_px", "u_x_px", "u_y_px"):
        values = getattr(steps, name)
        if not np.all(np.isfinite(values)):
            step = int(np.argmin(np.isfinite(values))) + 1
            raise DataError(f"lever: step {step} of the ladder has no {name}; measure it again")
    if not (np.all(steps.u_x_px > 0) and np.all(steps.u_y_px > 0) and np.all(steps.u_reference >= 0)):
        raise DataError(
            "lever: a standard uncertainty is not positive; state u_px and u_reference of each step"
        )
    if len(np.unique(steps.reference)) < 3:
        raise DataError(
            f"lever: the ladder has {len(np.unique(steps.reference))} different settings; "
            "at least 3 are needed"
        )
    if kind == "tilt" and not (np.any(steps.reference > 0) and np.any(steps.reference < 0)):
        raise DataError(
            f"lever: the tilts are all of one sign ({steps.reference.min() / ARCSEC_RAD:.4g} to "
            f"{steps.reference.max() / ARCSEC_RAD:.4g} arcsec); measure on both sides of zero"
        )


def ways_of(reference: Floats) -> Floats:
    """+1 for a setting approached from below, -1 from above; a repeated setting counts as the one before."""
    way = np.sign(np.diff(reference))
    for i in range(1, len(way)):
        way[i] = way[i] or way[i - 1]
    first = way[np.flatnonzero(way)[0]] if np.any(way) else 1.0
    way[way == 0] = first
    return np.concatenate([[first], way])


def both_ways(way: Floats) -> Floats | None:
    """The ways, if there are both, so that a hysteresis can be told."""
    return way if np.any(way > 0) and np.any(way < 0) else None
