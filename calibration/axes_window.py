"""Directions of both modes on the sensor, from the spots of one time window of a record."""

import math
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError

_ENVELOPE_TERMS = 3
"""Number of polynomial terms in time (a parabola) of each mode's cosine and sine amplitude."""
SLOW_DOF = 2 * _ENVELOPE_TERMS - 1
"""Degrees of freedom of the terms of the slow mode about a line."""

_THIRD_STD = 5e-4
"""Prior standard deviation of the third harmonic in phase and in quadrature, as fraction of the amplitude,
where the fast mode is so near that it cannot be fitted freely; 2e-4 to 5e-4 are expected of the contacts.
"""
_OVERTONE_STD = (0.15, 0.08, 0.05)
"""Prior standard deviations of the fifth, seventh and ninth harmonic, in phase and in quadrature, as
fractions of the third.
"""
_SLOPE_ITERATIONS = 5
"""Iterations of the fast direction's slope, by which the variance of its residuals changes."""


@dataclass(frozen=True, slots=True)
class WindowDirections:
    """Directions of the modes in one time window, as vectors (x, y) on the sensor in px.

    The length of a vector is the mode's amplitude at the beginning of the window. Its sign is that of the
    mode's cosine at the beginning of the record. The normal equations have as parameters the angle in rad
    from `fast` to the fast direction, and the slow mode's m overtones in units of their prior standard
    deviations; the prior itself is not included.
    """

    middle_s: float
    slow: Floats
    u_slow_rad: float
    """Standard uncertainty of the angle of `slow`."""
    slow_chi2: float
    """Chi-square (`SLOW_DOF`) of the slow mode's motion across `slow`; large if noise is larger there."""
    fast: Floats
    u_fast_slope: float
    """Standard uncertainty of the direction of `fast`, as a slope."""
    precision: Floats
    """Matrix (1 + m, 1 + m) of the normal equations."""
    score: Floats
    """Right-hand side (1 + m,) of the normal equations."""


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
    Each coordinate is a linear least-squares fit of ``(a_0 + a_1 x + a_2 x^2) cos(omega t)`` and the same
    with the sine, for both modes, and of a parabola, with x from -1 to 1 over the window. The fast
    mode is then the motion across the slow direction; its direction follows from how much of it is along.
    """
    middle_s = 0.5 * (t[0] + t[-1])
    x = (t - middle_s) / (0.5 * (t[-1] - t[0]))
    slow_phase, fast_phase = slow_omega * (t - start_s), fast_omega * (t - start_s)
    waves = (np.cos(slow_phase), np.sin(slow_phase), np.cos(fast_phase), np.sin(fast_phase), np.ones_like(t))
    design = np.column_stack([wave * x**k for wave in waves for k in range(_ENVELOPE_TERMS)])
    coefficients, *_ = np.linalg.lstsq(design, spots, rcond=None)
    # unit vectors across and along the direction of the largest motion
    first = coefficients[[0, _ENVELOPE_TERMS]]
    largest = np.linalg.eigh(first.T @ first)[1][:, 1]
    basis = np.column_stack([[-largest[1], largest[0]], largest])
    # overtones of the slow mode move the spot along the slow direction only, and only the fast mode across it
    across, along = (spots @ basis).T
    third, prior_overtones = _overtones(
        design, along, coefficients @ basis[:, 1], distinct=fast_omega > 4.0 * slow_omega
    )
    full_design = np.column_stack([design, third, prior_overtones])
    full_coefficients, *_ = np.linalg.lstsq(full_design, along, rcond=None)
    overtone_motion = full_design[:, design.shape[1] :] @ full_coefficients[design.shape[1] :]
    fundamentals = spots - np.outer(overtone_motion, basis[:, 1])
    coefficients, *_ = np.linalg.lstsq(design, fundamentals, rcond=None)
    residual = fundamentals - design @ coefficients
    covariance: Floats = residual.T @ residual / (len(t) - full_design.shape[1])
    slow, u_slow, slow_chi2 = _direction(coefficients, np.linalg.inv(design.T @ design), covariance)
    fast_columns = slice(2 * _ENVELOPE_TERMS, 4 * _ENVELOPE_TERMS)
    fast_coefficients = (coefficients @ basis)[fast_columns, 0]
    fast = design[:, fast_columns] @ fast_coefficients
    nuisances = np.column_stack([np.delete(design, fast_columns, axis=1), third])
    nuisance_basis, _ = np.linalg.qr(nuisances)
    columns = np.column_stack([fast, prior_overtones, across, along])
    columns -= nuisance_basis @ (nuisance_basis.T @ columns)
    products, noise = columns.T @ columns, basis.T @ covariance @ basis
    slope = 0.0
    for _ in range(_SLOPE_ITERATIONS):
        normal, derivative = np.array([-slope, 1.0]), np.ones(len(products) - 2)
        # a positive angle is a smaller slope
        derivative[0] = -(1.0 + slope**2)
        variance = float(normal @ noise @ normal)
        precision = np.outer(derivative, derivative) * products[:-2, :-2] / variance
        score = derivative * (products[:-2, -2:] @ normal) / variance
        angle_covariance = np.linalg.inv(precision + _prior(precision))
        slope += derivative[0] * float(angle_covariance[0] @ score)
    length = float(np.hypot(*normal))
    fast_vector = _vector(fast_coefficients * length, basis @ [1.0, -normal[0]] / length)
    u_slope = length * math.sqrt(angle_covariance[0, 0])
    return WindowDirections(float(middle_s), slow, u_slow, slow_chi2, fast_vector, u_slope, precision, score)


def _prior(precision: Floats) -> Floats:
    """The precision matrix of the overtones' prior, in the shape of the normal equations."""
    return np.diag([0.0, *np.ones(len(precision) - 1)])


