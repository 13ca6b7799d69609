"""What an error of a rolling shutter's row time does to the parameters of a fit."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall
from processing.fit.apparatus import RigQuantities
from processing.fit.exact import fit_exact_with
from processing.fit.result import FitResult
from processing.swing import TurningPoints


def by_row_time(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult, rig: RigQuantities
) -> NDArray[np.float64] | None:
    """Derivatives (parameters,) of the contact parameters by the row time; None where it is not uncertain.

    Turning points at the two ends of the swing lie on rows above and below that of rest: a row time wrong by
    d makes the ones late by d times their distance in rows, the others as much early. Full periods keep
    their lengths but for friction. The points are fitted again, with the noise of the `exact` fit. Which end
    comes first is not known, and so the sign is not either.

    Raises DataError if a fit does not converge.
    """
    u_s = rig.row_time_s.u
    if u_s == 0:
        return None
    rows = np.tan(2.0 * points.amplitude) * rig.arm_m.value / rig.pitch_m.value
    rows *= np.cos(rig.slow_angle_rad.value) * (1 - 2 * (points.index % 2))
    found = []
    for error_s in (-u_s, u_s):
        moved = replace(points, time_s=points.time_s + error_s * rows)
        fit = fit_exact_with(moved, pendulum, exact, drag=exact.has_drag)
        found.append(fit.values[[fit.names.index(name) for name in fit.contact_names]])
    slopes: NDArray[np.float64] = (found[1] - found[0]) / (2.0 * u_s)
    return slopes
