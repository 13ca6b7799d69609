"""Whether what a fit leaves over is noise: a test of the whitened innovations, and what follows if it is not.

A chi-square near its number of degrees of freedom says nothing of the order in which the residuals
come. A model that does not describe the data leaves neighbours alike.
"""

from dataclasses import dataclass
from math import nan

import numpy as np
from scipy.special import chdtrc

from processing.arrays import Floats

CORRELATED = 0.001
"""Chance below which the residuals of amplitudes or times are called correlated."""
_LAGS = 20
"""Box and Jenkins' usual number; of a short run a fifth of its length, since far lags have few pairs."""


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Test of Ljung and Box on the residuals of amplitudes and of times, in the order of the half-cycles.

    `p_amplitude` and `p_time` are the chances of autocorrelations at least as large in pure noise, over
    `lags` neighbours, and `first_amplitude`, `first_time` the correlations of next neighbours. `widened`
    is the largest factor by which correlation enlarged a standard uncertainty of the fit.
    """

    lags: int = 0
    p_amplitude: float = nan
    p_time: float = nan
    first_amplitude: float = nan
    first_time: float = nan
    widened: float = 1.0

    @property
    def correlated(self) -> bool:
        return min(self.p_amplitude, self.p_time) < CORRELATED


def whiteness(residuals: Floats) -> Whiteness:
    """Test whitened residuals, those of the amplitudes first and then as many of the times."""
    count = len(residuals) // 2
    lags = min(_LAGS, count // 5)
    p_amplitude, first_amplitude = _ljung_box(residuals[:count], lags)
    p_time, first_time = _ljung_box(residuals[count:], lags)
    return Whiteness(lags, p_amplitude, p_time, first_amplitude, first_time)


def _ljung_box(z: Floats, lags: int) -> tuple[float, float]:
    count = len(z)
    z = np.clip(z, -5.0, 5.0)  # an outlier is listed as such; it must not hide or feign a correlation
    power = float(z @ z)
    if lags < 1 or not power > 0:
        return nan, nan
    lag = np.arange(1, lags + 1)
    correlation = np.array([float(z[k:] @ z[:-k]) for k in lag.tolist()]) / power
    return float(chdtrc(lags, count * (count + 2) * np.sum(correlation**2 / (count - lag)))), float(
        correlation[0]
    )


def correlated_covariance(residuals: Floats, jacobian: Floats, covariance: Floats, lags: int) -> Floats:
    """Covariance of fitted columns if neighbouring residuals are correlated (Newey and West, 1987).

    Parameters
    ----------
    residuals, jacobian
        Whitened, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance; it takes the place of the estimate at lag 0.
    """
    count = len(residuals) // 2
    score = (jacobian * residuals[:, None]).reshape(2, count, -1).sum(axis=0)
    both = np.zeros_like(covariance)
    for k in range(1, lags + 1):
        part = np.einsum("ij,ik->jk", score[k:], score[:-k]) * (1 - k / (lags + 1))
        both += part + part.T
    return np.asarray(covariance + covariance @ both @ covariance)


def neighbours_covariance(found: Whiteness, jacobian: Floats, covariance: Floats) -> Floats:
    """Covariance of fitted columns if next neighbours are as alike as they were found, and no others.

    Slow noise, as of air, makes times of neighbours alike by 0.2. That makes sums of them a fifth more
    uncertain, and the test misses it in a few hundred half-cycles. Correlations count less by what chance
    makes of them (the positive part of James and Stein, 1961); none makes uncertainties smaller.

    Parameters
    ----------
    jacobian
        Of whitened residuals, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance.
    """
    count = len(jacobian) // 2
    both = np.zeros_like(covariance)
    for first, rows in (
        (found.first_amplitude, jacobian[:count]),
        (found.first_time, jacobian[count : 2 * count]),
    ):
        if first > 0.0:
            alike = first * max(0.0, 1.0 - 1.0 / (count * first**2))
            part = rows[1:].T @ rows[:-1]
            both += alike * (part + part.T)
    return np.asarray(covariance + covariance @ both @ covariance)
