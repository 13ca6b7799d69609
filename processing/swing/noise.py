"""Noise of the samples: estimated from a record, or learned from the residuals of the half-cycles.

Air, a wandering pointing and the effect of a drive within a half-cycle leave slow residuals. In white noise
each cosine of a series over the half-cycle holds the same power; here the slow ones hold more, and amplitude
and time of the turning point, which are slower still, have larger errors than the scatter of the samples
suggests. The residuals are measured at 4 to 6 times the pendulum's frequency; at the frequency itself noise
cannot be distinguished from the motion. Its power is assumed to rise like 1/f towards it.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.noise_models import robust_scatter
from processing.swing.half_cycle_fit import HalfCycleFit
from processing.swing.turning_point import HalfCycle
from processing.units import seconds

_SCALE_HALF_CYCLES = 15
"""Number of half-cycles whose median reduced chi-square gives the factor on the samples' uncertainties."""
_SLOW_HALF_CYCLES = 63
"""Number of half-cycles whose median slow power is used. The median scatters by 0.13, so that noise counts as
slow from 1.8 times the power of white noise on."""
_CHI2_MEDIAN = 0.789
"""Median of a chi-square of three degrees of freedom, per degree."""
_CHI2_MEDIAN_STD = 1.02
"""Standard deviation of the median of m such values, multiplied by sqrt(m)."""
_SIGNIFICANT_STD = 6.0
"""Significance in standard deviations; high, because a run tests after each of thousands of half-cycles."""
_NOISE_POWER_RISE = 4.0
"""Power of 1/f noise at 1.25 times the pendulum's frequency, which shifts turning points, relative to its
power at 5 times the frequency, where it is measured; rounded."""
_CENTRE_POWER_RISE = 9.0
"""The same ratio for about half the frequency, which shifts the centre."""


class NoiseLevel(NamedTuple):
    """Noise of the samples, as factors on uncertainties."""

    scale: float
    """Factor on the samples' uncertainties."""
    colour: float = 1.0
    """Further factor on the uncertainties of turning points, for slow noise."""
    amplitude: float = 1.0
    """Further factor on the uncertainties of amplitudes, which contain the centre's error as well."""
    concentration: float = 1.0
    """Power of slow residuals relative to white ones; the number of independent ones is divided by it."""

    @property
    def effective(self) -> float:
        """Factor on the samples' uncertainties for white noise of the same effect on turning points."""
        return self.scale * self.colour


