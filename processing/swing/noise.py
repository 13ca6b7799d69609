"""The samples' noise: estimated from a record, or learned from the residuals of the half-cycles.

Air, a pointing that walks and what a drive does within a half-cycle leave residuals that are slow. In white
noise each cosine of a series over the half-cycle holds the same power; here the slow ones hold more, and
amplitude and time of the turning point, which are slower still, suffer more than the scatter of the samples
tells. What stands at 4 to 6 times the pendulum's frequency is seen; at the frequency itself it cannot be
told from the motion. It is taken to rise like 1/f from there.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.noise_models import robust_scatter
from processing.swing.half_cycle_fit import HalfCycleFit
from processing.swing.swing import HalfCycle
from processing.units import seconds

_MEMORY = 15
"""Number of half-cycles whose median reduced chi-square gives the factor on the samples' uncertainties."""
_SLOW_MEMORY = 63
"""Their median is known to 0.13, so that noise counts as slow from 1.8 times the power of white noise on."""
_MEDIAN = 0.789
"""Median of a chi-square of three degrees of freedom, per degree."""
_SPREAD = 1.02
"""Standard deviation of the median of m such values, times sqrt(m)."""
_SIGNIFICANT = 6.0
"""Standard deviations of the median: it is looked at after every half-cycle of runs of thousands."""
_RISE = 4.0
"""Power at 1.25 times the pendulum's frequency, about where turning points take it up, relative to that at
five times, in noise of 1/f."""
_CENTRE_RISE = 9.0
"""The same at half the frequency, about where the centre takes it up."""


class NoiseLevel(NamedTuple):
    """Noise of the samples in units of their stated uncertainties.

    `scale` is the factor on them, `colour` a further one on what follows for turning points, and `amplitude`
    one more on amplitudes, in which the centre's error stands as well. `concentration` is the power of the
    slow residuals relative to white ones: so many times fewer are independent.
    """

    scale: float
    colour: float = 1.0
    amplitude: float = 1.0
    concentration: float = 1.0

    @property
    def effective(self) -> float:
        """Factor on the samples' uncertainties with which white noise would harm turning points as much."""
        return self.scale * self.colour


