"""Decay of an envelope: amplitudes, or powers in dB, against time, without the swings themselves.

power(t) = A(t)^2 + floor^2, where A falls by `processing.damping`
"""

from dataclasses import dataclass
from math import log10, nan, pi

import numpy as np

from processing.arrays import Floats
from processing.damping import Damping, fit_damping
from processing.swing import estimate_noise
from processing.ticks import nanoseconds

_ROUNDING = 1e-9
_NOT_DESCRIBED = 2.0
"""Chi-square per degree of freedom at which the model is wrong by as much as the noise. In noise alone it is
above this once in 30 envelopes of twelve values and once in 90,000 of sixty."""


@dataclass(frozen=True, slots=True)
class EnvelopeDecay:
    """The fall of an envelope: time constant of the amplitude (that of the power is half of it).

    `initial` and `floor` are the amplitude at the first sample and of the noise floor (NaN where the end
    shows none), in the samples' unit, `noise` is their own scatter. `tau_s` is the time constant of one
    exponential. `first_s` and `last_s` are those at the amplitudes a quarter and three quarters down the fall
    (in its logarithm); `u_tau_s` holds what it may spread over the fall. `damping` says how it depends on the
    amplitude.
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
    # computed values have none: their scatter about the fit then takes its place
    noise = max(estimate_noise(nanoseconds(t), y), _ROUNDING * float(np.max(np.abs(y), initial=0.0)))
    damping = fit_damping(t, y, np.full(len(y), noise), decibel=decibel, floor=True)
    quarters = damping.amplitudes(5)
    ends_s = damping.time_constant_s(quarters[[1, 3]])[0]

    def shown(amplitude: float) -> float:
        if not amplitude > 0:
            return nan
        return 20.0 * log10(amplitude) if decibel else amplitude

    return EnvelopeDecay(
        samples=len(y),
        noise=noise,
        initial=shown(damping.first),
        floor=shown(damping.floor),
        tau_s=damping.exponential.value,
        u_tau_s=damping.exponential.standard_uncertainty,
        chi2_per_dof=damping.exponential_chi2_per_dof,
        first_s=float(ends_s[0]),
        last_s=float(ends_s[1]),
        damping=damping,
    )
