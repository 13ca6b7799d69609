"""Quality checks of a measured half-cycle, which give its flags."""

from processing.swing.arc import HalfCycleSamples
from processing.swing.half_cycle_fit import HalfCycleFit, excess, segment_size
from processing.swing.noise import NoiseLevel
from processing.swing.swing import HalfCycleFlag

_EXCESS = 5.0
"""Chi-square, in standard deviations above its expectation, above which a half-cycle was disturbed."""

_SEGMENT_EXCESS = 5.5
"""The same for the worst of eight parts, higher so that noise alone exceeds it no more often: a chance of
1.5e-7, and for the whole 2.9e-7."""

_OUTLIERS = 0.03
"""Largest fraction of samples beyond six standard deviations, of which noise makes none; one more is a
glitch."""

_SHIFT = 0.15
"""Largest accepted difference of measured and predicted time, as a fraction of the half period."""

_HOLE = 0.12
"""Longest gap between samples that is not flagged, as a fraction of the half period ..."""

_HOLE_SPACINGS = 3.5
"""... and in mean spacings of the samples; the longer of the two applies."""

_FEWEST = 7
"""Samples: five degrees of freedom beside amplitude and time, without which chi-square says nothing."""
_FAINT = 5.0
"""Amplitude in its standard uncertainties; below it the phase is not known to 0.2 rad, and the fit is no
longer linear in it."""


def judge(
    result: HalfCycleFit, noise: NoiseLevel, predicted_time_s: float, half_period_s: float
) -> HalfCycleFlag:
    """Flags of a valid measurement; 0 if all checks are passed."""
    flags = HalfCycleFlag(0)
    spacing = half_period_s / (result.samples + 1)
    if result.samples < _FEWEST or result.hole_s > max(_HOLE * half_period_s, _HOLE_SPACINGS * spacing):
        flags |= HalfCycleFlag.GAP
    # of slow residuals fewer are independent, so that their chi-square scatters more
    degrees = max(max(result.samples - 2.0, 1.0) / noise.concentration, 1.0)
    high = excess(result.chi2 / noise.scale**2 / noise.concentration, degrees)
    size = max(segment_size(result.samples) / noise.concentration, 1.0)
    part = excess(result.worst_segment / noise.scale**2 * size, size)
    shifted = abs(result.time_s - predicted_time_s) > _SHIFT * half_period_s
    if (
        high > _EXCESS
        or part > _SEGMENT_EXCESS
        or result.outliers > _OUTLIERS * result.samples + 1
        or shifted
    ):
        flags |= HalfCycleFlag.VIBRATION
    if result.amplitude < _FAINT * result.u_amplitude:
        flags |= HalfCycleFlag.LOW_AMPLITUDE
    return flags


def turned(result: HalfCycleFit, half: HalfCycleSamples) -> bool:
    """Whether the turning point lies between the first and last sample, so that it is not extrapolated."""
    return result.valid and len(half.tau_s) > 0 and bool(half.tau_s[0] <= result.time_s <= half.tau_s[-1])