class SampleNoise:
    """Learns the noise, half-cycle by half-cycle."""

    def __init__(self, scale: float) -> None:
        self.level = NoiseLevel(scale)
        self._ratios: deque[float] = deque([scale**2] * _MEMORY, maxlen=_MEMORY)
        self._slow: deque[float] = deque(maxlen=_SLOW_MEMORY)

    def learn(self, result: HalfCycleFit) -> None:
        """Take in one more half-cycle without gaps."""
        degrees = max(result.samples - 2, 1)
        self._ratios.append(result.chi2 / degrees)
        median = sorted(self._ratios)[_MEMORY // 2]
        scatter = 1.25 * math.sqrt(2.0 / degrees / _MEMORY)
        scale = math.sqrt(median) if median > 1.0 + 4.0 * scatter else 1.0
        self.level = NoiseLevel(scale, *self._colour(scale, result))

    def _colour(self, scale: float, result: HalfCycleFit) -> tuple[float, float, float]:
        if math.isfinite(result.slow):
            self._slow.append(result.slow)
        count = len(self._slow)
        if not count:
            return 1.0, 1.0, 1.0
        power = sorted(self._slow)[count // 2] / (_MEDIAN * scale**2)
        if power < 1.0 + _SIGNIFICANT * _SPREAD / math.sqrt(count):
            return 1.0, 1.0, 1.0
        colour, amplitude = (math.sqrt(1.0 + rise * (power - 1.0)) for rise in (_RISE, _CENTRE_RISE))
        return colour, amplitude / colour, power


_BINS = 8
"""Of speeds, over which the scatter is compared."""
_FEWEST = 24
"""Differences in a bin."""
_LEAST = 1e-3
"""Of the scatter of the differences, squared, that expected of a bin at least."""
_SAME_SPEED = 0.99
"""Of the mean square speed of the fastest differences, that of the slowest where they do not differ."""
_ORDER = 5
"""Order of the differences; of a sinusoid sampled 20 times per period they leave less than 1e-3."""


class SampleScatter(NamedTuple):
    """What no smooth motion explains: noise of the position, and jitter of the times (0: none is seen).

    `u_deflection` (n,) holds both: a time that is off by d moves a sample by d times its speed.
    """

    noise: float
    jitter_s: float
    u_deflection: Floats


def estimate_scatter(times_ns: ArrayLike, deflection: ArrayLike) -> SampleScatter:
    """Noise of the samples, and how far their times are off, as stamps of a busy host are.

    The fifth differences of `estimate_noise` scatter more where the motion is fast if times jitter. Those of
    a motion with few samples a period are larger there, too, but neighbours do not alternate then as those of
    noise do. Raises as `estimate_noise` does.
    """
    noise = estimate_noise(times_ns, deflection)
    times, values, good = _usable(times_ns, deflection)
    left, speed = _differences(times, values)
    order = np.argsort(speed)
    bins = [part for part in np.array_split(order, _BINS) if len(part) >= _FEWEST]
    none = SampleScatter(noise, 0.0, np.full(len(good), noise))
    if len(bins) < _BINS:
        return none
    fast = np.sort(order[len(order) // 2 :])
    fast = fast[fast + 1 < len(left)]
    alternates = float(np.median(np.sign(left[fast] * left[fast + 1])))
    found2 = np.array([robust_scatter(left[part], middle=0.0) ** 2 for part in bins])
    speed2 = np.array([np.mean(speed[part] ** 2) for part in bins])
    # that of a sensor with few digits is zero in some of the bins
    least2 = _LEAST * float(np.median(found2))
    if not (least2 > 0 and speed2[0] < _SAME_SPEED * speed2[-1]):
        # a sensor that stands still, a motion without swings
        return none
    size = np.array([len(part) for part in bins])
    terms = np.column_stack([np.ones(_BINS), speed2 / speed2[-1]])
    expected = np.maximum(found2, least2)
    for _ in range(3):
        # of neighbouring differences one in six is new
        weight = np.sqrt(size / 6.0 / 2.0) / expected
        covariance = np.linalg.inv((terms * weight[:, None]).T @ (terms * weight[:, None]))
        line = covariance @ (terms.T @ (weight**2 * found2))
        expected = np.maximum(terms @ line, np.maximum(_LEAST * found2, least2))
    steady2, moving2 = float(max(line[0], 0.0)), float(line[1])
    if alternates > 0 or not moving2 > _SIGNIFICANT * float(np.sqrt(covariance[1, 1])):
        return none
    jitter_s = float(np.sqrt(moving2 / speed2[-1]))
    every = np.interp(
        np.asarray(times_ns, dtype=np.float64), times[: len(speed)] + 0.5 * (times[_ORDER] - times[0]), speed
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
    if len(values) < _ORDER + 2:
        raise DataError(
            f"{len(values)} samples with a deflection and times of their own are too few to estimate noise: "
            f"at least {_ORDER + 2} are needed"
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
    """Times and values that are there, at times of their own, and all times."""
    times = np.asarray(times_ns, dtype=np.int64)
    values = np.asarray(deflection, dtype=np.float64)
    if times.shape != values.shape or times.ndim != 1:
        raise DataError(f"times and deflections must be of one length: got {times.shape} and {values.shape}")
    good = np.isfinite(values)
    kept, values = times[good], values[good]
    fresh = np.append(True, np.diff(kept) > 0) if len(kept) else good[:0]
    return kept[fresh], values[fresh], times


def _differences(times: Ints, values: Floats) -> tuple[Floats, Floats]:
    """Divided differences as single samples scatter, and the speeds there per second."""
    windows = np.lib.stride_tricks.sliding_window_view
    t = windows(seconds(times - times[0]), _ORDER + 1)
    y = windows(values, _ORDER + 1)
    apart = t[:, :, None] - t[:, None, :] + np.eye(_ORDER + 1)
    weights = 1.0 / (apart / np.abs(apart).max(axis=(1, 2), keepdims=True)).prod(axis=2)
    left = (weights * y).sum(axis=1) / np.sqrt((weights**2).sum(axis=1))
    middle = t - t.mean(axis=1, keepdims=True)
    return left, np.abs((middle * y).sum(axis=1) / (middle**2).sum(axis=1))


_LEARNED = 63
"""Half-cycles without a flag after which the noise counts as learned: so many it is learned from."""
_KNOWING = 15
"""Number of half-cycles whose median says what was learned; the last ones, where there are no later."""


def with_learned_weights(swings: Sequence[HalfCycle]) -> list[HalfCycle]:
    """The half-cycles, with uncertainties of the first ones that are no smaller than those learned from them.

    Slow noise, of air or a pointing that walks, and what a drive does within a half-cycle (`driven_walk`) are
    seen only after some half-cycles. Until then turning points stand with what white noise of the samples
    leaves them, a tenth of what is true in a basement, and a fit would hang on the first ones. What a
    half-cycle says is known live stays; a fit, which comes later, knows better.

    Amplitude and time count apart. The time's uncertainty is compared as that of the arc, amplitude times
    time, which the same noise leaves at every amplitude. Noise that is smaller in the beginning, or learned
    at once, changes nothing.
    """
    good = [number for number, swing in enumerate(swings) if not swing.flags]
    first = max(0, min(_LEARNED, len(good) - _KNOWING))
    knowing = [swings[number] for number in good[first : first + _KNOWING]]
    if not first:
        return list(swings)
    least = float(np.median([swing.u_amplitude for swing in knowing]))
    least_arc = float(np.median([swing.u_turn_time_s * swing.amplitude for swing in knowing]))
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


_FEWEST_SWINGS = 8
_PERIODS = 20
"""Length of a segment in periods; the resolution is the reciprocal."""
_UNEVEN = 1.5
"""Longest interval between samples, in median ones, that does not end a stretch."""
_FROM = 2.2
"""Lowest frequency of the spectrum, in those of the pendulum."""
_HARMONIC = 0.15
"""Distance from odd harmonics, in frequencies of the pendulum, that is left out."""


@dataclass(frozen=True, slots=True)
class ResidualSpectrum:
    """Power spectral density, one-sided, of what is left of the deflection.

    Attributes
    ----------
    frequency_hz, density
        (n,) frequencies from 2.2 times the pendulum's on, without its odd harmonics up to the seventh;
        densities in the squared unit of the deflection per Hz.
    relative_u
        Relative standard uncertainty of each density.
    pendulum_hz
        Frequency of the pendulum.
    """

    frequency_hz: Floats
    density: Floats
    relative_u: float
    pendulum_hz: float


def residual_spectrum(times_ns: Ints, deflection: Floats, swings: Sequence[HalfCycle]) -> ResidualSpectrum:
    """Spectrum of the samples between the first and the last good turning point.

    Samples may be missing or NaN: the spectrum is the mean over stretches without gaps.

    Raises
    ------
    DataError
        Fewer than eight good half-cycles, too few samples per period, or no stretch of twenty periods
        without a gap.
    """
    # imported here, since every command imports this module and few draw a spectrum
    from scipy.interpolate import CubicSpline

    good = [swing for swing in swings if not swing.flags]
    if len(good) < _FEWEST_SWINGS:
        raise DataError(f"{len(good)} good half-cycles: a spectrum needs {_FEWEST_SWINGS}")
    origin_ns = good[0].turn_time_ns
    turn_s = seconds(np.array([swing.turn_time_ns - origin_ns for swing in good]))
    phase = np.pi * np.array([swing.index - good[0].index for swing in good])
    period_s = float(2 * np.pi * (turn_s[-1] - turn_s[0]) / phase[-1])
    seen = np.isfinite(deflection) & (times_ns >= origin_ns) & (times_ns <= good[-1].turn_time_ns)
    time_s = seconds(times_ns[seen] - origin_ns)
    swing = CubicSpline(turn_s, [one.amplitude for one in good])(time_s)
    swing *= good[0].side * np.cos(CubicSpline(turn_s, phase)(time_s))
    residual = deflection[seen] - swing - CubicSpline(turn_s, [one.centre for one in good])(time_s)
    step_s = float(np.median(np.diff(time_s)))
    length = round(_PERIODS * period_s / step_s)
    if period_s / step_s < 4 * _FROM:
        raise DataError(f"{period_s / step_s:.1f} samples a period are too few for a spectrum")
    total, segments = np.zeros(length // 2 + 1), 0
    for part in np.split(residual, np.flatnonzero(np.diff(time_s) > _UNEVEN * step_s) + 1):
        if len(part) >= length:
            powers = segment_powers(part, length)
            total += powers.sum(axis=0) * step_s
            segments += len(powers)
    if not segments:
        raise DataError(f"no {_PERIODS} periods without a gap: no spectrum")
    frequency_hz = np.arange(length // 2 + 1) / (length * step_s)
    relative = frequency_hz * period_s
    kept = (relative > _FROM) & (relative < 0.5 * period_s / step_s)
    for harmonic in (3, 5, 7):
        kept &= abs(relative - harmonic) > _HARMONIC
    return ResidualSpectrum(
        frequency_hz[kept],
        np.asarray(total[kept] / segments),
        # half-overlapping Hann windows are worth 9/11 independent ones
        float(np.sqrt(11 / (9 * segments))),
        1 / period_s,
    )


def segment_powers(samples: Floats, length: int) -> Floats:
    """One-sided power densities of half-overlapping segments after Welch, each less its mean, Hann's window.

    Parameters
    ----------
    samples
        Even samples, at least `length` of them.
    length
        Samples of a segment.

    Returns
    -------
    array (segments, length // 2 + 1)
        In squared units of the samples at a rate of 1/s; times the step between samples it is per Hz.
    """
    # not scipy.signal: its import alone takes as long as all others of a fit together
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    starts = np.arange(0, len(samples) - length + 1, length - length // 2)
    segments = samples[starts[:, np.newaxis] + np.arange(length)]
    centred = segments - segments.mean(axis=1, keepdims=True)
    powers = np.abs(np.fft.rfft(centred * window, axis=1)) ** 2 / np.sum(window**2)
    powers[:, 1 : (length + 1) // 2] *= 2.0
    return np.asarray(powers)