def _overtones(design: Floats, along: Floats, slow: Floats, *, distinct: bool) -> tuple[Floats, Floats]:
    """Columns of the slow mode's overtones: (n, 2) of the free ones, and (n, m) of those with a prior.

    Friction and elasticity of the contact add odd harmonics to the slow mode, nearly in proportion to its
    amplitude. A harmonic near the fast mode's frequency would be attributed to the fast mode. The third is
    free in each window and limits the higher ones: for moments proportional to powers of the tilt from 0 to
    1, the fifth is 0.11 to 0.2 of the third, the others less. Where the fast mode's frequency is not separate
    from the third's, the third has a prior, and the higher ones are left out. Columns with a prior are scaled
    by its standard deviations.
    """
    powers = design[:, 4 * _ENVELOPE_TERMS :]
    cosine, sine = powers @ slow[:_ENVELOPE_TERMS], powers @ slow[_ENVELOPE_TERMS : 2 * _ENVELOPE_TERMS]
    phasor = (cosine - 1j * sine) * (design[:, 0] + 1j * design[:, _ENVELOPE_TERMS])
    amplitude = np.abs(phasor)

    def columns(order: int, factor: complex) -> Floats:
        motion = factor * amplitude * (phasor / amplitude) ** order
        return np.column_stack([motion.real, -motion.imag])

    if not distinct:
        return np.empty((len(along), 0)), columns(3, _THIRD_STD)
    third = columns(3, 1.0)
    values, *_ = np.linalg.lstsq(np.column_stack([design, third]), along, rcond=None)
    factor = complex(values[-2], values[-1])
    return third, np.column_stack([columns(5 + 2 * k, std * factor) for k, std in enumerate(_OVERTONE_STD)])


def fast_angles(windows: list[WindowDirections]) -> tuple[Floats, Floats, float]:
    """Angles from each window's `fast` to the fast direction that a fit with common overtones gives.

    An overtone near the fast mode's frequency turns the direction of a window that is too short to separate
    the two. Over the whole record their phases drift apart. The overtones, in proportion to the third
    harmonic, are therefore fitted to all windows together, with one fast direction.

    Returns
    -------
    correction_rad, u_correction_rad : (k,)
        The angles, and their standard uncertainties from noise.
    u_common_rad
        Standard uncertainty of all angles together, from that of the overtones.
    """
    first = windows[0].fast
    angles = [modulo_pi(angle_of(window.fast) - angle_of(first)) for window in windows]
    precision = np.sum([window.precision for window in windows], axis=0)
    score = np.sum([w.score + w.precision[:, 0] * a for w, a in zip(windows, angles, strict=True)], axis=0)
    covariance = np.linalg.inv(precision + _prior(precision))
    overtones = (covariance @ score)[1:]
    u2_rad = np.array([1.0 / window.precision[0, 0] for window in windows])
    correction_rad = u2_rad * [window.score[0] - window.precision[0, 1:] @ overtones for window in windows]
    u2_common = float(covariance[0, 0]) - 1.0 / float(precision[0, 0])
    return correction_rad, np.sqrt(u2_rad), math.sqrt(max(u2_common, 0.0))


def angle_of(vector: Floats) -> float:
    """Angle of a vector (x, y) on the sensor, from the upward vertical towards +x."""
    return math.atan2(vector[0], -vector[1])


def modulo_pi(angle_rad: float) -> float:
    """The angle of an axis without direction, in [-pi/2, pi/2)."""
    return (angle_rad + 0.5 * math.pi) % math.pi - 0.5 * math.pi


def _vector(coefficients: Floats, direction: Floats) -> Floats:
    """Vector of a mode with this direction (see `WindowDirections`), from the coefficients along it."""
    cosine, sine = coefficients.reshape(2, -1) @ (-1.0) ** np.arange(_ENVELOPE_TERMS)
    return math.copysign(math.hypot(cosine, sine), cosine) * direction


