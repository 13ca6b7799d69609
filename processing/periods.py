"""Periods and reference amplitude, computed from the turning points."""

from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.estimate import Estimate
from processing.swing import TurningPoints

FEWEST_PERIODS = 5
"""Smallest number of full periods to which Eq. 6 is fitted."""


class Periods(NamedTuple):
    """Full periods centred on turning points that have both neighbours; `where` are their positions."""

    where: Ints
    period_s: Floats
    u_period_s: Floats


def reference_amplitude(points: TurningPoints) -> float:
    """Geometric mean of the amplitudes; in this unit b and p, and gamma and n, are least correlated."""
    return float(np.exp(np.mean(np.log(points.amplitude))))


def full_periods(points: TurningPoints) -> Periods:
    """Times from the turning point before to the one after, if neither is missing."""
    complete = (points.index[2:] - points.index[:-2]) == 2
    where = np.nonzero(complete)[0] + 1
    u2 = points.u_time_s**2
    return Periods(
        where,
        points.time_s[where + 1] - points.time_s[where - 1],
        np.sqrt(u2[where + 1] + u2[where - 1]),
    )


def mean_period(points: TurningPoints) -> float:
    """Mean full period of the run in s, including gaps."""
    return float(2 * (points.time_s[-1] - points.time_s[0]) / (points.index[-1] - points.index[0]))


def mean_period_estimate(points: TurningPoints, chi2_per_dof: float) -> Estimate:
    """`mean_period` with its standard uncertainty, multiplied by sqrt(max(1, chi2_per_dof))."""
    u = np.hypot(points.u_time_s[0], points.u_time_s[-1]) * np.sqrt(max(1.0, chi2_per_dof))
    return Estimate(mean_period(points), float(2 * u / (points.index[-1] - points.index[0])))
