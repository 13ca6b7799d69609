"""Directions of both modes on the sensor, from the spots of one time window of a record."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.errors import DataError

_ENVELOPE_TERMS = 3
"""Number of polynomial terms in time (a parabola) of each mode's cosine and sine amplitude."""

_MAX_OVERTONES = (0.15, 0.08, 0.05)
"""Largest fifth, seventh and ninth harmonic, as fractions of the third."""


@dataclass(frozen=True, slots=True)
class WindowDirections:
    """Directions of the modes in one time window.

    `slow` and `fast` are vectors (x, y) on the sensor in px. The length is the mode's amplitude at the
    beginning of the window, the sign that of its cosine at the beginning of the record. `u_` are standard
    uncertainties of their angles.
    """

    middle_s: float
    slow: Floats
    u_slow_rad: float
    fast: Floats
    u_fast_rad: float


def window_directions(
    t: Floats, spots: Floats, slow_omega: float, fast_omega: float, start_s: float
) -> WindowDirections:
    """Fit both modes to both coordinates, each with an amplitude and a phase that vary slowly.

    Parameters
    ----------
    t : (n,), s
        Times of the samples.
    spots : (n, 2), px
        Positions (x, y) on the sensor; no NaN.
    slow_omega, fast_omega
        Angular frequencies in rad/s. Small errors are compensated by the slowly varying phases.
    start_s
        Time at which the sign of each vector is that of its mode's deflection.

    Notes
    -----
    Each coordinate is a linear least-squares fit of ``(a_0 + a_1 u + a_2 u^2) cos(omega t)`` and the same
    with the sine, for both modes, and of a parabola, with u = -1 to 1 over the window.
    """
    middle = 0.5 * (t[0] + t[-1])
    half = 0.5 * (t[-1] - t[0])
    u = (t - middle) / half
    slow_c, slow_s = np.cos(slow_omega * (t - start_s)), np.sin(slow_omega * (t - start_s))
    fast_c, fast_s = np.cos(fast_omega * (t - start_s)), np.sin(fast_omega * (t - start_s))
    design = np.column_stack(
        [
            *(slow_c * u**k for k in range(_ENVELOPE_TERMS)),
            *(slow_s * u**k for k in range(_ENVELOPE_TERMS)),
            *(fast_c * u**k for k in range(_ENVELOPE_TERMS)),
            *(fast_s * u**k for k in range(_ENVELOPE_TERMS)),
            *(u**k for k in range(_ENVELOPE_TERMS)),
        ]
    )
    coefficients, *_ = np.linalg.lstsq(design, spots, rcond=None)
    frame = _frame(coefficients[[0, _ENVELOPE_TERMS]])
    covariance = _noise(spots - design @ coefficients, design)
    slow_columns, fast_columns = (
        list(range(2 * _ENVELOPE_TERMS)),
        list(range(2 * _ENVELOPE_TERMS, 4 * _ENVELOPE_TERMS)),
    )
    inverse = np.linalg.inv(design.T @ design)
    # overtones of the slow mode move the spot along the slow direction only, and only the fast mode across it
    across, along = (spots @ frame).T
    swing = _swing(design, coefficients @ frame[:, 1])
    along_rows, along_covariance, overtones = _with_overtones(
        design, along, swing, overtone_3=fast_omega > 4.0 * slow_omega
    )
    clean = spots - np.outer(overtones, frame[:, 1])
    coefficients, *_ = np.linalg.lstsq(design, clean, rcond=None)
    covariance = _noise(clean - design @ coefficients, design)
    slow, u_slow = _direction(coefficients, inverse, covariance, slow_columns)
    across_rows, *_ = np.linalg.lstsq(design, across, rcond=None)
    noise_across = float(frame[:, 0] @ covariance @ frame[:, 0])
    fast, u_fast = _fast_direction(
        across_rows[fast_columns],
        noise_across * inverse[np.ix_(fast_columns, fast_columns)],
        along_rows[fast_columns],
        along_covariance[np.ix_(fast_columns, fast_columns)],
        frame,
    )
    return WindowDirections(float(middle), slow, u_slow, fast, u_fast)


def _noise(residual: Floats, design: Floats) -> Floats:
    """Covariance (2, 2) of the noise of x and y, from the residuals."""
    covariance: Floats = residual.T @ residual / (design.shape[0] - design.shape[1])
    return covariance


def _frame(rows: Floats) -> Floats:
    """Matrix (2, 2) whose columns are unit vectors across and along the direction of the largest motion."""
    _, vectors = np.linalg.eigh(rows.T @ rows)
    along = vectors[:, 1]
    return np.column_stack([[-along[1], along[0]], along])


def _swing(design: Floats, along: Floats) -> NDArray[np.complex128]:
    """Unit phasor of the slow mode at each sample, with its slowly varying phase."""
    u = design[:, 4 * _ENVELOPE_TERMS + 1]
    powers = np.column_stack([u**k for k in range(_ENVELOPE_TERMS)])
    c, s = powers @ along[:_ENVELOPE_TERMS], powers @ along[_ENVELOPE_TERMS : 2 * _ENVELOPE_TERMS]
    phasor = (c - 1j * s) * (design[:, 0] + 1j * design[:, _ENVELOPE_TERMS])
    unit: NDArray[np.complex128] = phasor / np.abs(phasor)
    return unit


def _with_overtones(
    design: Floats, along: Floats, swing: NDArray[np.complex128], *, overtone_3: bool
) -> tuple[Floats, Floats, Floats]:
    """Coefficients along the slow direction, their covariance, and the motion due to overtones.

    Friction and elasticity of the contact add odd harmonics to the slow mode. A harmonic near the fast
    mode's frequency would be attributed to the fast mode. The third harmonic is fitted freely, unless the
    fast mode is too near to it (`overtone_3` False), in which case no harmonic is fitted. The third limits
    the higher ones: for moments proportional to powers of the tilt from 0 to 1, the fifth harmonic is 0.11
    to 0.2 of the third, the others less. They are fitted with a normal prior of mean 0 and standard deviation
    `_MAX_OVERTONES` times the third.
    """
    orders = [3, 5, 7, 9] if overtone_3 else []
    columns = [part for k in orders for part in ((swing**k).real, (swing**k).imag)]
    whole = np.column_stack([design, *columns])
    values, *_ = np.linalg.lstsq(whole[:, : design.shape[1] + 2 * bool(orders)], along, rcond=None)
    residual = along - whole[:, : len(values)] @ values
    variance = float(residual @ residual) / (len(along) - len(values))
    prior_precision = np.zeros(whole.shape[1])
    if orders:
        third = float(np.hypot(values[-2], values[-1]))
        for number, part in enumerate(_MAX_OVERTONES):
            at = design.shape[1] + 2 + 2 * number
            prior_precision[at : at + 2] = variance / max(part * third, 1e-12) ** 2
    covariance = np.linalg.inv(whole.T @ whole + np.diag(prior_precision))
    values = covariance @ (whole.T @ along)
    residual = along - whole @ values
    variance = float(residual @ residual) / (len(along) - len(values))
    moved = whole[:, design.shape[1] :] @ values[design.shape[1] :]
    return (
        np.asarray(values, dtype=np.float64),
        np.asarray(variance * covariance, dtype=np.float64),
        np.asarray(moved, dtype=np.float64),
    )


def _fast_direction(
    across: Floats, u2_across: Floats, along: Floats, u2_along: Floats, frame: Floats
) -> tuple[Floats, float]:
    """Vector of the fast mode and the standard uncertainty of its angle.

    Its coefficients along the slow direction are `slope` times those across it; the slope is determined with
    the covariances of both.
    """
    slope = 0.0
    for _ in range(3):
        weight = np.linalg.inv(u2_along + slope**2 * u2_across)
        slope = float(across @ weight @ along) / float(across @ weight @ across)
    u_slope = 1.0 / math.sqrt(float(across @ weight @ across))
    direction = (frame[:, 0] + slope * frame[:, 1]) / math.hypot(1.0, slope)
    size = math.hypot(1.0, slope)
    cosine, sine = _at_beginning(across * size)
    sign = 1.0 if cosine >= 0 else -1.0
    return sign * math.hypot(cosine, sine) * direction, u_slope / (1.0 + slope**2)


