"""The strongest oscillation in the samples of one coordinate, and a check that the pendulum is at rest."""

import math
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Least-squares fit of one sinusoid, whose amplitude changes linearly in time, about a straight line.

    `amplitude` (at the middle of the samples), `noise` (standard deviation of the residuals) and `rest` (n,),
    the residuals, have the unit of the samples. `explained` is the fraction of the variance about a line that
    the sinusoid explains.
    """

    period_s: float
    amplitude: float
    noise: float
    explained: float
    rest: Floats


def strongest_oscillation(times_s: Floats, values: Floats, longest_s: float) -> Oscillation:
    """Fit the sinusoid of the highest peak of the spectrum.

    Parameters
    ----------
    times_s : (n,), s, ascending
    values : (n,), any unit
        Samples of one coordinate; no NaN.
    longest_s
        Longest period that is considered, s.
    """
    from scipy.optimize import minimize_scalar

    count = len(times_s)
    span_s = float(times_s[-1] - times_s[0])
    even = np.interp(np.linspace(times_s[0], times_s[-1], count), times_s, values)
    even = even - np.polyval(np.polyfit(np.arange(count), even, 1), np.arange(count))
    power = np.abs(np.fft.rfft(even * np.hanning(count), 8 * count)) ** 2
    frequency = np.fft.rfftfreq(8 * count, span_s / (count - 1))
    top = int(np.argmax(np.where(frequency >= 1.0 / longest_s, power, -1.0)))
    half_line = 0.5 / span_s
    found = minimize_scalar(
        lambda f: float(np.sum(_left(times_s, values, f)[0] ** 2)),
        bounds=(max(frequency[top] - half_line, 0.1 / span_s), frequency[top] + half_line),
        method="bounded",
        options={"xatol": 1e-7 / span_s},
    )
    rest, amplitude = _left(times_s, values, float(found.x))
    flat = float(np.var(even))
    noise = math.sqrt(float(rest @ rest) / max(count - 7, 1))
    return Oscillation(1.0 / float(found.x), amplitude, noise, 1.0 - noise**2 / max(flat, 1e-300), rest)


def _left(times_s: Floats, values: Floats, frequency_hz: float) -> tuple[Floats, float]:
    """Residuals of the linear fit at this frequency, and the amplitude."""
    phase = 2.0 * math.pi * frequency_hz * (times_s - times_s[0])
    u = (times_s - times_s[0]) / (times_s[-1] - times_s[0]) - 0.5
    cosine, sine = np.cos(phase), np.sin(phase)
    design = np.column_stack([cosine, sine, u * cosine, u * sine, np.ones_like(u), u])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    return values - design @ solution, float(np.hypot(solution[0], solution[1]))


_VISIBLE_PX = 0.05
"""Smallest amplitude of a swing that is rejected; the limits below must be exceeded too."""
_TIMES_NOISE = 3.0
"""Smallest amplitude relative to the standard deviation of the residuals."""


def require_rest(times_s: Floats, x_px: Floats, y_px: Floats, what: str) -> None:
    """Check that the pendulum does not swing in a record.

    It swings if, after subtraction of a straight line, a sinusoid with a period above 0.2 s explains more
    than half of the variance of a coordinate, with an amplitude above 0.05 px and above three times the
    standard deviation of the residuals.

    Parameters
    ----------
    times_s : (n,), s, ascending
    x_px, y_px : (n,), px
        Positions of the spot; no NaN.
    what
        The record as it is named at the beginning of the message.

    Raises
    ------
    DataError
        The pendulum swings.
    """
    for name, values in (("x", x_px), ("y", y_px)):
        line = np.polyval(np.polyfit(times_s - times_s[0], values, 1), times_s - times_s[0])
        flat = values - line
        fit = strongest_oscillation(times_s, flat, float(times_s[-1] - times_s[0]))
        loud = fit.amplitude > max(_VISIBLE_PX, _TIMES_NOISE * fit.noise)
        if loud and fit.explained > 0.5 and fit.period_s > 0.2:
            raise DataError(
                f"{what}: the pendulum swings by {fit.amplitude:.3g} px in {name} with a period of "
                f"{fit.period_s:.3g} s where it should rest; clamp it or let it come to rest"
            )
