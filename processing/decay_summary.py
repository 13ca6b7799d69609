"""Periods and reference amplitude from the turning points; mean period and decrement of any pendulum."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.least_squares import FactoredJacobian, differenced, solve
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
"""Standard uncertainties from which on a decrement is told from zero: one over it has a value."""
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
        """pi over the decrement; None where that changes, is not told from zero, or is below it, and of a
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


_FEWEST_TO_FORECAST = 6
"""Four parameters and two degrees of freedom."""
_MOST = 240
"""The covariance of a walk has no zeros: its factors cost the cube of the number."""
_NODES = 400
"""Against 6,400 the forecast moves by a thousandth of its uncertainty."""
_PRIOR, _U_PRIOR = np.array([0.0, 0.0, 0.87, math.log(0.25)]), np.array([0.06, 0.6])
"""Of the exponent p and of ln d, the last two parameters; of the others nothing is known."""
_WALKS = np.geomspace(1e-3, 10.0, 9)
"""Variance of a half-cycle's step of the walk over that of the noise, as they are tried."""


class Forecast(NamedTuple):
    """Time in s from the last amplitude to the final one, and its standard uncertainty; NaN if too early."""

    remaining_s: float
    u_remaining_s: float


def prepare() -> None:
    """Import what the first forecast would: a tenth of a second, in which no signal is heard."""
    import scipy.linalg
    import scipy.optimize  # noqa: F401


def forecast(times_s: Floats, amplitudes: Floats, u_amplitudes: Floats, final: float) -> Forecast:
    """Predict when a decaying amplitude reaches `final` (same unit; positive).

    The loss per time is modelled as ``k (A^p + d final^p)``, the two friction terms of Eq. 5. As long as the
    decay does not determine p and the fraction d of dry friction, priors from the paper's three contact
    pairs are used (p = 0.87 ± 0.06, d = 0.25 within a factor of 1.8). The ground lets the amplitude walk, by
    equal steps each half-cycle, which delays or hastens all that follows; how large the steps are is left to
    the data, and averaged over. All this is contained in the uncertainty of the forecast, and so is the
    noise of the amplitude that will be found to lie below `final`.

    Parameters
    ----------
    times_s, amplitudes, u_amplitudes
        Turning points in order, arrays of equal length; more than 240 are thinned evenly.
    """
    good = np.isfinite(amplitudes) & (amplitudes > 0) & (u_amplitudes > 0)
    times_s, amplitudes, u_amplitudes = times_s[good], amplitudes[good], u_amplitudes[good]
    if len(times_s) < _FEWEST_TO_FORECAST:
        return Forecast(math.nan, math.nan)
    if amplitudes[-1] <= final:
        return Forecast(0.0, 0.0)
    chosen = np.unique(np.linspace(0, len(times_s) - 1, _MOST).round().astype(int))
    decay = _Decay(times_s[chosen] - times_s[-1], amplitudes[chosen], u_amplitudes[chosen], final)
    if not decay.slope < 0:
        return Forecast(math.nan, math.nan)
    return decay.remaining(float(np.median(np.diff(times_s))))


