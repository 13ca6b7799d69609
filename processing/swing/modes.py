"""Separation of the pendulum's two modes in the plane: least-squares fit of a slow and a fast damped ellipse.

    (x, y)(t) = rest + drift t + Re[slow(t) exp((i w_slow - d_slow) t)] + Re[fast exp((i w_fast - d_fast) t)]
    slow(t) = (X + k t Y, Y - k t X)

is fitted to a few slow periods, with complex X, Y, `fast` and k: the slow ellipse rotates at the rate Re k
and broadens at the rate Im k. The result is direction, width and period of each mode, with uncertainties,
also where both modes appear in both coordinates.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats, Ints
from processing.swing.mode_fit import (
    ALL_TERMS,
    FAST_AMPLITUDES,
    FAST_COSINE,
    FAST_RATE,
    FIRST_X_TERM,
    FIRST_Y_TERM,
    REST,
    SLOW_COSINE,
    SLOW_RATE,
    TERMS,
    ModeFit,
    ModeSamples,
    fast_mode_is_significant,
    fit_terms,
    slow_fit,
    with_fast_mode,
)
from processing.units import seconds

_MIN_SAMPLES = 20
"""Fewest samples, of two coordinates each, for the 18 terms of both modes."""
_STOP_ERROR = 0.6
"""Squared error of the slow mode by a fast mode that stops within the samples, relative to that by white
noise of the same size, multiplied by the squared number of cycles and divided by the number of samples."""


@dataclass(frozen=True, slots=True)
class Mode:
    """One damped ellipse at the reference time, in the unit of the coordinates."""

    period_s: float
    u_period_s: float
    amplitude: float
    """Semi-major axis."""
    u_amplitude: float
    width: float
    """Semi-minor axis, positive if the motion runs from +Y towards +X."""
    u_width: float
    direction_rad: float
    """Angle of the semi-major axis from Y towards X, in (-pi/2, pi/2]."""
    u_direction_rad: float
    x_amplitude: float
    """Largest deflection in X."""
    u_x_amplitude: float
    y_amplitude: float
    """Largest deflection in Y."""
    u_y_amplitude: float


@dataclass(frozen=True, slots=True)
class TwoModes:
    """Slow mode, fast mode and rest position.

    Standard uncertainties (`u_`) of each coordinate are multiplied by the square root of its chi-square per
    degree of freedom where that exceeds 1; by more if the fast mode stops.
    """

    time_ns: int
    """Reference time: the middle of the samples."""
    slow: Mode
    fast: Mode | None
    """None if no fast mode is significant."""
    fast_limit: float
    """Amplitude in X of the strongest spectral line in the residuals; 0 with a fast mode, NaN if the samples
    cannot show a line."""
    rest_x: float
    u_rest_x: float
    rest_y: float
    u_rest_y: float


def separate_modes(
    times_ns: Ints,
    x: Floats,
    y: Floats,
    u_x: Floats,
    u_y: Floats,
    slow_period_s: float = math.nan,
    fast_period_s: float = math.nan,
) -> TwoModes | None:
    """Fit both modes to the samples of a few slow periods.

    Parameters
    ----------
    times_ns : (n,) int64, ns, ascending
    x, y : (n,) coordinates, any unit; samples where either is NaN are ignored
    u_x, u_y : (n,) standard uncertainties, positive
    slow_period_s, fast_period_s : start values; NaN if unknown. A fast mode that has a start value and is not
        found has stopped within the samples.

    Returns
    -------
    TwoModes or None
        None if there is no oscillation: the slow mode explains less than half of the variance or leaves
        residuals much larger than the noise, the samples cover less than about one of its periods, or
        there are fewer than 20 samples.
    """
    is_finite = np.isfinite(x) & np.isfinite(y)
    times = times_ns[is_finite]
    if len(times) < _MIN_SAMPLES or times[0] == times[-1]:
        return None
    middle_ns = int(times[0] + (times[-1] - times[0]) // 2)
    t = seconds(times - middle_ns)
    samples = ModeSamples(t, x[is_finite], y[is_finite], u_x[is_finite] ** -2.0, u_y[is_finite] ** -2.0)
    fit = None
    if not math.isnan(slow_period_s) and not math.isnan(fast_period_s):
        # both periods are known: no search is needed
        start = np.zeros(TERMS)
        start[SLOW_RATE], start[FAST_RATE] = 2.0 * math.pi / slow_period_s, 2.0 * math.pi / fast_period_s
        fit = fit_terms(start, ALL_TERMS, samples, float(start[SLOW_RATE]))
        if not (fit.explains(samples) and fast_mode_is_significant(fit)):
            fit = None
    limit = 0.0
    if fit is None:
        slow = slow_fit(samples, slow_period_s)
        if slow is None:
            return None
        fit, limit = with_fast_mode(slow, samples)
    if not fit.p[SLOW_RATE] * samples.span_s > 1.8 * math.pi:
        return None
    weighted = _with_scatter(fit, samples, fast_period_s)
    if FAST_RATE in fit.active and weighted is not fit and not fast_mode_is_significant(weighted, len(t)):
        # residuals of one coordinate that the model does not describe had been fitted by a mode of both
        slow = slow_fit(samples, 2.0 * math.pi / float(fit.p[SLOW_RATE]))
        if slow is None:
            return None
        limit = float(np.hypot(*weighted.p[FAST_AMPLITUDES[:2]]))
        weighted = _with_scatter(slow, samples, fast_period_s)
    return _result(middle_ns, weighted, limit)


def _with_scatter(fit: ModeFit, samples: ModeSamples, fast_period_s: float) -> ModeFit:
    """The fit with each coordinate's uncertainties enlarged by its scatter; the same fit if there is none.
    Scatter across the slow mode is that of a fast mode that stops: the fitted one, or one of this period."""
    dof = max(len(samples.t) - len(fit.active) / 2.0, 1.0)
    chi2_per_dof_x = float((fit.residual_x**2 * samples.weights_x).sum()) / dof
    chi2_per_dof_y = float((fit.residual_y**2 * samples.weights_y).sum()) / dof
    if not (min(chi2_per_dof_x, chi2_per_dof_y) > 0.0 and max(chi2_per_dof_x, chi2_per_dof_y) > 1.0):
        return fit
    # Each coordinate gets its own scatter: friction and anharmonicity distort the motion along the major
    # axis and hardly the one across it.
    factor = np.ones(2)
    if FAST_RATE in fit.active:
        fast_period_s = 2.0 * math.pi / float(fit.p[FAST_RATE])
    if not math.isnan(fast_period_s):
        first_terms = (FIRST_X_TERM + SLOW_COSINE, FIRST_Y_TERM + SLOW_COSINE)
        sizes = [np.hypot(fit.p[index], fit.p[index + 1]) for index in first_terms]
        cycles = samples.span_s / fast_period_s
        factor[int(np.argmin(sizes))] = max(_STOP_ERROR * len(samples.t) / cycles**2, 1.0)
    scatter_x, scatter_y = 1.0 + factor * np.maximum(np.array([chi2_per_dof_x, chi2_per_dof_y]) - 1.0, 0.0)
    weights_x, weights_y = samples.weights_x / scatter_x, samples.weights_y / scatter_y
    weighted = samples._replace(weights_x=weights_x, weights_y=weights_y)
    return fit_terms(fit.p, fit.active, weighted, float(fit.p[SLOW_RATE]))


def _ellipse(amplitudes: Floats) -> Floats:
    """Semi-axes, direction, amplitudes in x and y (5, n); from x cosine, x sine, y cosine, y sine (4, n)."""
    x, y = amplitudes[0] - 1j * amplitudes[1], amplitudes[2] - 1j * amplitudes[3]
    # An ellipse is the sum of two circular motions of y + i x in opposite senses, with these amplitudes. Its
    # semi-axes are the sum and the difference of their moduli.
    forward, backward = (y + 1j * x) / 2.0, (y.conj() + 1j * x.conj()) / 2.0
    larger, smaller = np.abs(forward), np.abs(backward)
    direction = (np.angle(forward) + np.angle(backward)) / 2.0
    return np.array([larger + smaller, larger - smaller, direction, np.abs(x), np.abs(y)])


def _mode(p: Floats, covariance: Floats, rate_index: int, cosine: int) -> Mode:
    """Mode with its rate and the first of its cosines and sines at these indices."""
    indices = [first + cosine + k for first in (FIRST_X_TERM, FIRST_Y_TERM) for k in (0, 1)]
    amplitudes = p[indices]
    size = max(float(np.abs(amplitudes).max()), 1e-300)
    change = 1e-6 * size * np.eye(4)
    # the ellipse itself, then with each of its four amplitudes larger, then smaller: central differences
    columns = [amplitudes, amplitudes[:, None] + change, amplitudes[:, None] - change]
    ellipses = _ellipse(np.column_stack(columns))
    values, differences = ellipses[:, 0], ellipses[:, 1:5] - ellipses[:, 5:]
    # the angle is defined modulo pi: remove jumps
    differences[2] = (differences[2] + math.pi / 2.0) % math.pi - math.pi / 2.0
    slopes = differences / (2e-6 * size)
    u = np.sqrt(np.maximum(np.diag(slopes @ covariance[np.ix_(indices, indices)] @ slopes.T), 0.0))
    if abs(values[2]) > math.pi / 2.0:
        values[2] -= round(values[2] / math.pi) * math.pi
    period = 2.0 * math.pi / p[rate_index]
    u_rate = math.sqrt(max(covariance[rate_index, rate_index], 0.0))
    u_period = period * u_rate / p[rate_index]
    return Mode(float(period), float(u_period), *np.column_stack([values, u]).ravel().tolist())


def _result(time_ns: int, fit: ModeFit, limit: float) -> TwoModes:
    p, covariance = fit.p, fit.covariance
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return TwoModes(
        time_ns=time_ns,
        slow=_mode(p, covariance, SLOW_RATE, SLOW_COSINE),
        fast=_mode(p, covariance, FAST_RATE, FAST_COSINE) if FAST_RATE in fit.active else None,
        fast_limit=limit,
        rest_x=float(p[FIRST_X_TERM + REST]),
        u_rest_x=float(u[FIRST_X_TERM + REST]),
        rest_y=float(p[FIRST_Y_TERM + REST]),
        u_rest_y=float(u[FIRST_Y_TERM + REST]),
    )
