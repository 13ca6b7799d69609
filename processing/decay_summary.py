"""Periods, reference amplitude, mean period and decrement from turning points; forecast of a decay."""

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
MIN_TURNING_POINTS = 4
"""Smallest number of turning points: a straight line leaves two degrees of freedom for its scatter."""
_MIN_PART_POINTS = 3
_MAX_CONSTANT_CHI2 = 4.0
"""chi2/dof of a constant value above which its residuals are more than scatter."""
_AGREEMENT_U = 2.0
"""Standard uncertainties of their difference within which both ends agree."""
_SIGNIFICANT_U = 2.0
"""Standard uncertainties above which a decrement differs from zero, so that its reciprocal has a value."""
_PARTS = 3
"""Number of equal parts of the half-cycles; a change is that from the first part to the last."""
_MIN_FORECAST_AMPLITUDES = 6
"""Smallest number of amplitudes of a forecast: four parameters leave two degrees of freedom."""
_MAX_FORECAST_AMPLITUDES = 240
"""Largest number of amplitudes: the covariance of a random walk is full, and its factor costs their cube."""
_GRID_NODES = 400
"""Nodes of the amplitude grid. With 6,400 the forecast differs by a thousandth of its uncertainty."""
_PRIOR, _U_PRIOR = np.array([0.0, 0.0, 0.87, math.log(0.25)]), np.array([0.06, 0.6])
"""Means of the parameters, and standard deviations of the last two, p and ln d; the others have no prior."""
_WALK_RATIOS = np.geomspace(1e-3, 10.0, 9)
"""Variances of a half-cycle's step of the walk that are tried, relative to the variance of the noise."""


class Periods(NamedTuple):
    """Full periods centred on turning points with both neighbours."""

    points: Ints
    """Positions of these turning points in the arrays."""
    period_s: Floats
    u_period_s: Floats


def reference_amplitude(points: TurningPoints) -> float:
    """Geometric mean of the amplitudes; in this unit b and p, and gamma and n, are least correlated."""
    return float(np.exp(np.mean(np.log(points.amplitude))))


def full_periods(points: TurningPoints) -> Periods:
    """Times between the neighbours of each turning point, if neither neighbour is missing."""
    centres = np.flatnonzero(points.index[2:] - points.index[:-2] == 2) + 1
    u2 = points.u_time_s**2
    return Periods(
        centres,
        points.time_s[centres + 1] - points.time_s[centres - 1],
        np.sqrt(u2[centres + 1] + u2[centres - 1]),
    )


def mean_period(points: TurningPoints) -> float:
    """Mean full period of the run in s, including gaps."""
    return float(2 * (points.time_s[-1] - points.time_s[0]) / (points.index[-1] - points.index[0]))


def mean_period_estimate(points: TurningPoints, chi2_per_dof: float) -> Estimate:
    """`mean_period` with its standard uncertainty, multiplied by sqrt(max(1, chi2_per_dof))."""
    u = np.hypot(points.u_time_s[0], points.u_time_s[-1]) * np.sqrt(max(1.0, chi2_per_dof))
    return Estimate(mean_period(points), float(2 * u / (points.index[-1] - points.index[0])))


@dataclass(frozen=True, slots=True)
class DecayMean:
    """Mean over a decay of a value that may change with the amplitude."""

    value: float
    u: float
    """Multiplied by sqrt(max(1, chi2_per_dof)). If the residuals are more than scatter, it also includes the
    spread of a value that changes evenly from `first` to `last`.
    """
    chi2_per_dof: float
    first: float = np.nan
    """Mean over the first third; NaN for fewer than nine half-cycles, like the others."""
    u_first: float = np.nan
    last: float = np.nan
    """Mean over the last third."""
    u_last: float = np.nan

    @property
    def changes(self) -> bool:
        """Whether the value changes over the decay: residuals are more than scatter, and the ends disagree.

        Larger residuals without a change are included in `u` by chi2/dof.
        """
        if not self.chi2_per_dof > _MAX_CONSTANT_CHI2:
            return False
        if np.isnan(self.first):
            return True
        return bool(abs(self.last - self.first) > _AGREEMENT_U * np.hypot(self.u_first, self.u_last))


@dataclass(frozen=True, slots=True)
class DecaySummary:
    """Means over a decay with standard uncertainties."""

    half_cycles: int
    initial_amplitude: float
    final_amplitude: float
    period_s: DecayMean
    """Twice the slope of turning time against half-cycle number."""
    decrement: DecayMean
    """Logarithmic decrement of a full period, from the slope of ln(amplitude)."""

    @property
    def grows(self) -> bool:
        """Whether the amplitude rises: no decay, or a decay with its time reversed."""
        return self.decrement.value < -_SIGNIFICANT_U * self.decrement.u

    @property
    def quality_factor(self) -> Estimate | None:
        """Quality factor, pi over the decrement.

        None if the decrement changes, is not significantly positive, or exceeds pi (faster than a period).
        """
        value, u = self.decrement.value, self.decrement.u
        if self.decrement.changes or value > np.pi or not value > _SIGNIFICANT_U * u:
            return None
        return Estimate(np.pi / value, np.pi / value * u / value)