def _direction(coefficients: Floats, inverse: Floats, covariance: Floats) -> tuple[Floats, float, float]:
    """Vector, standard uncertainty of the angle, and chi-square of the slow mode. The coefficients (x, y) of
    its terms lie along a line: total least squares with their known covariance."""
    terms = 2 * _ENVELOPE_TERMS
    rows, weight = coefficients[:terms], np.linalg.inv(inverse[:terms, :terms])
    scatter = rows.T @ weight @ rows
    # noise that differs between directions rotates the major axis, so its expected scatter is subtracted
    along = np.linalg.eigh(scatter - (terms - 1) * covariance)[1][:, 1]
    across = np.array([-along[1], along[0]])
    signal = float(along @ scatter @ along) - float(along @ covariance @ along) * terms
    noise = float(across @ covariance @ across)
    u_angle = math.sqrt(noise / signal) if signal > 0 else math.inf
    return _vector(rows @ along, along), u_angle, float(across @ scatter @ across) / noise


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Least-squares fit of one sinusoid, whose amplitude changes linearly in time, about a straight line."""

    period_s: float
    amplitude: float
    """Amplitude at the middle of the samples, in their unit."""
    noise: float
    """Standard deviation of the residuals, in the unit of the samples."""
    explained: float
    """Fraction of the variance about a straight line that the sinusoid explains."""


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

    count, span_s = len(times_s), float(times_s[-1] - times_s[0])
    uniform = np.interp(np.linspace(times_s[0], times_s[-1], count), times_s, values)
    uniform = uniform - np.polyval(np.polyfit(np.arange(count), uniform, 1), np.arange(count))
    power = np.abs(np.fft.rfft(uniform * np.hanning(count), 8 * count)) ** 2
    frequency = np.fft.rfftfreq(8 * count, span_s / (count - 1))
    peak = int(np.argmax(np.where(frequency >= 1.0 / longest_s, power, -1.0)))
    half_width_hz = 0.5 / span_s
    minimum = minimize_scalar(
        lambda f: float(np.sum(_sinusoid_fit(times_s, values, f)[0] ** 2)),
        bounds=(max(frequency[peak] - half_width_hz, 0.1 / span_s), frequency[peak] + half_width_hz),
        method="bounded",
        options={"xatol": 1e-7 / span_s},
    )
    frequency_hz = float(minimum.x)
    residuals, amplitude = _sinusoid_fit(times_s, values, frequency_hz)
    variance = float(np.var(uniform))
    noise = math.sqrt(float(residuals @ residuals) / max(count - 7, 1))
    return Oscillation(1.0 / frequency_hz, amplitude, noise, 1.0 - noise**2 / max(variance, 1e-300))


def _sinusoid_fit(times_s: Floats, values: Floats, frequency_hz: float) -> tuple[Floats, float]:
    """Residuals of the linear fit of a sinusoid at this frequency, and its amplitude."""
    phase = 2.0 * math.pi * frequency_hz * (times_s - times_s[0])
    x = (times_s - times_s[0]) / (times_s[-1] - times_s[0]) - 0.5
    cosine, sine = np.cos(phase), np.sin(phase)
    design = np.column_stack([cosine, sine, x * cosine, x * sine, np.ones_like(x), x])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    return values - design @ solution, float(np.hypot(solution[0], solution[1]))


_MIN_OSCILLATION_PX = 0.05
_MIN_OSCILLATION_RATIO = 3.0
"""Smallest amplitude of an oscillation that is rejected, over the standard deviation of the residuals."""
_MIN_OSCILLATION_PERIOD_S = 0.2
"""Smallest period of an oscillation that is rejected; faster ones are vibrations."""


def require_rest(times_s: Floats, x_px: Floats, y_px: Floats, what: str) -> None:
    """Check that the pendulum does not swing in a record.

    It swings if, after subtraction of a straight line, a sinusoid explains more than half of the variance of
    a coordinate, and its amplitude and period exceed the limits above.

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
        drift = np.polyval(np.polyfit(times_s - times_s[0], values, 1), times_s - times_s[0])
        deviation = values - drift
        fit = strongest_oscillation(times_s, deviation, float(times_s[-1] - times_s[0]))
        is_significant = fit.amplitude > max(_MIN_OSCILLATION_PX, _MIN_OSCILLATION_RATIO * fit.noise)
        if is_significant and fit.explained > 0.5 and fit.period_s > _MIN_OSCILLATION_PERIOD_S:
            raise DataError(
                f"{what}: the pendulum swings by {fit.amplitude:.3g} px in {name} with a period of "
                f"{fit.period_s:.3g} s where it should rest; clamp it or let it come to rest"
            )
