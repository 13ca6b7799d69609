"""Periods and reference amplitude from the turning points; mean period and decrement of any pendulum."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
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


_FEWEST = 4  # a straight line, and two degrees of freedom for its scatter
_FEWEST_OF_PART = 3
_NOT_CONSTANT = 4.0
"""chi2/dof of a constant value above which the scatter does not describe what is left of it."""
_AGREE = 2.0
"""Standard uncertainties of their difference within which both ends agree."""
_TOLD = 2.0
"""Standard uncertainties from which on a decrement is told from nought: one over it has a value."""
_PART = 3
"""The change is that from the first to the last third of the half-cycles."""


@dataclass(frozen=True, slots=True)
class DecayMean:
    """Mean over a decay of a value that may change with the amplitude.

    `u` is multiplied by sqrt(max(1, chi2_per_dof)). Where that is more than scatter, `u` also holds the
    spread of a value that goes evenly from `first` to `last`, its means over the first and the last third,
    with `u_first` and `u_last`; these are NaN for fewer than nine half-cycles.
    """

    value: float
    u: float
    chi2_per_dof: float
    first: float = np.nan
    u_first: float = np.nan
    last: float = np.nan
    u_last: float = np.nan

    @property
    def changes(self) -> bool:
        """Whether one value does not describe the decay: it leaves more than the scatter, and the ends
        disagree. What leaves more without a change of the value is in `u` by its chi2/dof.
        """
        if not self.chi2_per_dof > _NOT_CONSTANT:
            return False
        if np.isnan(self.first):
            return True
        return bool(abs(self.last - self.first) > _AGREE * np.hypot(self.u_first, self.u_last))


@dataclass(frozen=True, slots=True)
class DecaySummary:
    """Means over a decay with standard uncertainties.

    `period_s` is twice the slope of turning time against half-cycle, `decrement` the logarithmic decrement of
    a full period, from the slope of ln(amplitude).
    """

    half_cycles: int
    initial_amplitude: float
    final_amplitude: float
    period_s: DecayMean
    decrement: DecayMean

    @property
    def grows(self) -> bool:
        """Whether the amplitude rises: no decay, or one that runs backwards."""
        return self.decrement.value < -_TOLD * self.decrement.u

    @property
    def quality_factor(self) -> Estimate | None:
        """pi over the decrement; None where that changes, is not told from nought, or is below it, and of a
        decay that is faster than a swing.
        """
        found = self.decrement
        if found.changes or found.value > np.pi or not found.value > _TOLD * found.u:
            return None
        return Estimate(np.pi / found.value, np.pi / found.value * found.u / found.value)


def summarise_decay(points: TurningPoints) -> DecaySummary:
    """Weighted straight lines through turning times and ln(amplitude) against the half-cycle's index.

    Raises DataError for fewer than four turning points.
    """
    if len(points) < _FEWEST:
        raise DataError(
            f"{len(points)} usable half-cycles, at least {_FEWEST} are needed for a period and a decrement"
        )
    return DecaySummary(
        half_cycles=len(points),
        initial_amplitude=float(points.amplitude[0]),
        final_amplitude=float(points.amplitude[-1]),
        period_s=_mean(points.index, points.time_s, points.u_time_s, 2.0),
        decrement=_mean(points.index, np.log(points.amplitude), points.u_amplitude / points.amplitude, -2.0),
    )


def _mean(index: Ints, values: Floats, u_values: Floats, factor: float) -> DecayMean:
    """The slope of values against the half-cycle, times `factor`."""
    found = _slope(index, values, u_values, factor)
    count = len(index) // _PART
    if count < _FEWEST_OF_PART:
        return found
    first = _slope(index[:count], values[:count], u_values[:count], factor)
    last = _slope(index[-count:], values[-count:], u_values[-count:], factor)
    # from the middle of the first third to that of the last are two thirds of the decay
    found = replace(found, first=first.value, u_first=first.u, last=last.value, u_last=last.u)
    # also where the ends agree: what is more than scatter may be a change that they are too few to show
    is_more = found.chi2_per_dof > _NOT_CONSTANT
    spread = 1.5 * abs(last.value - first.value) / np.sqrt(12.0) if is_more else 0.0
    return replace(found, u=float(np.hypot(found.u, spread)))


def _slope(index: Ints, values: Floats, u_values: Floats, factor: float) -> DecayMean:
    """Slope of a weighted straight line."""
    x = index.astype(np.float64)
    weight = 1.0 / u_values**2
    mean_x = np.average(x, weights=weight)
    mean_y = np.average(values, weights=weight)
    spread = float(np.sum(weight * (x - mean_x) ** 2))
    slope = float(np.sum(weight * (x - mean_x) * (values - mean_y))) / spread
    residual = (values - mean_y - slope * (x - mean_x)) / u_values
    chi2_per_dof = float(residual @ residual) / (len(x) - 2)
    u_slope = float(np.sqrt(max(1.0, chi2_per_dof) / spread))
    return DecayMean(factor * slope, abs(factor) * u_slope, chi2_per_dof)