def summarise_decay(points: TurningPoints) -> DecaySummary:
    """Summary from weighted straight lines through turning times and ln(amplitude) against the index.

    Raises DataError for fewer than four turning points.
    """
    if len(points) < MIN_TURNING_POINTS:
        raise DataError(
            f"{len(points)} usable half-cycles, at least {MIN_TURNING_POINTS} are needed for a "
            "period and a decrement"
        )
    return DecaySummary(
        half_cycles=len(points),
        initial_amplitude=float(points.amplitude[0]),
        final_amplitude=float(points.amplitude[-1]),
        period_s=_mean(points.index, points.time_s, points.u_time_s, 2.0),
        decrement=_mean(points.index, np.log(points.amplitude), points.u_amplitude / points.amplitude, -2.0),
    )


def _mean(index: Ints, values: Floats, u_values: Floats, factor: float) -> DecayMean:
    """Slope of values against the half-cycle's index, multiplied by `factor`, with those of both ends."""
    mean = _slope(index, values, u_values, factor)
    count = len(index) // _PARTS
    if count < _MIN_PART_POINTS:
        return mean
    first = _slope(index[:count], values[:count], u_values[:count], factor)
    last = _slope(index[-count:], values[-count:], u_values[-count:], factor)
    spread = 0.0
    # also if the ends agree: large residuals may be a change for which their points are too few
    if mean.chi2_per_dof > _MAX_CONSTANT_CHI2:
        # from the middle of the first third to that of the last are two thirds of the decay
        spread = 1.5 * abs(last.value - first.value) / np.sqrt(12.0)
    u = float(np.hypot(mean.u, spread))
    return replace(mean, u=u, first=first.value, u_first=first.u, last=last.value, u_last=last.u)


def _slope(index: Ints, values: Floats, u_values: Floats, factor: float) -> DecayMean:
    """Slope of a weighted straight line, multiplied by `factor`."""
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


class Forecast(NamedTuple):
    """Time in s from the last amplitude to the final one, and its standard uncertainty; NaN if too early."""

    remaining_s: float
    u_remaining_s: float


def prepare() -> None:
    """Import the modules of the first forecast: a tenth of a second in which signals are not handled."""
    import scipy.linalg
    import scipy.optimize  # noqa: F401


def forecast(times_s: Floats, amplitudes: Floats, u_amplitudes: Floats, final: float) -> Forecast:
    """Predict when a decaying amplitude reaches `final` (same unit; positive).

    The loss per time is modelled as ``k (A^p + d final^p)``, the two friction terms of Eq. 5. As long as the
    decay does not determine p and the fraction d of dry friction, priors from the paper's three contact
    pairs are used (p = 0.87 ± 0.06, d = 0.25 within a factor of 1.8). The ground makes the amplitude walk at
    random, by steps of equal variance each half-cycle, which advance or delay all later amplitudes; the
    forecast is averaged over the variance of the steps, weighted by the data. The uncertainty of the forecast
    includes all this, and the noise of the amplitude that will first be measured below `final`.

    Parameters
    ----------
    times_s, amplitudes, u_amplitudes
        Turning points in order, arrays of equal length; many are thinned evenly (`_MAX_FORECAST_AMPLITUDES`).
    """
    good = np.isfinite(amplitudes) & (amplitudes > 0) & (u_amplitudes > 0)
    times_s, amplitudes, u_amplitudes = times_s[good], amplitudes[good], u_amplitudes[good]
    if len(times_s) < _MIN_FORECAST_AMPLITUDES:
        return Forecast(math.nan, math.nan)
    if amplitudes[-1] <= final:
        return Forecast(0.0, 0.0)
    chosen = np.unique(np.linspace(0, len(times_s) - 1, _MAX_FORECAST_AMPLITUDES).round().astype(int))
    decay = _Decay(times_s[chosen] - times_s[-1], amplitudes[chosen], u_amplitudes[chosen], final)
    if not decay.slope < 0:
        return Forecast(math.nan, math.nan)
    return decay.remaining(float(np.median(np.diff(times_s))))