class _Decay:
    """Amplitudes (n,) at times (n,) that end with 0, and the model of their loss.

    Parameters of the model: the time of the grid's first amplitude, ln k, p and ln d.
    """

    def __init__(self, times_s: Floats, amplitudes: Floats, u_amplitudes: Floats, final: float) -> None:
        self._t, self._a, self._u, self._final = times_s, amplitudes, u_amplitudes, final
        self.slope = float(np.polyfit(times_s, np.log(amplitudes), 1)[0])
        self._grid = np.geomspace(amplitudes.max() * 1.05, final, _NODES)

    def _paces(self, parameters: Floats) -> Floats:
        """Time per loss of amplitude, on the grid."""
        _, ln_k, p, ln_d = parameters
        scaled = self._grid / self._grid[0]
        return np.asarray(np.exp(-ln_k) / (scaled**p + np.exp(ln_d) * scaled[-1] ** p))

    def _along(self, values: Floats) -> Floats:
        """Integral over the amplitude from the grid's first node downwards."""
        steps = 0.5 * (values[1:] + values[:-1]) * (self._grid[:-1] - self._grid[1:])
        return np.concatenate([[0.0], np.cumsum(steps)])

    def _at(self, amplitudes: Floats, on_grid: Floats) -> Floats:
        return np.asarray(np.interp(-amplitudes, -self._grid, on_grid))

    def _times(self, parameters: Floats) -> Floats:
        """Predicted times of the amplitudes and, last, of the final one."""
        wanted = np.append(self._a, self._final)
        return np.asarray(self._at(wanted, self._along(self._paces(parameters))) + parameters[0])

    def _fitted(self) -> Floats:
        """Parameters, as if the noise were all."""
        u_t = self._u / (-self.slope * self._a)

        def residuals(parameters: Floats) -> Floats:
            late = (self._times(parameters)[:-1] - self._t) / u_t
            return np.concatenate([late, (parameters - _PRIOR)[2:] / _U_PRIOR])

        start = np.array([self._t[0], math.log(-self.slope * self._grid[0]), *_PRIOR[2:]])
        apart = np.array([np.inf, 5.0, *(10 * _U_PRIOR)])
        found = solve(
            differenced(residuals), start, lower=start - apart, upper=start + apart, max_evaluations=60
        )
        return found.values

    def remaining(self, half_period_s: float) -> Forecast:
        """The forecast, averaged over the sizes of the walk by how well each explains the amplitudes."""
        from scipy.linalg import cholesky, solve_triangular

        parameters = self._fitted()
        times, slopes = differenced(self._times)(parameters)
        left, count, paces = self._t - times[:-1], len(self._t), self._paces(parameters)
        known = np.eye(4)[2:] / _U_PRIOR[:, None]
        # a step of the walk stays in the amplitude, so that in time it grows with the pace; it is walked
        # from one amplitude to the next whether the ground let that one fall or rise
        squares = self._at(self._a, paces**2)
        steps = 0.5 * (squares[1:] + squares[:-1]) * np.maximum(np.diff(self._t), 0.0) / half_period_s
        typical2 = float(np.median(self._u)) ** 2
        walked = typical2 * np.concatenate([[0.0], np.cumsum(steps)])
        to_come = self._along(paces**3) / half_period_s
        walk_left = typical2 * float(to_come[-1] - self._at(self._a[-1:], to_come)[0])
        noise = np.diag((self._u * self._at(self._a, paces)) ** 2)
        earlier = np.minimum.outer(np.arange(count), np.arange(count))

        def solved(ratio: float) -> tuple[float, float, float]:
            """Correction of the final time, its variance and the log likelihood, for a size of the walk."""
            root = cholesky(noise + ratio * walked[earlier], lower=True)
            white = solve_triangular(root, np.column_stack([left, slopes[:-1], ratio * walked]), lower=True)
            e, a, last = white[:, 0], white[:, 1:5], white[:, 5]
            misfit = FactoredJacobian(a).left(e)
            # amplitudes that scatter more than their uncertainties say
            scale = max(1.0, float(misfit @ misfit) / max(count - 4, 1))
            rows = np.concatenate([e / math.sqrt(scale), -known @ (parameters - _PRIOR)])
            fit = FactoredJacobian(np.vstack([a / math.sqrt(scale), known]))
            shift, rest = fit.coefficients(rows), fit.left(rows)
            # the walk so far goes on from where it is
            value = float(slopes[-1] @ shift + last @ (e - a @ shift))
            variance = float(np.sum(((slopes[-1] - last @ a) @ fit.root) ** 2))
            ahead = ratio * (walked[-1] + walk_left) - float(last @ last) + typical2 * float(paces[-1]) ** 2
            cost = float(rest @ rest) + count * math.log(scale) + 2.0 * float(np.log(np.diag(root)).sum())
            return value, variance + scale * ahead, -0.5 * (cost + fit.log_det)

        # parameters that the decay leaves without meaning have no solution
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            found = np.array([solved(ratio) for ratio in _WALKS])
            found = found[np.all(np.isfinite(found), axis=1)]
            if len(found):
                weight = np.exp(found[:, 2] - found[:, 2].max())
                weight /= weight.sum()
                mean = float(weight @ found[:, 0])
                variance = float(weight @ (found[:, 1] + (found[:, 0] - mean) ** 2))
                return Forecast(float(times[-1]) + mean, math.sqrt(max(variance, 0.0)))
        return Forecast(math.nan, math.nan)
