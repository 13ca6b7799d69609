"""Directions of the two modes on the sensor, from a record in which both swing."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field

from calibration.axes_window import (
    SLOW_DOF,
    angle_of,
    fast_angles,
    modulo_pi,
    strongest_oscillation,
    window_directions,
)
from calibration.birge import birge_ratio
from calibration.light_lever import Lever
from processing.arrays import Floats
from processing.errors import DataError
from processing.number_text import with_uncertainty

_MAX_NON_ORTHOGONALITY_RAD = 0.5


class Axes(BaseModel, frozen=True, extra="forbid"):
    """Directions of the pendulum's slow and fast mode on the sensor.

    Tilts are plotted with Y (slow mode) up and X (fast mode) to the right; the sensor's y points down.
    `slow_angle_rad` is the angle of the slow mode's direction from the sensor's upward vertical, positive
    towards the sensor's +x. The fast mode's direction is at that angle plus a right angle plus
    `non_orthogonality_rad`; if `mirrored` (the camera sees the pendulum in a mirror), it has the opposite
    sign. `u_` marks standard uncertainties; 0 means not stated.
    """

    slow_angle_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)
    u_slow_angle_rad: float = Field(default=0.0, ge=0)
    non_orthogonality_rad: float = Field(
        default=0.0, gt=-_MAX_NON_ORTHOGONALITY_RAD, lt=_MAX_NON_ORTHOGONALITY_RAD
    )
    u_non_orthogonality_rad: float = Field(default=0.0, ge=0)
    mirrored: bool = False

    def directions(self) -> Floats:
        """Matrix (2, 2) whose columns are the unit vectors (x, y) of fast and slow mode on the sensor."""
        slow = self.slow_angle_rad
        fast = slow + 0.5 * math.pi + self.non_orthogonality_rad
        sign = -1.0 if self.mirrored else 1.0
        return np.array(
            [[sign * math.sin(fast), math.sin(slow)], [-sign * math.cos(fast), -math.cos(slow)]],
        )


def displacements(
    axes: Axes,
    x_px: ArrayLike,
    y_px: ArrayLike,
    u_x_px: ArrayLike,
    u_y_px: ArrayLike,
    reference_px: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Displacements of the spot along the fast and the slow mode in px, with their standard uncertainties.

    The parameters are those of `deflections`, without the lever.
    """
    fast, slow = np.linalg.inv(axes.directions())
    dx_px = np.asarray(x_px, dtype=float) - reference_px[0]
    dy_px = np.asarray(y_px, dtype=float) - reference_px[1]
    return (
        fast[0] * dx_px + fast[1] * dy_px,
        slow[0] * dx_px + slow[1] * dy_px,
        np.hypot(fast[0] * np.asarray(u_x_px), fast[1] * np.asarray(u_y_px)),
        np.hypot(slow[0] * np.asarray(u_x_px), slow[1] * np.asarray(u_y_px)),
    )


def deflections(
    lever: Lever,
    axes: Axes,
    x_px: ArrayLike,
    y_px: ArrayLike,
    u_x_px: ArrayLike,
    u_y_px: ArrayLike,
    reference_px: tuple[float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Tilts of the pendulum along its own axes, from positions of the spot.

    Parameters
    ----------
    lever, axes
        Calibration.
    x_px, y_px, u_x_px, u_y_px
        Positions of the spot on the sensor and their standard uncertainties in px, scalars or arrays of one
        shape; NaN for a lost spot.
    reference_px
        Position (x, y) of the spot at zero tilt.

    Returns
    -------
    x_rad, y_rad, u_x_rad, u_y_rad
        Tilts of the fast and the slow mode and their standard uncertainties, of the shape of `x_px`; NaN
        where the spot is NaN. The uncertainties are those of the spot alone: the uncertainty of the lever's
        scale is common to all tilts and is a part of the fit's uncertainty budget.
    """
    fast_px, slow_px, u_fast_px, u_slow_px = displacements(axes, x_px, y_px, u_x_px, u_y_px, reference_px)
    # the fast axis is across the tilt of the sensor
    fast_lever = lever.model_copy(update={"skew": 0.0}) if lever.skew else lever
    return (
        fast_lever.tilt_rad(fast_px),
        lever.tilt_rad(slow_px),
        u_fast_px * fast_lever.rad_per_px(fast_px),
        u_slow_px * lever.rad_per_px(slow_px),
    )


Sign = Literal["+", "-"]
"""Side on which a mode's swing begins: the positive or the negative direction of its axis."""
_WINDOW_PERIODS = 6.0
"""Length of a window in slow periods."""
_MIN_SPOTS, _MIN_WINDOW_SPOTS = 100, 61
"""Smallest number of spots of a record, and of a window that is used."""
_MIN_PERIODS = 2.0
"""Smallest number of slow periods; with fewer the slow mode looks like a drift of the rest position."""
_LONGEST_FAST = 0.4
"""Longest period of a fast mode that is searched for, over the slow one."""
_MIN_SLOW = 0.05
"""Smallest amplitude of a slow mode across a larger fast one, relative to it; less may be a drift."""
_MIN_RATIO = 2.6
"""Smallest ratio of the modes' frequencies; a ratio at the edge of the search is that of no fast mode."""
_MAX_U_FAST = 0.2
"""Largest uncertainty of the fast direction as a slope; that of noise alone is 0.4 in the mean."""
_MAX_CHI2_PER_DOF = 100.0
"""Largest chi-square per degree of freedom of the windows' directions, which then scatter ten times as much
as the spots' noise explains. Larger uncertainties would hide that there are no two fixed directions.
"""


@dataclass(frozen=True, slots=True)
class AxesFit:
    """Directions of the axes, fitted to both modes. `notes` are remarks for the user."""

    axes: Axes
    slow_period_s: float
    fast_period_s: float
    slow_px: float
    fast_px: float
    """Amplitudes of the modes on the sensor at the beginning."""
    rotation_rad_per_s: float
    """Rate at which the slow direction rotates."""
    u_rotation_rad_per_s: float
    """Infinite with fewer than three windows."""
    windows: int
    """Number of time windows in which the directions were fitted."""
    chi2_per_dof: float
    """Scatter of the windows' directions over their uncertainties."""
    signs_known: bool
    """False if the slow direction was assumed to point up: a free swing does not determine its sign."""
    handedness_known: bool
    """False if `mirrored` was taken from the configuration: a free swing does not determine it either."""
    notes: tuple[str, ...]


class _MeanDirection(NamedTuple):
    """Mean direction of a mode over all windows, as the angle from the upward vertical towards +x."""

    angle_rad: float
    u_angle_rad: float
    rotation_rad_per_s: float
    u_rotation_rad_per_s: float
    chi2: float
    deviations_rad: Floats
    """Directions of the windows minus the mean."""


def fit_axes(
    times_s: Floats,
    x_px: Floats,
    y_px: Floats,
    *,
    slow_began: Sign | None = None,
    fast_began: Sign | None = None,
    mirrored: bool = False,
) -> AxesFit:
    """Directions of slow and fast mode on the sensor, from a record in which both swing.

    Parameters
    ----------
    times_s, x_px, y_px : (n,), s and px
        Positions of the spot on the sensor, in order of time; NaN for lost spots.
    slow_began, fast_began
        Sign of each mode's deflection at the first sample, along the pendulum's own axes. Without
        `slow_began`, the slow direction is assumed to point up on the sensor; without `fast_began`, the
        handedness is `mirrored`.
    mirrored
        Handedness that is assumed without `fast_began`.

    Raises
    ------
    DataError
        Fewer than 100 spots, no swing, less than two slow periods, no visible fast mode, an angle between
        the modes that differs from a right angle by more than 0.5 rad, or directions that are not the same
        all the time.

    Notes
    -----
    The record is divided into windows of about six slow periods (see `window_directions`), and the
    directions of the windows are averaged. A mode that swings along a line has the same phase in both
    coordinates, so its two complex amplitudes are a real direction times one complex number. If the slow
    mode also moves the spot across its direction (leakage), this is contained in the direction found: a
    record cannot separate the two.
    """
    good = np.isfinite(x_px) & np.isfinite(y_px)
    t, x, y = times_s[good], x_px[good], y_px[good]
    if len(t) < _MIN_SPOTS:
        raise DataError(f"axes: {len(t)} spots of {_MIN_SPOTS} that are needed; record for longer")
    slow_omega, fast_omega = _frequencies(t, x, y)
    slow_period_s = 2.0 * math.pi / slow_omega
    periods = float(t[-1] - t[0]) / slow_period_s
    if periods < _MIN_PERIODS:
        raise DataError(f"axes: {periods:.1f} slow periods; at least {_MIN_PERIODS:g} are needed")
    edges = np.linspace(t[0], t[-1] + 1e-9, max(1, round(periods / _WINDOW_PERIODS)) + 1)
    spots, begin_s = np.column_stack([x, y]), float(t[0])
    windows = [
        window_directions(t[in_window], spots[in_window], slow_omega, fast_omega, begin_s)
        for first, last in pairwise(edges)
        if (in_window := (t >= first) & (t < last)).sum() >= _MIN_WINDOW_SPOTS
    ]
    first_window = windows[0]
    slow = first_window.slow
    # where no side is stated, upwards is positive
    if slow_began == "-" or (slow_began is None and slow[1] > 0):
        slow = -slow
    slow_mean = _mean_direction(
        [w.middle_s for w in windows],
        angle_of(slow),
        np.array([angle_of(w.slow) for w in windows]),
        np.array([w.u_slow_rad for w in windows]),
        birge_ratio(sum(w.slow_chi2 for w in windows), SLOW_DOF * len(windows)),
    )
    usable = [w for w in windows if w.u_fast_slope < _MAX_U_FAST]
    if not usable:
        raise DataError(
            f"axes: no fast mode is visible ({float(np.hypot(*first_window.fast)):.2g} px, "
            f"u of its direction {first_window.u_fast_slope:.2g} rad); "
            "push the pendulum across the slow direction as well, or record for longer"
        )
    if fast_omega < _MIN_RATIO * slow_omega:
        raise DataError(
            f"axes: across a swing of {slow_period_s:.3g} s the strongest has "
            f"{2.0 * math.pi / fast_omega:.3g} s; the fast mode is sought among periods below "
            f"{1.0 / _MIN_RATIO:.2g} of the slow one's: push the pendulum across the slow direction"
        )
    fast = -usable[0].fast if fast_began == "-" else usable[0].fast
    # the sensor's y points down: the cross product is positive to the right of the slow direction
    is_left = bool(slow[0] * fast[1] - slow[1] * fast[0] < 0)
    if fast_began is not None:
        mirrored = is_left
    elif is_left != mirrored:
        fast = -fast
    corrections_rad, u_corrections_rad, u_overtones_rad = fast_angles(usable)
    fast_mean = _mean_direction(
        [w.middle_s for w in usable],
        angle_of(fast),
        np.array([angle_of(w.fast) for w in usable]) + corrections_rad,
        u_corrections_rad,
    )
    right_handed_rad = fast_mean.angle_rad + (math.pi if mirrored else 0.0)
    non_orthogonality_rad = _wrap_angle(right_handed_rad - slow_mean.angle_rad - 0.5 * math.pi)
    notes = []
    if slow_began is None:
        notes.append(
            "the slow axis is assumed to point up on the sensor; "
            "to determine it, state on which side the swing began (slow_began)"
        )
    if fast_began is None:
        notes.append("the handedness is assumed; push the pendulum to a known side and state it (fast_began)")
    rotation, u_rotation = slow_mean.rotation_rad_per_s, slow_mean.u_rotation_rad_per_s
    if abs(rotation) > 3.0 * u_rotation:
        notes.append(f"the slow direction rotates by {with_uncertainty(rotation, u_rotation)} rad/s")
    if abs(non_orthogonality_rad) >= _MAX_NON_ORTHOGONALITY_RAD:
        raise DataError(
            f"axes: the angle between the modes is {math.degrees(0.5 * math.pi + non_orthogonality_rad):.0f} "
            "degrees; these are not the two modes of a pendulum"
        )
    _refuse_changing_direction("slow", slow_mean)
    _refuse_changing_direction("fast", fast_mean)
    return AxesFit(
        axes=Axes(
            slow_angle_rad=slow_mean.angle_rad,
            u_slow_angle_rad=slow_mean.u_angle_rad,
            non_orthogonality_rad=non_orthogonality_rad,
            u_non_orthogonality_rad=math.hypot(fast_mean.u_angle_rad, u_overtones_rad, slow_mean.u_angle_rad),
            mirrored=mirrored,
        ),
        slow_period_s=slow_period_s,
        fast_period_s=2.0 * math.pi / fast_omega,
        slow_px=float(np.hypot(*first_window.slow)),
        fast_px=float(np.hypot(*usable[0].fast)),
        rotation_rad_per_s=rotation,
        u_rotation_rad_per_s=u_rotation,
        windows=len(windows),
        chi2_per_dof=(slow_mean.chi2 + fast_mean.chi2) / max(len(windows) + len(usable) - 2, 1),
        signs_known=slow_began is not None,
        handedness_known=fast_began is not None,
        notes=tuple(notes),
    )


def _frequencies(t: Floats, x: Floats, y: Floats) -> tuple[float, float]:
    """Angular frequencies (rad/s) of the slow mode, and of the fast one, which may be the larger motion."""
    span_s = float(t[-1] - t[0])
    centred = np.column_stack([x - x.mean(), y - y.mean()])
    _, vectors = np.linalg.eigh(centred.T @ centred)
    along, across = centred @ vectors[:, 1], centred @ vectors[:, 0]
    early = t - t[0] <= max(0.1 * span_s, min(span_s, 60.0))
    slow = strongest_oscillation(t[early], along[early], span_s)
    if slow.explained < 0.5:
        raise DataError(
            "axes: the spot does not swing; release the pendulum and push it across the slow direction too"
        )
    slower = strongest_oscillation(t[early], across[early], span_s / _MIN_PERIODS)
    is_swing = slower.explained > 0.5 and slower.amplitude > _MIN_SLOW * slow.amplitude
    if is_swing and slow.period_s < _LONGEST_FAST * slower.period_s:
        slow, across = slower, along
    fast = strongest_oscillation(t[early], across[early], _LONGEST_FAST * slow.period_s)
    return 2.0 * math.pi / slow.period_s, 2.0 * math.pi / fast.period_s


def _mean_direction(
    middles_s: list[float], base_rad: float, angles_rad: Floats, u_rad: Floats, min_enlargement: float = 1.0
) -> _MeanDirection:
    """Weighted mean of the windows' angles, with the sign of `base_rad`. Its uncertainty is enlarged by
    `min_enlargement`, for the noise within the windows, or by their scatter if that is more."""
    # the sign of a window's vector is arbitrary: differences of angle are taken modulo pi
    differences_rad = np.array([modulo_pi(angle - base_rad) for angle in angles_rad])
    weight = 1.0 / np.maximum(u_rad, 1e-12) ** 2
    mean_rad = float(weight @ differences_rad / weight.sum())
    deviations_rad = differences_rad - mean_rad
    chi2, dof = float(weight @ deviations_rad**2), len(deviations_rad) - 1
    u_mean_rad = float(1.0 / np.sqrt(weight.sum())) * max(birge_ratio(chi2, dof), min_enlargement)
    rate, u_rate = 0.0, math.inf
    if dof > 1:
        t = np.array(middles_s)
        t = t - float(weight @ t / weight.sum())
        spread = float(weight @ t**2)
        rate = float(weight @ (t * deviations_rad)) / spread
        u_rate = 1.0 / math.sqrt(spread)
    return _MeanDirection(_wrap_angle(base_rad + mean_rad), u_mean_rad, rate, u_rate, chi2, deviations_rad)


def _refuse_changing_direction(mode: str, direction: _MeanDirection) -> None:
    """Raise DataError if a mode's directions in the windows differ by much more than the spots' noise."""
    deviations_rad, chi2 = direction.deviations_rad, direction.chi2
    rate, u_rate = direction.rotation_rad_per_s, direction.u_rotation_rad_per_s
    dof = len(deviations_rad) - 1
    if dof == 0 or chi2 / dof < _MAX_CHI2_PER_DOF:
        return
    differences_rad = [modulo_pi(deviation - deviations_rad[0]) for deviation in deviations_rad]
    head = (
        f"axes: the {mode} direction is not the same in the {dof + 1} parts of the record: it differs by "
        f"{1e3 * float(np.ptp(differences_rad)):.3g} mrad, {math.sqrt(chi2 / dof):.3g} times the noise"
    )
    if (rate / u_rate) ** 2 > 0.9 * chi2:
        raise DataError(
            f"{head}; it turns evenly, by {1e3 * rate:.3g} mrad/s: balance the pendulum until the plane of "
            "its swing stays, or record for a shorter time"
        )
    raise DataError(
        f"{head}: it was touched or shaken, or a clip or a second spot disturbs the positions; record an "
        "undisturbed swing"
    )


def _wrap_angle(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