class _Decay:
    """Amplitudes (n,) at times (n,) of which the last is 0, and the model of their loss. Its parameters are
    the time of the grid's first amplitude, ln k, p and ln d."""

    def __init__(self, times_s: Floats, amplitudes: Floats, u_amplitudes: Floats, final: float) -> None:
        self._t, self._a, self._u, self._final = times_s, amplitudes, u_amplitudes, final
        self.slope = float(np.polyfit(times_s, np.log(amplitudes), 1)[0])
        self._grid = np.geomspace(amplitudes.max() * 1.05, final, _GRID_NODES)

    def _paces(self, parameters: Floats) -> Floats:
        """Time per loss of amplitude, at the nodes of the grid."""
        _, ln_k, p, ln_d = parameters
        scaled = self._grid / self._grid[0]
        return np.asarray(np.exp(-ln_k) / (scaled**p + np.exp(ln_d) * scaled[-1] ** p))

    def _integral(self, values: Floats) -> Floats:
        """Integral over the amplitude from the grid's first node downwards."""
        steps = 0.5 * (values[1:] + values[:-1]) * (self._grid[:-1] - self._grid[1:])
        return np.concatenate([[0.0], np.cumsum(steps)])

    def _interpolate(self, amplitudes: Floats, on_grid: Floats) -> Floats:
        return np.asarray(np.interp(-amplitudes, -self._grid, on_grid))

    def _times(self, parameters: Floats) -> Floats:
        """Predicted times of the amplitudes and, last, of the final one."""
        amplitudes = np.append(self._a, self._final)
        return np.asarray(
            self._interpolate(amplitudes, self._integral(self._paces(parameters))) + parameters[0]
        )

    def _white_noise_fit(self) -> Floats:
        """Parameters of a fit with white noise alone, without a walk."""
        u_t = self._u / (-self.slope * self._a)

        def residuals(parameters: Floats) -> Floats:
            delay = (self._times(parameters)[:-1] - self._t) / u_t
            return np.concatenate([delay, (parameters - _PRIOR)[2:] / _U_PRIOR])

        start = np.array([self._t[0], math.log(-self.slope * self._grid[0]), *_PRIOR[2:]])
        reach = np.array([np.inf, 5.0, *(10 * _U_PRIOR)])
        return solve(
            differenced(residuals), start, lower=start - reach, upper=start + reach, max_evaluations=60
        ).values

    def remaining(self, half_period_s: float) -> Forecast:
        """Forecast averaged over the sizes of the walk, weighted by their likelihoods."""
        from scipy.linalg import cholesky, solve_triangular

        parameters = self._white_noise_fit()
        times, slopes = differenced(self._times)(parameters)
        residuals, count, paces = self._t - times[:-1], len(self._t), self._paces(parameters)
        prior_rows = np.eye(4)[2:] / _U_PRIOR[:, None]
        # a step of the walk stays in the amplitude, so that its effect on the time grows with the pace; it
        # adds from one amplitude to the next whether that one is lower or higher
        squares = self._interpolate(self._a, paces**2)
        steps = 0.5 * (squares[1:] + squares[:-1]) * np.maximum(np.diff(self._t), 0.0) / half_period_s
        median_u2 = float(np.median(self._u)) ** 2
        walk_variance = median_u2 * np.concatenate([[0.0], np.cumsum(steps)])
        walk_ahead = self._integral(paces**3) / half_period_s
        walk_left = median_u2 * float(walk_ahead[-1] - self._interpolate(self._a[-1:], walk_ahead)[0])
        noise = np.diag((self._u * self._interpolate(self._a, paces)) ** 2)
        earlier_index = np.minimum.outer(np.arange(count), np.arange(count))

        def correction(ratio: float) -> tuple[float, float, float]:
            """Correction of the final time, its variance and the log likelihood, for a size of the walk."""
            root = cholesky(noise + ratio * walk_variance[earlier_index], lower=True)
            white = solve_triangular(
                root, np.column_stack([residuals, slopes[:-1], ratio * walk_variance]), lower=True
            )
            e, a, last = white[:, 0], white[:, 1:5], white[:, 5]
            unexplained = FactoredJacobian(a).residual(e)
            # amplitudes may scatter more than by their uncertainties
            scale = max(1.0, float(unexplained @ unexplained) / max(count - 4, 1))
            rows = np.concatenate([e / math.sqrt(scale), -prior_rows @ (parameters - _PRIOR)])
            fit = FactoredJacobian(np.vstack([a / math.sqrt(scale), prior_rows]))
            shift, residual_rows = fit.coefficients(rows), fit.residual(rows)
            # the future walk starts from the present offset of the walk
            value = float(slopes[-1] @ shift + last @ (e - a @ shift))
            variance = float(np.sum(((slopes[-1] - last @ a) @ fit.root) ** 2))
            ahead = (
                ratio * (walk_variance[-1] + walk_left)
                - float(last @ last)
                + median_u2 * float(paces[-1]) ** 2
            )
            chi2, log_det_root = float(residual_rows @ residual_rows), float(np.log(np.diag(root)).sum())
            cost = chi2 + count * math.log(scale) + 2.0 * log_det_root
            return value, variance + scale * ahead, -0.5 * (cost + fit.log_det)

        # a decay that does not determine the parameters may have no solution
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            table = np.array([correction(ratio) for ratio in _WALK_RATIOS])
            values, variances, log_likelihoods = table[np.all(np.isfinite(table), axis=1)].T
            if len(values):
                weight = np.exp(log_likelihoods - log_likelihoods.max())
                weight /= weight.sum()
                mean = float(weight @ values)
                variance = float(weight @ (variances + (values - mean) ** 2))
                return Forecast(float(times[-1]) + mean, math.sqrt(max(variance, 0.0)))
        return Forecast(math.nan, math.nan)
