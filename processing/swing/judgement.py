"""Quality checks of a measured half-cycle, which give its flags."""

from processing.swing.arc import HalfCycleSamples
from processing.swing.half_cycle_fit import HalfCycleFit, excess, segment_size
from processing.swing.noise import NoiseLevel
from processing.swing.turning_point import HalfCycleFlag

_MAX_EXCESS_STD = 5.0
"""Chi-square, in standard deviations above its expectation, above which a half-cycle was disturbed."""
_MAX_SEGMENT_EXCESS_STD = 5.5
"""The same limit for the worst of eight parts. It is higher, so that noise alone exceeds it no more often:
with a probability of 1.5e-7, against 2.9e-7 for the whole."""
_MAX_OUTLIER_FRACTION = 0.03
"""Largest fraction of outliers (samples beyond six standard deviations), which noise does not make; one more
outlier is allowed, as a glitch."""
_MAX_TIME_ERROR_HALF_PERIODS = 0.15
"""Largest accepted difference of measured and predicted time, as a fraction of the half period."""
_MAX_GAP_HALF_PERIODS = 0.12
"""Longest gap between samples that is never flagged, as a fraction of the half period."""
_MAX_GAP_SPACINGS = 3.5
"""Longest gap between samples that is never flagged, in mean spacings of the samples."""
_MIN_SAMPLES = 7
"""Fewest samples: amplitude and time leave five degrees of freedom; with fewer chi-square shows nothing."""
_MIN_SIGNIFICANCE = 5.0
"""Smallest amplitude in its standard uncertainties; below it the fit is not linear in the phase (0.2 rad)."""


def judge(
    result: HalfCycleFit, noise: NoiseLevel, predicted_time_s: float, half_period_s: float
) -> HalfCycleFlag:
    """Flags of a valid measurement; 0 if it passes all checks.

    `predicted_time_s` has the same reference time as the measured `time_s`.
    """
    flags = HalfCycleFlag(0)
    spacing = half_period_s / (result.samples + 1)
    max_gap_s = max(_MAX_GAP_HALF_PERIODS * half_period_s, _MAX_GAP_SPACINGS * spacing)
    if result.samples < _MIN_SAMPLES or result.gap_s > max_gap_s:
        flags |= HalfCycleFlag.GAP
    # fewer of slow residuals are independent, so that their chi-square scatters more
    degrees = max(max(result.samples - 2.0, 1.0) / noise.concentration, 1.0)
    whole_excess = excess(result.chi2 / noise.scale**2 / noise.concentration, degrees)
    size = max(segment_size(result.samples) / noise.concentration, 1.0)
    segment_excess = excess(result.worst_segment / noise.scale**2 * size, size)
    if (
        whole_excess > _MAX_EXCESS_STD
        or segment_excess > _MAX_SEGMENT_EXCESS_STD
        or result.outliers > _MAX_OUTLIER_FRACTION * result.samples + 1
        or abs(result.time_s - predicted_time_s) > _MAX_TIME_ERROR_HALF_PERIODS * half_period_s
    ):
        flags |= HalfCycleFlag.VIBRATION
    if result.amplitude < _MIN_SIGNIFICANCE * result.u_amplitude:
        flags |= HalfCycleFlag.LOW_AMPLITUDE
    return flags


def holds_turning_point(result: HalfCycleFit, half: HalfCycleSamples) -> bool:
    """Whether the fitted turning point lies between the first and last sample: it is not extrapolated."""
    return result.valid and len(half.tau_s) > 0 and bool(half.tau_s[0] <= result.time_s <= half.tau_s[-1])
