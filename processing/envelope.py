"""Exponential decay of an envelope: amplitudes, or powers in dB, against time, without the swings themselves.

power(t) = power_0 exp(-2 t/tau) + floor
"""

from dataclasses import dataclass
from math import exp, log, nan, pi, sqrt

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.swing import estimate_noise
from processing.ticks import nanoseconds

_FEWEST = 12
"""Nine degrees of freedom beside three parameters; each half of the fall has to have as many."""
_DB = 10.0 / log(10.0)
_NOT_EXPONENTIAL = 2.0
"""Chi-square per degree of freedom at which the model is wrong by as much as the noise. In noise alone it is
above this once in 30 envelopes of twelve values and once in 90,000 of sixty."""


@dataclass(frozen=True, slots=True)
class EnvelopeDecay:
    """An exponential envelope: time constant of the amplitude (that of the power is half of it).

    `initial` and `floor` are the amplitude at the first sample and of the noise floor, in the samples' unit.
    Uncertainties are multiplied by sqrt(max(1, chi2_per_dof)), with the samples' own scatter `noise`.
    `first_s` and `last_s` are the time constants of the first and the last half of the fall alone; where
    `changes`, no exponential describes the envelope, and `u_tau_s` holds the spread between them.
    """

    samples: int
    noise: float
    initial: float
    floor: float
    tau_s: float
    u_tau_s: float
    chi2_per_dof: float
    first_s: float
    last_s: float

    @property
    def changes(self) -> bool:
        """Whether one time constant does not describe the fall."""
        return self.chi2_per_dof > _NOT_EXPONENTIAL

    def quality_factor(self, frequency_hz: float) -> tuple[float, float]:
        """pi f tau with its standard uncertainty."""
        return pi * frequency_hz * self.tau_s, pi * frequency_hz * self.u_tau_s


def fit_envelope(times_s: Floats, values: Floats, *, decibel: bool) -> EnvelopeDecay:
    """Fit time constant and noise floor of an envelope.

    Parameters
    ----------
    times_s : (n,) ascending
    values : (n,) amplitudes in any unit, or powers in dB (`decibel`); NaN is left out

    Raises
    ------
    DataError
        Fewer than 12 values, amplitudes that are not positive, or values that do not fall.
    """
    good = np.isfinite(values)
    t, y = times_s[good] - times_s[0], values[good]
    if len(y) < _FEWEST:
        raise DataError(f"the envelope has {len(y)} values; at least {_FEWEST} are needed")
    if not decibel and not y[: len(y) // 2].min() > 0:
        raise DataError(
            f"an envelope's amplitudes are positive, this one holds {y.min():g}: is it the deflection itself "
            "(fit it without --envelope), or a power in dB (--envelope power)?"
        )
    noise = estimate_noise(nanoseconds(t), y)
    log_y = y / (2 * _DB) if decibel else np.log(np.maximum(y, 1e-9 * y.max()))
    low = float(log_y.min())
    start = [float(log_y[0]), 2.0 * (float(log_y[0]) - low) / float(t[-1]), low - 1.0]
    (level, rate, floor), u_rate, chi2 = _fit(t, y, noise, decibel, start)
    chi2_per_dof = chi2 / (len(y) - 3)
    u_rate *= sqrt(max(1.0, chi2_per_dof))
    if not rate > 3.0 * u_rate:
        raise DataError("the envelope does not fall: it is no ring-down, or too short a part of one")
    fallen = int(np.count_nonzero(level - rate * t > floor)) // 2
    parts = [slice(0, fallen), slice(fallen, 2 * fallen)]
    ends = (
        [1.0 / _fit(t[part], y[part], noise, decibel, [level, rate], floor)[0][1] for part in parts]
        if (fallen >= _FEWEST)
        else [nan, nan]
    )
    tau = 1.0 / rate
    u_tau = tau * u_rate / rate
    if chi2_per_dof > _NOT_EXPONENTIAL and fallen >= _FEWEST:
        # from the middle of one half to that of the other is half of the fall
        u_tau = float(np.hypot(u_tau, 2.0 * abs(ends[1] - ends[0]) / sqrt(12.0)))
    initial, lowest = (2 * _DB * x if decibel else exp(x) for x in (level, floor))
    return EnvelopeDecay(len(y), noise, initial, lowest, tau, u_tau, chi2_per_dof, ends[0], ends[1])


def _fit(
    t: Floats, y: Floats, noise: float, decibel: bool, start: list[float], floor: float = nan
) -> tuple[list[float], float, float]:
    """Least squares: logarithms of the first amplitude, the rate, the logarithm of the floor where it is NaN.

    Returns these, the standard uncertainty of the rate for this `noise` of the values, and chi2.
    """

    def residual(p: Floats) -> Floats:
        lowest = p[2] if len(p) > 2 else floor
        power = np.logaddexp(2 * (p[0] - p[1] * t), 2 * lowest)
        return np.asarray(((_DB * power if decibel else np.exp(0.5 * power)) - y) / noise)

    # imported here, since every command imports this module and few read an envelope
    from scipy.optimize import least_squares

    found = least_squares(residual, start, x_scale=[1.0, start[1], 1.0][: len(start)], max_nfev=300)
    slopes: Floats = np.asarray(found.jac)
    if len(start) > 2 and np.linalg.norm(slopes[:, 2]) < 1e-3:
        slopes = slopes[:, :2]  # a fall that ends far above the floor does not show it
    size = np.linalg.norm(slopes, axis=0)
    covariance = np.linalg.pinv((slopes / size).T @ (slopes / size)) / np.outer(size, size)
    return found.x.tolist(), float(sqrt(covariance[1, 1])), float(2.0 * found.cost)
