"""Forecast of the time at which the amplitude reaches a given value: a fast fit made during the decay."""

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.least_squares import Factored, differenced, solve

_FEWEST = 6
"""Four parameters and two degrees of freedom."""
_MOST = 240
"""The covariance of a walk has no zeros: its factors cost the cube of the number."""
_NODES = 400
"""Against 6,400 the forecast moves by a thousandth of its uncertainty."""
_EXPONENT, _U_EXPONENT = 0.87, 0.06
_LN_DRY_PART, _U_LN_DRY_PART = math.log(0.25), 0.6
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
    if len(times_s) < _FEWEST:
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
        found: Floats = self._at(wanted, self._along(self._paces(parameters))) + parameters[0]
        return found

    def _prior(self, parameters: Floats) -> Floats:
        return np.array(
            [(parameters[2] - _EXPONENT) / _U_EXPONENT, (parameters[3] - _LN_DRY_PART) / _U_LN_DRY_PART]
        )

    def _fitted(self) -> Floats:
        """Parameters, as if the noise were all."""
        u_t = self._u / (-self.slope * self._a)

        def residuals(parameters: Floats) -> Floats:
            return np.concatenate([(self._times(parameters)[:-1] - self._t) / u_t, self._prior(parameters)])

        ln_k = math.log(-self.slope * self._grid[0])
        start = np.array([self._t[0], ln_k, _EXPONENT, _LN_DRY_PART])
        apart = np.array([np.inf, 5.0, 10 * _U_EXPONENT, 10 * _U_LN_DRY_PART])
        found = solve(
            differenced(residuals), start, lower=start - apart, upper=start + apart, max_evaluations=60
        )
        return found.values

    def remaining(self, half_period_s: float) -> Forecast:
        """The forecast, averaged over the sizes of the walk by how well each explains the amplitudes."""
        parameters = self._fitted()
        times = self._times(parameters)
        columns = []
        for k, step in enumerate((1e-3, 1e-5, 1e-5, 1e-4)):
            moved = parameters.copy()
            moved[k] += step
            columns.append((self._times(moved) - times) / step)
        slopes = np.column_stack(columns)
        paces = self._paces(parameters)
        # a step of the walk stays in the amplitude, so that in time it grows with the pace; it is walked
        # from one amplitude to the next whether the ground let that one fall or rise
        squares = self._at(self._a, paces**2)
        steps = 0.5 * (squares[1:] + squares[:-1]) * np.maximum(np.diff(self._t), 0.0) / half_period_s
        walked = np.concatenate([[0.0], np.cumsum(steps)])
        to_come = self._along(paces**3) / half_period_s
        left = float(to_come[-1] - self._at(self._a[-1:], to_come)[0])
        linear = _Linear(
            left=self._t - times[:-1],
            slopes=slopes[:-1],
            final_slope=slopes[-1],
            prior=self._prior(parameters),
            noise=(self._u * self._at(self._a, paces)) ** 2,
            walk=float(np.median(self._u)) ** 2 * walked,
            walk_left=float(np.median(self._u)) ** 2 * left,
            final_noise=(float(np.median(self._u)) * float(paces[-1])) ** 2,
        )
        # parameters that the decay leaves without meaning have no solution
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            found = np.array([linear.solved(ratio) for ratio in _WALKS])
            return self._averaged(found[np.all(np.isfinite(found), axis=1)], float(times[-1]))
        return Forecast(math.nan, math.nan)

    @staticmethod
    def _averaged(found: Floats, final_s: float) -> Forecast:
        if not len(found):
            return Forecast(math.nan, math.nan)
        weight = np.exp(found[:, 2] - found[:, 2].max())
        weight /= weight.sum()
        mean = float(weight @ found[:, 0])
        variance = float(weight @ (found[:, 1] + (found[:, 0] - mean) ** 2))
        return Forecast(final_s + mean, math.sqrt(max(variance, 0.0)))


class _Linear(NamedTuple):
    """The model near its fit: residual times, their slopes by the parameters, variances of noise and walk."""

    left: Floats
    slopes: Floats
    final_slope: Floats
    prior: Floats
    noise: Floats
    walk: Floats
    walk_left: float
    final_noise: float

    def solved(self, ratio: float) -> tuple[float, float, float]:
        """Correction of the final time, its variance and the log likelihood, for a size of the walk."""
        from scipy.linalg import cholesky, solve_triangular

        count = len(self.left)
        earlier = np.minimum.outer(np.arange(count), np.arange(count))
        root = cholesky(np.diag(self.noise) + ratio * self.walk[earlier], lower=True)
        white = solve_triangular(
            root, np.column_stack([self.left, self.slopes, ratio * self.walk]), lower=True
        )
        e, a, last = white[:, 0], white[:, 1:5], white[:, 5]
        misfit = Factored(a).left(e)
        # amplitudes that scatter more than their uncertainties say
        scale = max(1.0, float(misfit @ misfit) / max(count - 4, 1))
        known = np.zeros((2, 4))
        known[0, 2], known[1, 3] = 1.0 / _U_EXPONENT, 1.0 / _U_LN_DRY_PART
        normal = a.T @ a / scale + known.T @ known
        wanted = a.T @ e / scale - known.T @ self.prior
        shift = np.linalg.solve(normal, wanted)
        # the walk so far goes on from where it is
        slope = self.final_slope - last @ a
        value = float(self.final_slope @ shift + last @ (e - a @ shift))
        variance = float(slope @ np.linalg.solve(normal, slope))
        ahead = ratio * (self.walk[-1] + self.walk_left) - float(last @ last) + self.final_noise
        cost = float(e @ e) / scale + float(self.prior @ self.prior) - float(wanted @ shift)
        cost += count * math.log(scale) + 2.0 * float(np.log(np.diag(root)).sum())
        return value, variance + scale * ahead, -0.5 * (cost + float(np.linalg.slogdet(normal)[1]))
