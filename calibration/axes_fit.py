"""Directions of the two modes on the sensor, from a record in which both swing."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calibration.axes import Axes
from calibration.axes_stretch import DirectionsOfStretch, directions_of_stretch
from calibration.oscillation import strongest_oscillation
from processing.errors import DataError

Floats = NDArray[np.float64]
Sign = Literal["+", "-"]
_WINDOW_PERIODS = 6.0
_FEWEST_PERIODS = 2.0
_IMPROBABLE = 0.01


@dataclass(frozen=True, slots=True)
class AxesFit:
    """Directions of the axes from both modes.

    `axes` with its uncertainties; periods in s; `slow_px` and `fast_px` are the amplitudes at the beginning.
    `rotation_rad_per_s` is the rate of rotation of the slow direction. `signs_known` and `handedness_known`
    are False if direction and handedness were assumed (upward, and as configured before), because a free
    swing does not determine them. `notes` are remarks for the user.
    """

    axes: Axes
    slow_period_s: float
    fast_period_s: float
    slow_px: float
    fast_px: float
    rotation_rad_per_s: float
    u_rotation_rad_per_s: float
    windows: int
    chi2_per_dof: float
    signs_known: bool
    handedness_known: bool
    notes: tuple[str, ...]


def fit_axes(
    times_s: Floats,
    x_px: Floats,
    y_px: Floats,
    *,
    slow_began: Sign | None = None,
    fast_began: Sign | None = None,
    mirrored: bool = False,
) -> AxesFit:
    """Fit slow and fast mode in windows of six slow periods.

    Parameters
    ----------
    times_s, x_px, y_px
        Spots in order; NaN for lost ones.
    slow_began, fast_began
        Side on which each mode's swing stood at the first sample, as the pendulum's own axes have
        it. Without the first, the slow direction is taken to point up on the sensor; without the
        second, the handedness stays `mirrored`.

    Raises
    ------
    DataError
        No swing, less than two slow periods, or no fast mode to be seen.

    Notes
    -----
    A mode that swings along a line has one phase in both coordinates, so that its complex
    amplitudes are the direction times one number. The slow direction contains whatever part of the
    slow tilt shows across it (leakage): a record cannot tell the two apart.
    """
    good = np.isfinite(x_px) & np.isfinite(y_px)
    t, x, y = times_s[good], x_px[good], y_px[good]
    if len(t) < 100:
        raise DataError(f"axes: {len(t)} spots of 100 that are needed; record for longer")
    slow_omega, fast_omega = _frequencies(t, x, y)
    slow_period_s = 2.0 * math.pi / slow_omega
    periods = float(t[-1] - t[0]) / slow_period_s
    if periods < _FEWEST_PERIODS:
        raise DataError(f"axes: {periods:.1f} slow periods; at least {_FEWEST_PERIODS:g} are needed")
    count = max(1, round(periods / _WINDOW_PERIODS))
    edges = np.linspace(t[0], t[-1] + 1e-9, count + 1)
    windows = []
    for first, last in pairwise(edges):
        part = (t >= first) & (t < last)
        if part.sum() > 60:
            windows.append(
                directions_of_stretch(
                    t[part], np.column_stack([x[part], y[part]]), slow_omega, fast_omega, float(t[0])
                )
            )
    first_window = windows[0]
    slow = _sided(first_window.slow, slow_began) if slow_began else _upward(first_window.slow)
    slow_angle, u_slow, rotation, u_rotation, slow_chi2 = _combined(
        windows, slow, [w.slow for w in windows], [w.u_slow_rad for w in windows]
    )
    usable = [w for w in windows if w.u_fast_rad < 0.2]
    if not usable:
        raise DataError(
            f"axes: no fast mode to be seen ({float(np.hypot(*first_window.fast)):.2g} px, "
            f"its direction to {first_window.u_fast_rad:.2g} rad); "
            "push the pendulum crosswise as well, or record for longer"
        )
    if fast_began is not None:
        fast = _sided(usable[0].fast, fast_began)
        cross = slow[0] * fast[1] - slow[1] * fast[0]
        # y runs down: right of the slow direction is where the cross product is positive
        mirrored = bool(cross < 0)
    else:
        fast = _right(usable[0].fast, slow, mirrored)
    fast_angle, u_fast, _, _, fast_chi2 = _combined(
        usable, fast, [w.fast for w in usable], [w.u_fast_rad for w in usable]
    )
    non_orthogonality = _wrapped(fast_angle + (math.pi if mirrored else 0.0) - slow_angle - 0.5 * math.pi)
    notes = []
    if slow_began is None:
        notes.append("the slow axis is taken to point up on the sensor; state the side of the start to know")
    if fast_began is None:
        notes.append("the handedness is assumed; push the pendulum to a known side and state it (fast_began)")
    if abs(rotation) > 3.0 * u_rotation:
        notes.append(f"the slow direction turns by {rotation:.3g} +- {u_rotation:.2g} rad/s")
    if abs(non_orthogonality) >= 0.5:
        raise DataError(
            f"axes: the modes lie {math.degrees(0.5 * math.pi + non_orthogonality):.0f} degrees apart; "
            "these are not the two modes of a pendulum"
        )
    return AxesFit(
        axes=Axes(
            slow_angle_rad=slow_angle,
            u_slow_angle_rad=u_slow,
            non_orthogonality_rad=non_orthogonality,
            u_non_orthogonality_rad=math.hypot(u_fast, u_slow),
            mirrored=mirrored,
        ),
        slow_period_s=slow_period_s,
        fast_period_s=2.0 * math.pi / fast_omega,
        slow_px=float(np.hypot(*first_window.slow)),
        fast_px=float(np.hypot(*usable[0].fast)),
        rotation_rad_per_s=rotation,
        u_rotation_rad_per_s=u_rotation,
        windows=len(windows),
        chi2_per_dof=(slow_chi2 + fast_chi2) / max(len(windows) + len(usable) - 2, 1),
        signs_known=slow_began is not None,
        handedness_known=fast_began is not None,
        notes=tuple(notes),
    )


def _frequencies(t: Floats, x: Floats, y: Floats) -> tuple[float, float]:
    """Frequencies: of the slow mode along the major axis, of the fast mode across it."""
    span_s = float(t[-1] - t[0])
    centred = np.column_stack([x - x.mean(), y - y.mean()])
    _, vectors = np.linalg.eigh(centred.T @ centred)
    along, across = centred @ vectors[:, 1], centred @ vectors[:, 0]
    early = t - t[0] <= max(0.1 * span_s, min(span_s, 60.0))
    slow = strongest_oscillation(t[early], along[early], span_s)
    if slow.explained < 0.5:
        raise DataError("axes: the spot does not swing; let the pendulum go, with a push crosswise as well")
    fast = strongest_oscillation(t[early], across[early], 0.4 * slow.period_s)
    return 2.0 * math.pi / slow.period_s, 2.0 * math.pi / fast.period_s


def _combined(
    windows: list[DirectionsOfStretch], reference: Floats, vectors: list[Floats], u: list[float]
) -> tuple[float, float, float, float, float]:
    """Weighted mean angle (upward vertical to +x), its u, turning with u, chi2 about the mean."""
    base = math.atan2(reference[0], -reference[1])
    # a line has no sign: differences of angle are taken modulo half a turn
    turned = np.array([_half(math.atan2(v[0], -v[1]) - base) for v in vectors])
    weight = 1.0 / np.maximum(np.array(u), 1e-12) ** 2
    mean = float(weight @ turned / weight.sum())
    u_mean = float(1.0 / np.sqrt(weight.sum()))
    total = float(weight @ (turned - mean) ** 2)
    dof = len(turned) - 1
    if dof > 0 and chi2.sf(total, dof) < _IMPROBABLE:
        u_mean *= math.sqrt(total / dof)
    rate, u_rate = 0.0, math.inf
    if dof > 1:
        t = np.array([w.middle_s for w in windows])
        t = t - float(weight @ t / weight.sum())
        spread = float(weight @ t**2)
        rate = float(weight @ (t * (turned - mean))) / spread
        u_rate = 1.0 / math.sqrt(spread)
    return _wrapped(base + mean), u_mean, rate, u_rate, total


def _sided(vector: Floats, side: Sign) -> Floats:
    return vector if side == "+" else -vector


def _upward(vector: Floats) -> Floats:
    return vector if vector[1] <= 0 else -vector


def _right(vector: Floats, slow: Floats, mirrored: bool) -> Floats:
    cross = slow[0] * vector[1] - slow[1] * vector[0]
    return vector if (cross > 0) != mirrored else -vector


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def _half(angle: float) -> float:
    return (angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi
