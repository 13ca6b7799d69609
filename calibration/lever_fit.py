"""Light lever from reference data: a ladder of known tilts, or of known shifts of the sensor."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from calibration.light_lever import Lever
from processing.angle import ARCSEC_RAD
from processing.errors import DataError

Floats = NDArray[np.float64]
FEWEST_STEPS = 5
_IMPROBABLE = 0.01
_STANDS_OUT = 3.5
_ASKEW = 0.1
"""Skew that shifts friction and period of a quiet rig by about their uncertainty; 0.03 by a tenth of it."""


@dataclass(frozen=True, slots=True)
class LadderSteps:
    """A ladder in the order in which it was climbed, arrays of one length.

    `reference` is the known tilt in rad or the known shift in m with its standard uncertainty (of
    one setting; a common factor is `u_reference_relative` of the fit). Spots with theirs in px.
    """

    reference: Floats
    u_reference: Floats
    x_px: Floats
    y_px: Floats
    u_x_px: Floats
    u_y_px: Floats


@dataclass(frozen=True, slots=True)
class LadderFit:
    """Regression with errors in both variables.

    ``spot = origin + scale (t + skew t^2) direction`` with t the tangent of twice the tilt, or the
    shift. `scale` is in px per unit of t; `direction_rad` the direction of positive t from the
    sensor's upward vertical towards +x. `skew` is what the nonlinearity test fits,
    `nonlinear_probability` how probable one as large is without any; it is part of the model only
    where `nonlinear`. `hysteresis` is how far upward steps lie above downward ones, in the
    reference's unit, NaN where the ladder was climbed one way only. `leave_one_out` is the change
    of the scale without each step, over its standard uncertainty. `notes` says what stands out.
    """

    kind: Literal["tilt", "shift"]
    scale: float
    u_scale: float
    origin_px: tuple[float, float]
    u_origin_px: tuple[float, float]
    direction_rad: float
    u_direction_rad: float
    skew: float
    u_skew: float
    nonlinear_probability: float
    nonlinear: bool
    hysteresis: float
    u_hysteresis: float
    chi2: float
    dof: int
    leave_one_out: Floats
    residual_px: Floats
    notes: tuple[str, ...]


def fit_ladder(
    steps: LadderSteps, kind: Literal["tilt", "shift"], *, u_reference_relative: float = 0.0
) -> LadderFit:
    """Weighted least squares over the spots and the settings of the reference alike.

    The true setting of every step is a parameter of its own, held to the stated one by its
    uncertainty: orthogonal distance regression (W. A. Fuller, Measurement Error Models, 1987).
    Uncertainties follow the scatter upward only where that is improbable (below 1 %) by chance.

    Raises
    ------
    DataError
        Fewer than five steps, or three different settings; tilts of one sign; uncertainties that
        are not positive; a spot that does not move.
    """
    _check(steps, kind)
    way = _ways(steps.reference)
    both_ways = bool(np.any(way > 0) and np.any(way < 0))
    straight = _solve(steps, kind, way if both_ways else None, bent=False)
    bent = _solve(steps, kind, way if both_ways else None, bent=True)
    gain = max(straight.chi2 - bent.chi2, 0.0)
    # Birge: what scatter is left with the curve is noise, of which the test must not be impressed
    noise = bent.birge
    probability = float(chi2.sf(gain / noise**2, 1))
    nonlinear = probability < _IMPROBABLE
    used = bent if nonlinear else straight
    scale, u_scale = used.scale()
    if not scale > 5.0 * u_scale:
        raise DataError(
            f"lever: the spot does not follow the {kind}s (scale {scale:.4g} +- {u_scale:.2g} px per unit); "
            "check the order of the steps"
        )
    loo = _leave_one_out(steps, kind, way if both_ways else None, nonlinear, scale, u_scale)
    notes = []
    if used.birge > 1.0:
        notes.append(
            f"the steps scatter {used.birge:.2g} times as much as stated; uncertainties were enlarged"
        )
    if nonlinear:
        notes.append(f"not linear: skew {bent.values[4]:.3g} +- {bent.u(4):.2g} is part of the lever")
    elif kind == "tilt" and bent.u(4) > _ASKEW:
        notes.append(
            f"whether the sensor stands askew is known to {math.degrees(math.atan(bent.u(4))):.0f} degrees "
            f"only (skew {bent.values[4]:.2g} +- {bent.u(4):.2g}, taken as 0): set it square to the beam"
        )
    worst = int(np.nanargmax(np.abs(loo)))
    if abs(loo[worst]) > _STANDS_OUT:
        notes.append(
            f"step {worst + 1} at {steps.reference[worst]:.6g} decides: without it the scale changes by "
            f"{abs(loo[worst]):.1f} standard uncertainties"
        )
    hysteresis, u_hysteresis = math.nan, math.nan
    if both_ways:
        hysteresis, u_hysteresis = float(used.values[used.fixed - 1]), used.u(used.fixed - 1)
        if abs(hysteresis) > 3.0 * u_hysteresis:
            notes.append(f"hysteresis of {hysteresis:.3g} +- {u_hysteresis:.2g} between up and down")
    kx, ky = used.values[2], used.values[3]
    u_across = math.sqrt(
        (ky**2 * used.covariance[2, 2] + kx**2 * used.covariance[3, 3] - 2 * kx * ky * used.covariance[2, 3])
        / scale**2
    )
    return LadderFit(
        kind=kind,
        scale=scale,
        u_scale=math.hypot(u_scale, u_reference_relative * scale),
        origin_px=(float(used.values[0]), float(used.values[1])),
        u_origin_px=(used.u(0), used.u(1)),
        direction_rad=math.atan2(kx, -ky),
        u_direction_rad=u_across / scale,
        skew=float(bent.values[4]),
        u_skew=bent.u(4),
        nonlinear_probability=probability,
        nonlinear=nonlinear,
        hysteresis=hysteresis,
        u_hysteresis=u_hysteresis,
        chi2=used.chi2,
        dof=used.dof,
        leave_one_out=loo,
        residual_px=used.residual_px,
        notes=tuple(notes),
    )


def lever_from_tilts(fit: LadderFit, pixel_pitch_m: float) -> Lever:
    """Lever of a ladder of tilts. Only arm over pitch matters: the arm carries all the uncertainty."""
    return Lever(
        arm_m=fit.scale * pixel_pitch_m,
        u_arm_m=fit.u_scale * pixel_pitch_m,
        pixel_pitch_m=pixel_pitch_m,
        skew=fit.skew if fit.nonlinear else 0.0,
        reference_x_px=fit.origin_px[0],
        reference_y_px=fit.origin_px[1],
    )


def lever_from_shifts(fit: LadderFit, arm_m: float, u_arm_m: float) -> Lever:
    """Lever of known shifts of the sensor, which give its pitch, and an arm that was measured otherwise."""
    return Lever(
        arm_m=arm_m,
        u_arm_m=u_arm_m,
        pixel_pitch_m=1.0 / fit.scale,
        u_pixel_pitch_m=fit.u_scale / fit.scale**2,
    )


@dataclass(frozen=True, slots=True)
class _Solution:
    """`fixed` parameters (origin, scale's components, skew, hysteresis) before those of the steps."""

    values: Floats
    covariance: Floats
    fixed: int
    chi2: float
    dof: int
    birge: float
    residual_px: Floats

    def u(self, index: int) -> float:
        return float(np.sqrt(self.covariance[index, index]))

    def scale(self) -> tuple[float, float]:
        k = self.values[2:4]
        scale = float(np.hypot(*k))
        return scale, float(np.sqrt(k @ self.covariance[2:4, 2:4] @ k)) / max(scale, 1e-300)


def _check(steps: LadderSteps, kind: str) -> None:
    count = len(steps.reference)
    if count < FEWEST_STEPS:
        raise DataError(f"lever: a ladder of {count} steps; at least {FEWEST_STEPS} are needed")
    for name in ("reference", "u_reference", "x_px", "y_px", "u_x_px", "u_y_px"):
        values = getattr(steps, name)
        if not np.all(np.isfinite(values)):
            step = int(np.argmin(np.isfinite(values))) + 1
            raise DataError(f"lever: step {step} of the ladder has no {name}; measure it again")
    if not (np.all(steps.u_x_px > 0) and np.all(steps.u_y_px > 0) and np.all(steps.u_reference >= 0)):
        raise DataError(
            "lever: a standard uncertainty is not positive; state u_px and u_reference of each step"
        )
    if len(np.unique(steps.reference)) < 3:
        raise DataError(
            f"lever: the ladder has {len(np.unique(steps.reference))} different settings; "
            "at least 3 are needed"
        )
    if kind == "tilt" and not (np.any(steps.reference > 0) and np.any(steps.reference < 0)):
        raise DataError(
            f"lever: the tilts are all of one sign ({steps.reference.min() / ARCSEC_RAD:.4g} to "
            f"{steps.reference.max() / ARCSEC_RAD:.4g} arcsec); climb to both sides of zero"
        )


def _ways(reference: Floats) -> Floats:
    """+1 for a step that was reached going up, -1 going down; a repeated setting keeps its way."""
    way = np.sign(np.diff(reference))
    for i in range(1, len(way)):
        way[i] = way[i] or way[i - 1]
    first = way[np.flatnonzero(way)[0]] if np.any(way) else 1.0
    way[way == 0] = first
    return np.concatenate([[first], way])


def _solve(steps: LadderSteps, kind: str, way: Floats | None, *, bent: bool) -> _Solution:
    count = len(steps.reference)
    fixed = 4 + bent + (way is not None)

    def carrier(setting: Floats) -> Floats:
        return np.tan(2.0 * setting) if kind == "tilt" else setting

    def slope(setting: Floats) -> Floats:
        return 2.0 / np.cos(2.0 * setting) ** 2 if kind == "tilt" else np.ones_like(setting)

    span = float(np.ptp(carrier(steps.reference)))
    start = np.polyfit(carrier(steps.reference), np.column_stack([steps.x_px, steps.y_px]), 1)
    unit = np.ones(fixed)
    unit[2:4] = 1.0 / span
    if bent:
        unit[4] = 1.0 / span
    if way is not None:
        unit[fixed - 1] = float(np.ptp(steps.reference))

    def parts(p: Floats) -> tuple[Floats, Floats, Floats]:
        setting = steps.reference + steps.u_reference * p[fixed:]
        if way is not None:
            setting = setting + 0.5 * way * p[fixed - 1] * unit[fixed - 1]
        t = carrier(setting)
        skew = p[4] * unit[4] if bent else 0.0
        return setting, t, t * (1.0 + skew * t)

    def residual(p: Floats) -> Floats:
        _, _, along = parts(p)
        kx, ky = p[2] * unit[2], p[3] * unit[3]
        return np.concatenate(
            [
                (p[0] + kx * along - steps.x_px) / steps.u_x_px,
                (p[1] + ky * along - steps.y_px) / steps.u_y_px,
                p[fixed:],
            ]
        )

    def jacobian(p: Floats) -> Floats:
        setting, t, along = parts(p)
        skew = p[4] * unit[4] if bent else 0.0
        by_setting = slope(setting) * (1.0 + 2.0 * skew * t)
        out = np.zeros((3 * count, fixed + count))
        for row, k, u, at in (
            (0, p[2] * unit[2], steps.u_x_px, 0),
            (count, p[3] * unit[3], steps.u_y_px, 1),
        ):
            rows = np.arange(row, row + count)
            out[rows, at] = 1.0 / u
            out[rows, 2 + at] = along * unit[2 + at] / u
            if bent:
                out[rows, 4] = k * t**2 * unit[4] / u
            if way is not None:
                out[rows, fixed - 1] = k * by_setting * 0.5 * way * unit[fixed - 1] / u
            out[rows, fixed + np.arange(count)] = k * by_setting * steps.u_reference / u
        out[2 * count + np.arange(count), fixed + np.arange(count)] = 1.0
        return out

    p0 = np.zeros(fixed + count)
    p0[0:2], p0[2:4] = start[1], start[0] / unit[2:4]
    found = least_squares(residual, p0, jac=jacobian, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    slopes = jacobian(found.x)
    full = np.linalg.inv(slopes.T @ slopes)[:fixed, :fixed] * np.outer(unit, unit)
    total = float(2.0 * found.cost)
    dof = 2 * count - fixed
    birge = math.sqrt(total / dof) if chi2.sf(total, dof) < _IMPROBABLE else 1.0
    values = found.x.copy()
    values[:fixed] *= unit
    _, _, along = parts(found.x)
    residual_px = np.column_stack(
        [steps.x_px - values[0] - values[2] * along, steps.y_px - values[1] - values[3] * along]
    )
    return _Solution(values, full * birge**2, fixed, total, dof, birge, residual_px)


def _leave_one_out(
    steps: LadderSteps, kind: str, way: Floats | None, bent: bool, scale: float, u_scale: float
) -> Floats:
    """Change of the scale without each step in units of that change's own standard uncertainty."""
    change = np.full(len(steps.reference), np.nan)
    for i in range(len(change)):
        rest = LadderSteps(*(np.delete(getattr(steps, name), i) for name in LadderSteps.__slots__))
        left_way = None if way is None else np.delete(way, i)
        if left_way is not None and not (np.any(left_way > 0) and np.any(left_way < 0)):
            left_way = None
        if len(np.unique(rest.reference)) < 3:
            continue
        without, u_without = _solve(rest, kind, left_way, bent=bent).scale()
        spread = math.sqrt(max(u_without**2 - u_scale**2, (0.05 * u_scale) ** 2))
        change[i] = (without - scale) / spread
    return change
