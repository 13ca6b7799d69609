"""Pointing stability of a spot at rest: noise, drift, lines of the spectrum, ISO 11670."""

from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.slope_uncertainty import part_means, u_wandering_slope

_MIN_SAMPLES = 100
_MIN_LINE_RATIO = 12.0
"""Smallest power of a spectral line over that of the noise near it."""
_MAX_LINES = 10


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A significant line of the spectrum."""

    frequency_hz: float
    amplitude: float
    """Amplitude of the sinusoid, in the unit of the record."""
    name: str
    """Probable source ("mains, ..." or "building"); empty if unknown."""


@dataclass(frozen=True, slots=True)
class Stability:
    """Stability of one coordinate of a record at rest, in the unit of the record."""

    noise: float
    """Standard deviation of a sample without slow changes, from the differences of neighbours: the Allan
    deviation (IEEE 1139) at their interval.
    """
    drift_per_s: float
    """Slope of a straight line through the means of equal parts."""
    u_drift_per_s: float
    """Allows for a beam that wanders, as the residuals of the line show (`processing.slope_uncertainty`)."""
    iso11670: float
    """Pointing stability of one axis (ISO 11670:2003): 2 standard deviations of the whole record."""
    claimed_ratio: float
    """Root mean square of the stated uncertainties, over `noise`."""
    lines: tuple[SpectralLine, ...]
    """The strongest spectral lines, at most `_MAX_LINES`."""


def stability(times_s: Floats, values: Floats, u_values: Floats) -> Stability:
    """Noise, drift, spectrum and pointing stability of one coordinate of a record at rest.

    Parameters
    ----------
    times_s : (n,), s, ascending
        Must be evenly spaced, except for lost samples.
    values, u_values : (n,), any unit
        Samples and their standard uncertainties; NaN for lost ones. For the noise, the samples on both sides
        of a gap count as neighbours.

    Raises
    ------
    DataError
        Fewer samples than `_MIN_SAMPLES`.
    """
    good = np.isfinite(values) & np.isfinite(u_values)
    times_s, values, u_values = times_s[good], values[good], u_values[good]
    if len(values) < _MIN_SAMPLES:
        raise DataError(
            f"stability: {len(values)} spots of {_MIN_SAMPLES} that are needed; record for longer"
        )
    since_s = times_s - times_s.mean()
    design, means = part_means(np.column_stack([since_s, np.ones(len(since_s))])), part_means(values)
    line, *_ = np.linalg.lstsq(design, means, rcond=None)
    detrended = values - np.polyval(np.polyfit(times_s - times_s[0], values, 1), times_s - times_s[0])
    noise = float(np.sqrt(0.5 * np.mean(np.diff(values) ** 2)))
    return Stability(
        noise=noise,
        drift_per_s=float(line[0]),
        u_drift_per_s=u_wandering_slope(design, means - design @ line),
        iso11670=float(2.0 * values.std(ddof=1)),
        claimed_ratio=float(np.sqrt(np.mean(u_values**2)) / noise),
        lines=_lines(*_spectrum(times_s, detrended)),
    )


def _spectrum(times_s: Floats, detrended: Floats) -> tuple[Floats, Floats]:
    """Frequencies above zero and one-sided power spectral density, with a Hann window. Lost samples count as
    0; if they were left out, lines would be at wrong frequencies."""
    interval_s = float(np.median(np.diff(times_s)))
    steps = np.maximum(np.rint(np.diff(times_s) / interval_s), 1.0).astype(np.int64)
    index = np.concatenate([[0], np.cumsum(steps)])
    count = int(index[-1]) + 1
    window, uniform = np.hanning(count), np.zeros(count)
    uniform[index] = detrended
    power = np.abs(np.fft.rfft(uniform * window)) ** 2
    density = 2.0 * power * interval_s / np.sum(window[index] ** 2)
    return np.fft.rfftfreq(count, interval_s)[1:].astype(np.float64), density[1:].astype(np.float64)


def _lines(frequency: Floats, density: Floats) -> tuple[SpectralLine, ...]:
    """Peaks well above the noise, which is the running median of the spectrum; the strongest first."""
    width = max(15, len(density) // 50) | 1
    padded = np.pad(density, width // 2, mode="reflect")
    # the power of noise is exponentially distributed, so its median is ln 2 times its mean
    floor = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1) / np.log(2.0)
    threshold = max(_MIN_LINE_RATIO, np.log(len(density)) + 7.0)
    peaks = [
        i
        for i in range(1, len(density) - 1)
        if density[i] > threshold * floor[i] and density[i] >= density[i - 1] and density[i] > density[i + 1]
    ]
    step_hz = float(frequency[1] - frequency[0])
    lines = []
    for i in peaks:
        power, frequency_hz = float(np.sum(density[i - 1 : i + 2])) * step_hz, float(frequency[i])
        lines.append(SpectralLine(frequency_hz, float(np.sqrt(2.0 * power)), _name(frequency_hz)))
    return tuple(sorted(lines, key=lambda line: -line.amplitude)[:_MAX_LINES])


def _name(frequency_hz: float) -> str:
    """Probable source of a line: a multiple of the mains frequency, or 5 to 30 Hz of the building."""
    for mains_hz in (50.0, 60.0):
        harmonic = round(frequency_hz / mains_hz)
        if harmonic >= 1 and abs(frequency_hz - harmonic * mains_hz) < 0.3:
            return f"mains, {harmonic} x {mains_hz:g} Hz"
    return "building" if 5.0 <= frequency_hz <= 30.0 else ""
