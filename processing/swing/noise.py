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
from processing.swing.swing import HalfCycle
from processing.units import seconds

_MEMORY_HALF_CYCLES = 15
"""Number of half-cycles whose median reduced chi-square gives the factor on the samples' uncertainties."""
_SLOW_MEMORY = 63
"""Number of half-cycles whose median slow power is used. It is known to 0.13, so that noise counts as slow
from 1.8 times the power of white noise on."""
_CHI2_MEDIAN = 0.789
"""Median of a chi-square of three degrees of freedom, per degree."""
_MEDIAN_SPREAD = 1.02
"""Standard deviation of the median of m such values, multiplied by sqrt(m)."""
_SIGNIFICANT_STD = 6.0
"""Significance in standard deviations; high, because a run tests after each of thousands of half-cycles."""
_NOISE_POWER_RISE = 4.0
"""Power of 1/f noise at 1.25 times the pendulum's frequency (about that of turning points) over 5 times."""
_CENTRE_RISE = 9.0
"""The same ratio for half the frequency, to which the centre is about sensitive."""


class NoiseLevel(NamedTuple):
    """Noise of the samples in units of their stated uncertainties, as factors."""

    scale: float
    """Factor on the samples' uncertainties."""
    colour: float = 1.0
    """Further factor on the uncertainties of turning points, for slow noise."""
    amplitude: float = 1.0
    """Further factor on those of amplitudes, which contain the centre's error as well."""
    concentration: float = 1.0
    """Power of the slow residuals relative to white ones; the number of independent ones is divided by it."""

    @property
    def effective(self) -> float:
        """Factor on the samples' uncertainties for white noise of the same effect on turning points."""
        return self.scale * self.colour