class SampleNoise:
    """Estimate of the noise, updated by every half-cycle; `level` is the present one."""

    def __init__(self, scale: float) -> None:
        self.level = NoiseLevel(scale)
        self._ratios: deque[float] = deque([scale**2] * _SCALE_HALF_CYCLES, maxlen=_SCALE_HALF_CYCLES)
        self._slow_powers: deque[float] = deque(maxlen=_SLOW_HALF_CYCLES)

    def learn(self, result: HalfCycleFit) -> None:
        """Add one more half-cycle without gaps."""
        degrees = max(result.samples - 2, 1)
        self._ratios.append(result.chi2 / degrees)
        median = sorted(self._ratios)[_SCALE_HALF_CYCLES // 2]
        scatter = 1.25 * math.sqrt(2.0 / degrees / _SCALE_HALF_CYCLES)
        scale = math.sqrt(median) if median > 1.0 + 4.0 * scatter else 1.0
        self.level = NoiseLevel(scale, *self._colour(scale, result))

    def _colour(self, scale: float, result: HalfCycleFit) -> tuple[float, float, float]:
        if math.isfinite(result.slow_power):
            self._slow_powers.append(result.slow_power)
        count = len(self._slow_powers)
        if not count:
            return 1.0, 1.0, 1.0
        power = sorted(self._slow_powers)[count // 2] / (_CHI2_MEDIAN * scale**2)
        if power < 1.0 + _SIGNIFICANT_STD * _CHI2_MEDIAN_STD / math.sqrt(count):
            return 1.0, 1.0, 1.0
        colour, amplitude = (
            math.sqrt(1.0 + rise * (power - 1.0)) for rise in (_NOISE_POWER_RISE, _CENTRE_POWER_RISE)
        )
        return colour, amplitude / colour, power


_SPEED_BINS = 8
"""Number of bins of speed, over which the scatter is compared."""
_MIN_DIFFERENCES = 24
"""Fewest differences in a bin."""
_MIN_VARIANCE_RATIO = 1e-3
"""Smallest expected variance of a bin, relative to the median variance of the differences."""
_MAX_SPEED_RATIO = 0.99
"""Ratio of the mean square speeds of slowest and fastest bin above which speeds do not differ."""
_DIFFERENCE_ORDER = 5
"""Order of the differences; they leave less than 1e-3 of a sinusoid sampled 20 times per period."""


class SampleScatter(NamedTuple):
    """Scatter of samples about any smooth motion."""

    noise: float
    """Standard uncertainty of a deflection alone."""
    jitter_s: float
    """Standard uncertainty of the times; 0 if it is not significant."""
    u_deflection: Floats
    """(n,) uncertainty from noise and jitter: an error d of its time moves a sample by d times its speed."""


def estimate_scatter(times_ns: ArrayLike, deflection: ArrayLike) -> SampleScatter:
    """Noise of the samples, and jitter of their times, as in time stamps of a busy host.

    If times jitter, the fifth differences of `estimate_noise` scatter more where the motion is fast. With few
    samples per period they are larger there, too, but neighbours do not alternate in sign as those of noise
    do. Errors as of `estimate_noise`.
    """
    noise = estimate_noise(times_ns, deflection)
    times, values, all_times = _usable(times_ns, deflection)
    difference, speed = _differences(times, values)
    order = np.argsort(speed)
    bins = [indices for indices in np.array_split(order, _SPEED_BINS) if len(indices) >= _MIN_DIFFERENCES]
    without_jitter = SampleScatter(noise, 0.0, np.full(len(all_times), noise))
    if len(bins) < _SPEED_BINS:
        return without_jitter
    fast = np.sort(order[len(order) // 2 :])
    fast = fast[fast + 1 < len(difference)]
    neighbour_sign = float(np.median(np.sign(difference[fast] * difference[fast + 1])))
    measured2 = np.array([robust_scatter(difference[indices], middle=0.0) ** 2 for indices in bins])
    speed2 = np.array([np.mean(speed[indices] ** 2) for indices in bins])
    # the scatter of a sensor with few digits is zero in some of the bins
    min2 = _MIN_VARIANCE_RATIO * float(np.median(measured2))
    if not (min2 > 0 and speed2[0] < _MAX_SPEED_RATIO * speed2[-1]):
        # the sensor stands still, or the motion does not oscillate
        return without_jitter
    size = np.array([len(indices) for indices in bins])
    terms = np.column_stack([np.ones(_SPEED_BINS), speed2 / speed2[-1]])
    expected2 = np.maximum(measured2, min2)
    for _ in range(3):
        # fifth differences share samples: one in six neighbours is independent
        weight = np.sqrt(size / 6.0 / 2.0) / expected2
        covariance = np.linalg.inv((terms * weight[:, None]).T @ (terms * weight[:, None]))
        coefficients = covariance @ (terms.T @ (weight**2 * measured2))
        expected2 = np.maximum(terms @ coefficients, np.maximum(_MIN_VARIANCE_RATIO * measured2, min2))
    noise2, jitter2 = coefficients.tolist()
    if neighbour_sign > 0 or not jitter2 > _SIGNIFICANT_STD * float(np.sqrt(covariance[1, 1])):
        return without_jitter
    jitter_s = math.sqrt(jitter2 / speed2[-1])
    speed_of_sample = np.interp(
        np.asarray(times_ns, dtype=np.float64),
        times[: len(speed)] + 0.5 * (times[_DIFFERENCE_ORDER] - times[0]),
        speed,
    )
    u_deflection = np.sqrt(max(noise2, 0.0) + (jitter_s * speed_of_sample) ** 2)
    return SampleScatter(noise, jitter_s, u_deflection)


def estimate_noise(times_ns: ArrayLike, deflection: ArrayLike) -> float:
    """Standard uncertainty of a sample, estimated from the part that no smooth motion explains.

    The estimate is the median of the absolute fifth differences, scaled for Gaussian noise. They are divided
    differences, for which uneven spacing and missing frames do not matter. Slow disturbances do not
    contribute; `TurningPointDetector` finds them in its residuals. If values are rounded so coarsely that
    neighbours are equal, the result is at least the uncertainty of rounding, step / sqrt(12).

    Parameters
    ----------
    times_ns : (n,) int64, ns, ascending
    deflection : (n,) any unit, which is also that of the result; NaN where the spot was lost

    Raises
    ------
    DataError
        Lengths differ, there are fewer than seven samples with different times, or all values are equal.
    """
    times, values, _ = _usable(times_ns, deflection)
    if len(values) < _DIFFERENCE_ORDER + 2:
        raise DataError(
            f"{len(values)} samples with a deflection and times of their own are too few to estimate noise: "
            f"at least {_DIFFERENCE_ORDER + 2} are needed"
        )
    steps = np.abs(np.diff(values))
    if not np.any(steps > 0):
        raise DataError(
            f"all {len(values)} samples are {values[0]:g}: nothing moves, and there is no noise either"
        )
    rounding = float(steps[steps > 0].min()) / np.sqrt(12.0)
    noise = robust_scatter(_differences(times, values)[0], middle=0.0)
    # the smallest step of values that are not rounded is that of a turning point
    return max(noise, float(rounding)) if np.any(steps == 0) else noise


def _usable(times_ns: ArrayLike, deflection: ArrayLike) -> tuple[Ints, Floats, Ints]:
    """Times and values of the finite samples, one per time, and the times of all samples."""
    times = np.asarray(times_ns, dtype=np.int64)
    values = np.asarray(deflection, dtype=np.float64)
    if times.shape != values.shape or times.ndim != 1:
        raise DataError(f"times and deflections must be of one length: got {times.shape} and {values.shape}")
    is_finite = np.isfinite(values)
    finite_times, values = times[is_finite], values[is_finite]
    is_later = np.diff(finite_times, prepend=finite_times[:1] - 1) > 0
    return finite_times[is_later], values[is_later], times


def _differences(times: Ints, values: Floats) -> tuple[Floats, Floats]:
    """Divided differences, scaled to the scatter of a single sample, and the speeds there per second."""
    windows = np.lib.stride_tricks.sliding_window_view
    t = windows(seconds(times - times[0]), _DIFFERENCE_ORDER + 1)
    y = windows(values, _DIFFERENCE_ORDER + 1)
    intervals = t[:, :, None] - t[:, None, :] + np.eye(_DIFFERENCE_ORDER + 1)
    weights = 1.0 / (intervals / np.abs(intervals).max(axis=(1, 2), keepdims=True)).prod(axis=2)
    differences = (weights * y).sum(axis=1) / np.sqrt((weights**2).sum(axis=1))
    centred_t = t - t.mean(axis=1, keepdims=True)
    return differences, np.abs((centred_t * y).sum(axis=1) / (centred_t**2).sum(axis=1))


_LEARNING_HALF_CYCLES = 63
"""Number of unflagged half-cycles from which the noise is learned."""
_LEARNED_HALF_CYCLES = 15
"""Number of later half-cycles whose median is the learned uncertainty; the last ones of a short run."""


def with_learned_weights(half_cycles: Sequence[HalfCycle]) -> list[HalfCycle]:
    """Copies of the half-cycles; uncertainties of the first ones are at least those learned from them.

    Slow noise, of air or a wandering pointing, and the effect of a drive within a half-cycle (`DrivenWalk`)
    are detected only after some half-cycles. Until then the uncertainties of turning points follow from white
    noise of the samples alone: in a basement they are a tenth of the truth, and would dominate a fit.

    Amplitude and time are treated separately. The time's uncertainty is compared as that of the arc,
    amplitude times time, in which the same noise has the same effect at every amplitude. Noise that is
    larger in the beginning, or learned at once, changes nothing.
    """
    unflagged = [number for number, half_cycle in enumerate(half_cycles) if not half_cycle.flags]
    count = max(0, min(_LEARNING_HALF_CYCLES, len(unflagged) - _LEARNED_HALF_CYCLES))
    if not count:
        return list(half_cycles)
    learned = [half_cycles[number] for number in unflagged[count : count + _LEARNED_HALF_CYCLES]]
    min_u_amplitude = float(np.median([half_cycle.u_amplitude for half_cycle in learned]))
    min_u_arc = float(np.median([half_cycle.u_turn_time_s * half_cycle.amplitude for half_cycle in learned]))
    weighted: list[HalfCycle] = []
    early = set(unflagged[:count])
    for number, half_cycle in enumerate(half_cycles):
        if number in early:
            half_cycle = replace(
                half_cycle,
                u_amplitude=max(half_cycle.u_amplitude, min_u_amplitude),
                u_turn_time_s=max(half_cycle.u_turn_time_s, min_u_arc / half_cycle.amplitude),
            )
        follows = number in early or (number - 1 in early and not half_cycle.flags)
        if weighted and follows and math.isfinite(half_cycle.u_half_period_s):
            u_s = math.hypot(half_cycle.u_turn_time_s, weighted[-1].u_turn_time_s)
            half_cycle = replace(half_cycle, u_half_period_s=u_s)
        weighted.append(half_cycle)
    return weighted
