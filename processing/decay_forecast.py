"""Forecast of the time at which the amplitude reaches a given value: a fast fit made during the decay."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_FEWEST = 6
_MOST = 160
_NODES = 400
_EXPONENT, _U_EXPONENT = 0.87, 0.06
_LN_DRY_PART, _U_LN_DRY_PART = math.log(0.25), 0.6


class Forecast(NamedTuple):
    """Time in s from the last amplitude to the final one, and its standard uncertainty; NaN if too early."""

    remaining_s: float
    u_remaining_s: float


def forecast(times_s: Floats, amplitudes: Floats, u_amplitudes: Floats, final: float) -> Forecast:
    """Predict when a decaying amplitude reaches `final` (same unit; positive).

    The loss per time is modelled as ``k (A^p + d final^p)``, the two friction terms of Eq. 5. As long as the
    decay does not determine p and the fraction d of dry friction, priors from the paper's three contact
    pairs are used (p = 0.87 ± 0.06, d = 0.25 within a factor of 1.8). Their width is contained in the
    uncertainty of the forecast.

    Parameters
    ----------
    times_s, amplitudes, u_amplitudes
        Turning points in order, arrays of equal length; more than 160 are thinned evenly.
    """
    good = np.isfinite(amplitudes) & (amplitudes > 0) & (u_amplitudes > 0)
    times_s, amplitudes, u_amplitudes = times_s[good], amplitudes[good], u_amplitudes[good]
    if len(times_s) < _FEWEST:
        return Forecast(math.nan, math.nan)
    if amplitudes[-1] <= final:
        return Forecast(0.0, 0.0)
    chosen = np.unique(np.linspace(0, len(times_s) - 1, _MOST).round().astype(int))
    t, a, u = times_s[chosen] - times_s[-1], amplitudes[chosen], u_amplitudes[chosen]
    slope = np.polyfit(t, np.log(a), 1)[0]
    if not slope < 0:
        return Forecast(math.nan, math.nan)
    grid = np.geomspace(max(a.max(), a[0]) * 1.05, final, _NODES)
    # convert the uncertainty of each amplitude into one of time
    u_t = u / (-slope * a)

    def times_on_grid(parameters: Floats) -> Floats:
        ln_k, p, ln_d = parameters[1:]
        loss = np.exp(ln_k) * ((grid / grid[0]) ** p + np.exp(ln_d) * (final / grid[0]) ** p)
        pace = 1.0 / loss
        steps = 0.5 * (pace[1:] + pace[:-1]) * (grid[:-1] - grid[1:])
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at(values: Floats, parameters: Floats) -> Floats:
        found: Floats = np.interp(-values, -grid, times_on_grid(parameters)) + parameters[0]
        return found

    def residuals(parameters: Floats) -> Floats:
        prior = [(parameters[2] - _EXPONENT) / _U_EXPONENT, (parameters[3] - _LN_DRY_PART) / _U_LN_DRY_PART]
        return np.concatenate([(at(a, parameters) - t) / u_t, prior])

    from scipy.optimize import least_squares

    start = np.array([t[0], math.log(-slope * grid[0]), _EXPONENT, _LN_DRY_PART])
    fit = least_squares(residuals, start, x_scale=[1.0, 0.01, 0.05, 0.5], max_nfev=60)
    degrees = max(len(t) - 4, 1)
    jacobian = np.array(fit.jac, dtype=np.float64)
    chi2 = float(np.sum(fit.fun[:-2] ** 2)) / degrees
    if chi2 > 1.0:
        # the amplitudes scatter more than their uncertainties: reduce their weight accordingly
        jacobian[:-2] /= np.sqrt(chi2)
    try:
        covariance = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return Forecast(math.nan, math.nan)
    ends = np.array([final, a[-1]])

    def remaining(parameters: Floats) -> float:
        there, here = at(ends, parameters)
        return float(there - here)

    value = remaining(fit.x)
    gradient = np.empty(4)
    for k, step in enumerate((1e-3, 1e-5, 1e-5, 1e-4)):
        moved = fit.x.copy()
        moved[k] += step
        gradient[k] = (remaining(moved) - value) / step
    return Forecast(value, float(np.sqrt(gradient @ covariance @ gradient)))