class SampleNoise:
    """Estimate of the noise, updated by every half-cycle; `level` is the present one."""

    def __init__(self, scale: float) -> None:
        self.level = NoiseLevel(scale)
        self._ratios: deque[float] = deque([scale**2] * _MEMORY_HALF_CYCLES, maxlen=_MEMORY_HALF_CYCLES)
        self._slow: deque[float] = deque(maxlen=_SLOW_MEMORY)

    def learn(self, result: HalfCycleFit) -> None:
        """Add one more half-cycle without gaps."""
        degrees = max(result.samples - 2, 1)
        self._ratios.append(result.chi2 / degrees)
        median = sorted(self._ratios)[_MEMORY_HALF_CYCLES // 2]
        scatter = 1.25 * math.sqrt(2.0 / degrees / _MEMORY_HALF_CYCLES)
        scale = math.sqrt(median) if median > 1.0 + 4.0 * scatter else 1.0
        self.level = NoiseLevel(scale, *self._colour(scale, result))

    def _colour(self, scale: float, result: HalfCycleFit) -> tuple[float, float, float]:
        if math.isfinite(result.slow):
            self._slow.append(result.slow)
        count = len(self._slow)
        if not count:
            return 1.0, 1.0, 1.0
        power = sorted(self._slow)[count // 2] / (_CHI2_MEDIAN * scale**2)
        if power < 1.0 + _SIGNIFICANT_STD * _MEDIAN_SPREAD / math.sqrt(count):
            return 1.0, 1.0, 1.0
        colour, amplitude = (
            math.sqrt(1.0 + rise * (power - 1.0)) for rise in (_NOISE_POWER_RISE, _CENTRE_RISE)
        )
        return colour, amplitude / colour, power


_SPEED_BINS = 8
"""Number of bins of speed, over which the scatter is compared."""
_FEWEST_DIFFERENCES = 24
"""Fewest differences in a bin."""
_SMALLEST_VARIANCE_RATIO = 1e-3
"""Smallest expected variance of a bin, relative to the median variance of the differences."""
_LARGEST_SPEED_RATIO = 0.99
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
    """(n,) uncertainty from both: an error d of its time moves a sample by d times its speed."""


def estimate_scatter(times_ns: ArrayLike, deflection: ArrayLike) -> SampleScatter:
    """Noise of the samples, and jitter of their times, as in time stamps of a busy host.

    If times jitter, the fifth differences of `estimate_noise` scatter more where the motion is fast. In a
    motion with few samples per period they are larger there, too, but then neighbours do not alternate in
    sign as those of noise do. Errors as of `estimate_noise`.
    """
    noise = estimate_noise(times_ns, deflection)
    times, values, good = _usable(times_ns, deflection)
    left, speed = _differences(times, values)
    order = np.argsort(speed)
    bins = [part for part in np.array_split(order, _SPEED_BINS) if len(part) >= _FEWEST_DIFFERENCES]
    none = SampleScatter(noise, 0.0, np.full(len(good), noise))
    if len(bins) < _SPEED_BINS:
        return none
    fast = np.sort(order[len(order) // 2 :])
    fast = fast[fast + 1 < len(left)]
    alternates = float(np.median(np.sign(left[fast] * left[fast + 1])))
    found2 = np.array([robust_scatter(left[part], middle=0.0) ** 2 for part in bins])
    speed2 = np.array([np.mean(speed[part] ** 2) for part in bins])
    # the scatter of a sensor with few digits is zero in some of the bins
    least2 = _SMALLEST_VARIANCE_RATIO * float(np.median(found2))
    if not (least2 > 0 and speed2[0] < _LARGEST_SPEED_RATIO * speed2[-1]):
        # the sensor stands still, or the motion does not oscillate
        return none
    size = np.array([len(part) for part in bins])
    terms = np.column_stack([np.ones(_SPEED_BINS), speed2 / speed2[-1]])
    expected = np.maximum(found2, least2)
    for _ in range(3):
        # fifth differences share samples: one in six neighbours is independent
        weight = np.sqrt(size / 6.0 / 2.0) / expected
        covariance = np.linalg.inv((terms * weight[:, None]).T @ (terms * weight[:, None]))
        line = covariance @ (terms.T @ (weight**2 * found2))
        expected = np.maximum(terms @ line, np.maximum(_SMALLEST_VARIANCE_RATIO * found2, least2))
    steady2, moving2 = float(max(line[0], 0.0)), float(line[1])
    if alternates > 0 or not moving2 > _SIGNIFICANT_STD * float(np.sqrt(covariance[1, 1])):
        return none
    jitter_s = float(np.sqrt(moving2 / speed2[-1]))
    every = np.interp(
        np.asarray(times_ns, dtype=np.float64),
        times[: len(speed)] + 0.5 * (times[_DIFFERENCE_ORDER] - times[0]),
        speed,
    )
    return SampleScatter(noise, jitter_s, np.sqrt(steady2 + (jitter_s * every) ** 2))


def estimate_noise(times_ns: ArrayLike, deflection: ArrayLike) -> float:
    """Standard uncertainty of a sample, estimated from the part that no smooth motion explains.

    It is the median of the absolute fifth differences, scaled for Gaussian noise. Divided differences are
    used, so that uneven spacing and missing frames do not matter. Slow disturbances do not contribute;
    `TurningPointDetector` finds them in its residuals. If the values are rounded so coarsely that most
    differences vanish, the result is the uncertainty of rounding, step / sqrt(12).

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
    good = np.isfinite(values)
    kept, values = times[good], values[good]
    fresh = np.append(True, np.diff(kept) > 0) if len(kept) else good[:0]
    return kept[fresh], values[fresh], times


def _differences(times: Ints, values: Floats) -> tuple[Floats, Floats]:
    """Divided differences, scaled to the scatter of a single sample, and the speeds there per second."""
    windows = np.lib.stride_tricks.sliding_window_view
    t = windows(seconds(times - times[0]), _DIFFERENCE_ORDER + 1)
    y = windows(values, _DIFFERENCE_ORDER + 1)
    apart = t[:, :, None] - t[:, None, :] + np.eye(_DIFFERENCE_ORDER + 1)
    weights = 1.0 / (apart / np.abs(apart).max(axis=(1, 2), keepdims=True)).prod(axis=2)
    left = (weights * y).sum(axis=1) / np.sqrt((weights**2).sum(axis=1))
    middle = t - t.mean(axis=1, keepdims=True)
    return left, np.abs((middle * y).sum(axis=1) / (middle**2).sum(axis=1))


_LEARNING_HALF_CYCLES = 63
"""Number of unflagged half-cycles from which the noise is learned."""
_LEARNED_HALF_CYCLES = 15
"""Number of later half-cycles whose median is the learned uncertainty; the last ones of a short run."""


def with_learned_weights(swings: Sequence[HalfCycle]) -> list[HalfCycle]:
    """The half-cycles, with uncertainties of the first ones at least as large as those learned from them.

    Slow noise, of air or a wandering pointing, and the effect of a drive within a half-cycle (`DrivenWalk`)
    are detected only after some half-cycles. Until then the uncertainties of turning points follow from white
    noise of the samples alone, a tenth of the truth in a basement, and the first ones would dominate a fit.
    Half-cycles of the live measurement are not changed; this is for a fit, which comes later.

    Amplitude and time are treated separately. The time's uncertainty is compared as that of the arc,
    amplitude times time, in which the same noise has the same effect at every amplitude. Noise that is
    smaller in the beginning, or learned at once, changes nothing.
    """
    good = [number for number, swing in enumerate(swings) if not swing.flags]
    first = max(0, min(_LEARNING_HALF_CYCLES, len(good) - _LEARNED_HALF_CYCLES))
    learned = [swings[number] for number in good[first : first + _LEARNED_HALF_CYCLES]]
    if not first:
        return list(swings)
    least = float(np.median([swing.u_amplitude for swing in learned]))
    least_arc = float(np.median([swing.u_turn_time_s * swing.amplitude for swing in learned]))
    out: list[HalfCycle] = []
    early = set(good[:first])
    for number, swing in enumerate(swings):
        if number in early:
            swing = replace(
                swing,
                u_amplitude=max(swing.u_amplitude, least),
                u_turn_time_s=max(swing.u_turn_time_s, least_arc / swing.amplitude),
            )
        follows = number in early or (number - 1 in early and not swing.flags)
        if out and follows and math.isfinite(swing.u_half_period_s):
            swing = replace(swing, u_half_period_s=math.hypot(swing.u_turn_time_s, out[-1].u_turn_time_s))
        out.append(swing)
    return out