def _at_beginning(rows: Floats) -> tuple[float, float]:
    """Cosine and sine amplitude at the beginning of the window, where u = -1."""
    signs = np.array([(-1.0) ** k for k in range(_ENVELOPE_TERMS)])
    return float(rows[:_ENVELOPE_TERMS] @ signs), float(rows[_ENVELOPE_TERMS:] @ signs)


def _direction(
    coefficients: Floats, inverse: Floats, covariance: Floats, columns: list[int]
) -> tuple[Floats, float]:
    """Vector of a mode (see `WindowDirections`) and the standard uncertainty of its angle.

    The coefficient vectors (x, y) of all terms of a mode lie along one line. Its direction is the major
    axis of their weighted scatter: total least squares with the known covariance of the terms.
    """
    rows = coefficients[columns]
    weight = np.linalg.inv(inverse[np.ix_(columns, columns)])
    scatter = rows.T @ weight @ rows
    # noise that differs between directions rotates the major axis, so its expected scatter is subtracted
    _, vectors = np.linalg.eigh(scatter - (len(columns) - 1) * covariance)
    along = vectors[:, 1]
    across = np.array([-along[1], along[0]])
    signal = float(along @ scatter @ along) - float(along @ covariance @ along) * len(columns)
    noise = float(across @ covariance @ across)
    u_angle = math.sqrt(noise / signal) if signal > 0 else math.inf
    cosine, sine = _at_beginning(rows @ along)
    amplitude = math.hypot(cosine, sine)
    sign = 1.0 if cosine >= 0 else -1.0
    return sign * amplitude * along, u_angle


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Least-squares fit of one sinusoid, whose amplitude changes linearly in time, about a straight line.

    `amplitude` (at the middle of the samples), `noise` (standard deviation of the residuals) and `residuals`
    (n,), the residuals, have the unit of the samples. `explained` is the fraction of the variance about a
    line that the sinusoid explains.
    """

    period_s: float
    amplitude: float
    noise: float
    explained: float
    residuals: Floats


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
        lambda f: float(np.sum(_sinusoid_fit(times_s, values, f)[0] ** 2)),
        bounds=(max(frequency[top] - half_line, 0.1 / span_s), frequency[top] + half_line),
        method="bounded",
        options={"xatol": 1e-7 / span_s},
    )
    residuals, amplitude = _sinusoid_fit(times_s, values, float(found.x))
    flat = float(np.var(even))
    noise = math.sqrt(float(residuals @ residuals) / max(count - 7, 1))
    return Oscillation(1.0 / float(found.x), amplitude, noise, 1.0 - noise**2 / max(flat, 1e-300), residuals)


def _sinusoid_fit(times_s: Floats, values: Floats, frequency_hz: float) -> tuple[Floats, float]:
    """Residuals of the linear fit of a sinusoid at this frequency, and its amplitude."""
    phase = 2.0 * math.pi * frequency_hz * (times_s - times_s[0])
    u = (times_s - times_s[0]) / (times_s[-1] - times_s[0]) - 0.5
    cosine, sine = np.cos(phase), np.sin(phase)
    design = np.column_stack([cosine, sine, u * cosine, u * sine, np.ones_like(u), u])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    return values - design @ solution, float(np.hypot(solution[0], solution[1]))


_MIN_SWING_PX = 0.05
"""Smallest amplitude of a swing that is rejected, if it exceeds the limit below, too."""
_MIN_OVER_NOISE = 3.0
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
        loud = fit.amplitude > max(_MIN_SWING_PX, _MIN_OVER_NOISE * fit.noise)
        if loud and fit.explained > 0.5 and fit.period_s > 0.2:
            raise DataError(
                f"{what}: the pendulum swings by {fit.amplitude:.3g} px in {name} with a period of "
                f"{fit.period_s:.3g} s where it should rest; clamp it or let it come to rest"
            )
