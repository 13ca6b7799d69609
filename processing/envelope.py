"""Decay of an envelope: amplitudes, or powers in dB, against time, without the swings themselves.

power(t) = A(t)^2 + floor^2, where A falls by `processing.damping`
"""

from dataclasses import dataclass
from math import log10, nan, pi, sqrt

import numpy as np

from processing.arrays import Floats
from processing.damping import Damping, fit_damping
from processing.errors import DataError
from processing.swing import estimate_noise
from processing.ticks import nanoseconds

_FEWEST = 12
"""Eight degrees of freedom beside four parameters."""
_NO_FALL = "the envelope does not fall: this is not a ring-down, or too short a part of one"
_NOT_DESCRIBED = 2.0
"""Chi-square per degree of freedom at which the model is wrong by as much as the noise. In noise alone it is
above this once in 30 envelopes of twelve values and once in 90,000 of sixty."""


@dataclass(frozen=True, slots=True)
class EnvelopeDecay:
    """The fall of an envelope: time constant of the amplitude (that of the power is half of it).

    `initial` and `floor` are the amplitude at the first sample and of the noise floor (NaN where the end
    shows none), in the samples' unit, `noise` is their own scatter. `tau_s` is the time constant of one
    exponential. `first_s` and `last_s` are those at the amplitudes a quarter and three quarters down the fall
    (in its logarithm); where the time constant `changes`, `u_tau_s` holds the spread over the fall. `damping`
    says how it depends on the amplitude.
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
    damping: Damping

    @property
    def changes(self) -> bool:
        """Whether one time constant does not describe the fall."""
        return not self.damping.is_exponential

    @property
    def described(self) -> bool:
        """Whether constant, linear and quadratic damping together describe the fall."""
        return self.damping.chi2_per_dof <= _NOT_DESCRIBED

    def quality_factor(self, frequency_hz: float) -> tuple[float, float]:
        """pi f tau with its standard uncertainty."""
        return pi * frequency_hz * self.tau_s, pi * frequency_hz * self.u_tau_s


def fit_envelope(times_s: Floats, values: Floats, *, decibel: bool) -> EnvelopeDecay:
    """Fit the damping of an envelope, and a noise floor where its end shows one.

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
    try:
        damping = fit_damping(t, y, np.full(len(y), noise), decibel=decibel, floor=True)
    except DataError:
        raise DataError(_NO_FALL) from None
    tau_s, u_tau_s = damping.exponential
    quarters = damping.amplitudes(5)
    ends_s = damping.time_constant_s(quarters[[1, 3]])[0]
    if not damping.is_exponential:
        # from a quarter to three quarters is half of the fall
        u_tau_s = float(np.hypot(u_tau_s, 2.0 * abs(ends_s[1] - ends_s[0]) / sqrt(12.0)))

    def shown(amplitude: float) -> float:
        if not amplitude > 0:
            return nan
        return 20.0 * log10(amplitude) if decibel else amplitude

    return EnvelopeDecay(
        samples=len(y),
        noise=noise,
        initial=shown(damping.first),
        floor=shown(damping.floor),
        tau_s=tau_s,
        u_tau_s=u_tau_s,
        chi2_per_dof=damping.exponential_chi2_per_dof,
        first_s=float(ends_s[0]),
        last_s=float(ends_s[1]),
        damping=damping,
    )
