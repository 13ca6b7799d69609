"""What the samples hold besides the swing: the spectrum of air, ground and sensor outside the two modes.

The swing that is taken off runs through the turning points: amplitude, centre and phase between them are
cubic splines, the phase rising by pi from one to the next. Whatever changes more slowly than that, within
one frequency of the pendulum from its own, goes with the swing and is not in the spectrum, and at its
harmonics stand the departures of the waveform from a sinusoid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.swing.swing import Swing
from processing.units import seconds

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


def residual_spectrum(times_ns: Ints, deflection: Floats, swings: Sequence[Swing]) -> ResidualSpectrum:
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
