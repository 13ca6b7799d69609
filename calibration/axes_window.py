"""Directions of both modes on the sensor, from the spots of one time window of a record."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats

_ENVELOPE = 3
"""Number of polynomial terms in time (a parabola) of each mode's cosine and sine amplitude."""

_OVERTONE_PARTS = (0.15, 0.08, 0.05)
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
            *(slow_c * u**k for k in range(_ENVELOPE)),
            *(slow_s * u**k for k in range(_ENVELOPE)),
            *(fast_c * u**k for k in range(_ENVELOPE)),
            *(fast_s * u**k for k in range(_ENVELOPE)),
            *(u**k for k in range(_ENVELOPE)),
        ]
    )
    coefficients, *_ = np.linalg.lstsq(design, spots, rcond=None)
    frame = _frame(coefficients[[0, _ENVELOPE]])
    covariance = _noise(spots - design @ coefficients, design)
    slow_columns, fast_columns = list(range(2 * _ENVELOPE)), list(range(2 * _ENVELOPE, 4 * _ENVELOPE))
    inverse = np.linalg.inv(design.T @ design)
    # overtones of the slow mode move the spot along the slow direction only; across it only the fast mode
    # does
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
    """Columns: unit vectors across and along the direction of the largest motion."""
    _, vectors = np.linalg.eigh(rows.T @ rows)
    along = vectors[:, 1]
    return np.column_stack([[-along[1], along[0]], along])


def _swing(design: Floats, along: Floats) -> NDArray[np.complex128]:
    """Unit phasor of the slow mode at each sample, with its slowly varying phase."""
    u = design[:, 4 * _ENVELOPE + 1]
    powers = np.column_stack([u**k for k in range(_ENVELOPE)])
    c, s = powers @ along[:_ENVELOPE], powers @ along[_ENVELOPE : 2 * _ENVELOPE]
    phasor = (c - 1j * s) * (design[:, 0] + 1j * design[:, _ENVELOPE])
    unit: NDArray[np.complex128] = phasor / np.abs(phasor)
    return unit


def _with_overtones(
    design: Floats, along: Floats, swing: NDArray[np.complex128], *, overtone_3: bool
) -> tuple[Floats, Floats, Floats]:
    """Coefficients along the slow direction, their covariance, and the motion due to overtones.

    Friction and elasticity of the contact add odd harmonics to the slow mode. A harmonic near the fast
    mode's frequency would be attributed to the fast mode. The third harmonic is fitted freely, unless the
    fast mode is too near to it (`overtone_3` False: then no harmonic is fitted). It limits the higher ones:
    for moments proportional to powers of the tilt from 0 to 1, the fifth harmonic is 0.11 to 0.2 of the
    third, the others less. They are fitted with a normal prior of mean 0 and standard deviation
    `_OVERTONE_PARTS` times the third.
    """
    orders = [3, 5, 7, 9] if overtone_3 else []
    columns = [part for k in orders for part in ((swing**k).real, (swing**k).imag)]
    whole = np.column_stack([design, *columns])
    values, *_ = np.linalg.lstsq(whole[:, : design.shape[1] + 2 * bool(orders)], along, rcond=None)
    residual = along - whole[:, : len(values)] @ values
    variance = float(residual @ residual) / (len(along) - len(values))
    held = np.zeros(whole.shape[1])
    if orders:
        third = float(np.hypot(values[-2], values[-1]))
        for number, part in enumerate(_OVERTONE_PARTS):
            at = design.shape[1] + 2 + 2 * number
            held[at : at + 2] = variance / max(part * third, 1e-12) ** 2
    covariance = np.linalg.inv(whole.T @ whole + np.diag(held))
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
    signs = np.array([(-1.0) ** k for k in range(_ENVELOPE)])
    return float(rows[:_ENVELOPE] @ signs), float(rows[_ENVELOPE:] @ signs)


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
    # noise that differs between directions rotates the major axis: its expected part is subtracted
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
