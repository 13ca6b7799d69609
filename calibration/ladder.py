"""A ladder (steps of known tilts, or of known shifts, with the spot's positions) and its scale."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calibration.timebase import birge_ratio
from processing.arrays import Floats
from processing.errors import DataError
from processing.least_squares import solve
from processing.units import ARCSEC_RAD

FEWEST_STEPS = 5
"""Smallest number of steps; at most origin, scale, skew and hysteresis are fitted along the motion, so that
one degree of freedom remains.
"""


@dataclass(frozen=True, slots=True)
class LadderSteps:
    """Steps of a ladder in the order of the measurement, arrays (n,).

    `reference` is the known tilt in rad or the known shift in m, `u_reference` its standard uncertainty in
    one setting (`u_reference_relative` of `fit_ladder` is that of a factor common to all settings). `x_px`
    and `y_px` are the mean positions of the spot, `u_x_px` and `u_y_px` their standard uncertainties.
    """

    reference: Floats
    u_reference: Floats
    x_px: Floats
    y_px: Floats
    u_x_px: Floats
    u_y_px: Floats


def check_steps(steps: LadderSteps, kind: str) -> None:
    """Raise DataError for a ladder of this kind ("tilt" or "shift") that cannot be fitted."""
    count = len(steps.reference)
    if count < FEWEST_STEPS:
        raise DataError(f"the ladder has {count} of the {FEWEST_STEPS} steps that are needed at least")
    for name in ("reference", "u_reference", "x_px", "y_px", "u_x_px", "u_y_px"):
        values = getattr(steps, name)
        if not np.all(np.isfinite(values)):
            step = int(np.argmin(np.isfinite(values))) + 1
            raise DataError(f"step {step} of the ladder has no {name}; measure it again")
    if not (np.all(steps.u_x_px > 0) and np.all(steps.u_y_px > 0) and np.all(steps.u_reference >= 0)):
        raise DataError("a standard uncertainty is not positive; state u_px and u_reference of each step")
    if len(np.unique(steps.reference)) < 3:
        raise DataError(
            f"the ladder has {len(np.unique(steps.reference))} different settings; at least 3 are needed"
        )
    if kind == "tilt" and not (np.any(steps.reference > 0) and np.any(steps.reference < 0)):
        raise DataError(
            f"the tilts are all of one sign ({steps.reference.min() / ARCSEC_RAD:.4g} to "
            f"{steps.reference.max() / ARCSEC_RAD:.4g} arcsec); measure on both sides of zero"
        )


def approach_directions(reference: Floats) -> Floats:
    """Directions of approach (n,): +1 from below, -1 from above; that of the setting before if repeated."""
    way = np.sign(np.diff(reference))
    for i in range(1, len(way)):
        way[i] = way[i] or way[i - 1]
    first = way[np.flatnonzero(way)[0]] if np.any(way) else 1.0
    way[way == 0] = first
    return np.concatenate([[first], way])


def approach_if_both(way: Floats) -> Floats | None:
    """The directions of approach if both occur, so that a hysteresis can be fitted; else None."""
    return way if np.any(way > 0) and np.any(way < 0) else None


@dataclass(frozen=True, slots=True)
class LadderSolution:
    """Solution of the least-squares problem.

    The first `fixed` of `values` are origin (x, y), scale (x, y), then skew and hysteresis if they are
    fitted. The others are the deviations of the steps' true settings from the stated ones in units of
    `u_reference`. `covariance` (fixed, fixed) is that of the first ones, enlarged along the motion by
    `birge`, across it by `birge_across`. `along_dof` are the degrees of freedom of `birge`, infinite if it is
    1. `residual_px` (n, 2) are the positions minus those of the fitted ladder at the stated settings, not at
    the true ones, which the fit moves towards a wrong position until little of its error is left.
    """

    values: Floats
    covariance: Floats
    fixed: int
    chi2: float
    dof: int
    birge: float
    birge_across: float
    along_dof: float
    residual_px: Floats

    def u(self, index: int) -> float:
        return float(np.sqrt(self.covariance[index, index]))

    def scale(self) -> tuple[float, float]:
        k = self.values[2:4]
        scale = float(np.hypot(*k))
        return scale, float(np.sqrt(k @ self.covariance[2:4, 2:4] @ k)) / max(scale, 1e-300)


def carrier(setting: Floats, kind: str) -> tuple[Floats, Floats]:
    """Tangents of twice the tilts, or the shifts, to which the spot's position is proportional, and their
    derivatives with respect to the settings."""
    if kind == "tilt":
        return np.tan(2.0 * setting), 2.0 / np.cos(2.0 * setting) ** 2
    return setting, np.ones_like(setting)


def solve_ladder(steps: LadderSteps, kind: str, way: Floats | None, *, with_skew: bool) -> LadderSolution:
    """Least squares, with the skew as a parameter if `with_skew` and the hysteresis if `way` is given."""
    count = len(steps.reference)
    fixed = 4 + with_skew + (way is not None)

    stated, _ = carrier(steps.reference, kind)
    span = float(np.ptp(stated))
    start = np.polyfit(stated, np.column_stack([steps.x_px, steps.y_px]), 1)
    unit = np.ones(fixed)
    unit[2:4] = 1.0 / span
    if with_skew:
        unit[4] = 1.0 / span
    if way is not None:
        unit[fixed - 1] = float(np.ptp(steps.reference))

    def parts(p: Floats) -> tuple[Floats, Floats, Floats]:
        """t, its derivative with respect to the setting, and the displacement over the scale."""
        setting = steps.reference + steps.u_reference * p[fixed:]
        if way is not None:
            setting = setting + 0.5 * way * p[fixed - 1] * unit[fixed - 1]
        t, slope = carrier(setting, kind)
        skew = p[4] * unit[4] if with_skew else 0.0
        return t, slope, t * (1.0 + skew * t)

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
        t, slope, along = parts(p)
        skew = p[4] * unit[4] if with_skew else 0.0
        by_setting = slope * (1.0 + 2.0 * skew * t)
        out = np.zeros((3 * count, fixed + count))
        for row, k, u, at in (
            (0, p[2] * unit[2], steps.u_x_px, 0),
            (count, p[3] * unit[3], steps.u_y_px, 1),
        ):
            rows = np.arange(row, row + count)
            out[rows, at] = 1.0 / u
            out[rows, 2 + at] = along * unit[2 + at] / u
            if with_skew:
                out[rows, 4] = k * t**2 * unit[4] / u
            if way is not None:
                out[rows, fixed - 1] = k * by_setting * 0.5 * way * unit[fixed - 1] / u
            out[rows, fixed + np.arange(count)] = k * by_setting * steps.u_reference / u
        out[2 * count + np.arange(count), fixed + np.arange(count)] = 1.0
        return out

    p0 = np.zeros(fixed + count)
    p0[0:2], p0[2:4] = start[1], start[0] / unit[2:4]
    found = solve(lambda p: (residual(p), jacobian(p)), p0)
    full = found.covariance[:fixed, :fixed] * np.outer(unit, unit)
    values = found.values.copy()
    values[:fixed] *= unit
    _, _, along = parts(found.values)

    def off(along: Floats) -> Floats:
        """Positions (n, 2) minus those of the fitted ladder with these displacements over the scale."""
        return np.column_stack(
            [steps.x_px - values[0] - values[2] * along, steps.y_px - values[1] - values[3] * along]
        )

    off_true_px = off(along)
    # rows: unit vectors along and across the motion
    turn = np.array([values[2:4], [-values[3], values[2]]]) / np.hypot(values[2], values[3])
    u_px = np.sqrt(turn**2 @ np.array([steps.u_x_px, steps.u_y_px]) ** 2)
    chi2_along, chi2_across = (((turn @ off_true_px.T) / u_px) ** 2).sum(axis=1)
    chi2_along += float(found.values[fixed:] @ found.values[fixed:])
    dof_along, dof_across = count - fixed + 2, count - 2
    birge, birge_across = birge_ratio(chi2_along, dof_along), birge_ratio(chi2_across, dof_across)
    enlargement = np.eye(fixed) * birge
    for at in (0, 2):
        enlargement[at : at + 2, at : at + 2] = turn.T @ np.diag([birge, birge_across]) @ turn
    return LadderSolution(
        values,
        enlargement @ full @ enlargement,
        fixed,
        found.chi2,
        2 * count - fixed,
        birge,
        birge_across,
        dof_along if birge > 1.0 else math.inf,
        off(parts(np.concatenate([found.values[:fixed], np.zeros(count)]))[2]),
    )


def leave_one_out(
    steps: LadderSteps, kind: str, way: Floats | None, with_skew: bool, scale: float, u_scale: float
) -> Floats:
    """Changes (n,) of the scale without each step, over their own standard uncertainties; NaN: no fit."""
    change = np.full(len(steps.reference), np.nan)
    for i in range(len(change)):
        rest = LadderSteps(*(np.delete(getattr(steps, name), i) for name in LadderSteps.__slots__))
        rest_way = None if way is None else approach_if_both(np.delete(way, i))
        if len(np.unique(rest.reference)) < 3:
            continue
        without, u_without = solve_ladder(rest, kind, rest_way, with_skew=with_skew).scale()
        spread = math.sqrt(max(u_without**2 - u_scale**2, (0.05 * u_scale) ** 2))
        change[i] = (without - scale) / spread
    return change


SKEW_PRIOR_STD = 0.3
"""Prior standard deviation of the skew, which is that of a sensor tilted by 17 degrees."""
_CUBIC_STD = (3e-4, 1e-3, 1e-2)
"""Prior standard deviations of the cubic part at the ladder's end, relative to the displacement there, all
equally probable. No reference is quite linear: what the steps do not show of it is part of the uncertainty.
"""
_P_WRONG = 0.01
"""Prior probability that a step is wrong."""
_WRONG_STEP_STD = (6.0, 60.0)
"""Standard deviations of a wrong step, in units of its stated uncertainty."""
_MIN_NOTED_P = 0.5
"""Probability of a wrong step above which a note reports it."""
_MIN_NOTED_U = 3.0
"""Cubic part in standard uncertainties above which a note reports it."""
_FLAT_PRIOR_STD = 1e6
"""Prior standard deviation of an unknown parameter, in units in which the ladder is about 1."""


class LadderTrace(NamedTuple):
    """A ladder along the motion of the spot, arrays (n,).

    `t` is the tangent of twice the tilt, or the shift in m; `place_px` the position of the spot. `u_px`
    includes the reference's uncertainty. `by_hysteresis` is the derivative of t with respect to the
    hysteresis, None if all settings were approached from one side.
    """

    t: Floats
    place_px: Floats
    u_px: Floats
    by_hysteresis: Floats | None


class ScaleEvidence(NamedTuple):
    """Scale in px per unit of t, its standard uncertainty, and the deviations from a line.

    `cubic` is the relative size of the cubic part at the ladder's end, with its uncertainty. `wrong` (n,) is
    each step's probability to be wrong. `birge` enlarges the stated uncertainties, with `dof` degrees of
    freedom (infinite where it is 1).
    """

    scale: float
    u_scale: float
    cubic: float
    u_cubic: float
    wrong: Floats
    birge: float
    dof: float


class _Model(NamedTuple):
    """Fit of one model: logarithm of its probability, parameters, their covariance, chi-square of the steps.

    `wrong` is the number of the wrong step, or -1; `spent` are the degrees of freedom that the model uses in
    addition to those of the simplest.
    """

    log_probability: float
    values: Floats
    covariance: Floats
    chi2: float
    wrong: int
    spent: int


def scale_evidence(steps: LadderTrace, kind: Literal["tilt", "shift"], scale: float) -> ScaleEvidence:
    """The scale at t = 0, averaged over all models by their probabilities.

    Parameters
    ----------
    steps
        The ladder along its motion.
    kind
        The skew of a ladder of tilts comes from a tilted sensor, and has a prior; a stage of shifts may be
        bent by any cause, and its skew has none.
    scale
        An estimate of the scale in px per unit of t, accurate to a percent.
    """
    found, best = _posterior(steps, kind, scale, 1.0)
    # the skew of a stage has no prior, so it uses up a degree of freedom, as the scale does
    count, used = len(steps.t), (2 if kind == "tilt" else 3) + (steps.by_hysteresis is not None)
    # only scatter that no model explains is noise in excess of the stated uncertainties
    birge = birge_ratio(best.chi2, max(count - used - best.spent, 1))
    if birge == 1.0:
        return found
    dof = max(count - used, 1)
    plain = _fit(steps, kind, scale, _CUBIC_STD[0])
    birge = math.sqrt(max(plain.chi2 / dof, 1.0))
    return _posterior(steps, kind, scale, birge)[0]._replace(birge=birge, dof=float(dof))


def ladder_notes(evidence: ScaleEvidence) -> list[str]:
    """Notes for the user on a cubic part that is seen, and on steps that are probably wrong."""
    notes = []
    if abs(evidence.cubic) > _MIN_NOTED_U * evidence.u_cubic:
        notes.append(
            f"not linear: a cubic part of {evidence.cubic:.2g} ± {evidence.u_cubic:.2g} of the way at the "
            f"ladder's end; the scale is that at zero: look for what bends the reference or the light's path"
        )
    notes.extend(
        f"step {number} is probably wrong (probability {p_wrong:.2g}) and hardly counts: measure it again"
        for number, p_wrong in enumerate(evidence.wrong, 1)
        if p_wrong > _MIN_NOTED_P
    )
    return notes


def _posterior(
    steps: LadderTrace, kind: Literal["tilt", "shift"], scale: float, birge: float
) -> tuple[ScaleEvidence, _Model]:
    """The evidence of all models, and the most probable one."""
    count = len(steps.t)
    enlarged = steps._replace(u_px=birge * steps.u_px)
    # where all steps scatter by more than stated, wrong ones cannot be recognised
    suspects = range(-1, count if birge == 1.0 else 0)
    models = [
        _fit(enlarged, kind, scale, cubic_std, wrong, by)
        for cubic_std in _CUBIC_STD
        for wrong in suspects
        for by in (_WRONG_STEP_STD if wrong >= 0 else (1.0,))
    ]
    logs = np.array([model.log_probability for model in models])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    at = np.array([model.wrong for model in models])

    def mean(values: Floats, variances: Floats) -> tuple[float, float]:
        middle = float(weight @ values)
        return middle, math.sqrt(float(weight @ (variances + (values - middle) ** 2)))

    scales = np.array([model.values[1] for model in models])
    found, u_found = mean(scales, np.array([model.covariance[1, 1] for model in models]))
    cubic, u_cubic = mean(
        np.array([model.values[3] for model in models]) / scales,
        np.array([model.covariance[3, 3] for model in models]) / scales**2,
    )
    wrong = np.array([weight[at == k].sum() for k in range(count)])
    evidence = ScaleEvidence(found, u_found, cubic, u_cubic, wrong, birge=1.0, dof=math.inf)
    return evidence, models[int(np.argmax(logs))]


def _fit(
    steps: LadderTrace, kind: str, scale: float, cubic_std: float, wrong: int = -1, by: float = 1.0
) -> _Model:
    """Fit of one model in closed form; its parameters are origin, scale, scale times skew, scale times cubic
    part, and hysteresis. The uncertainty of the step `wrong` is enlarged by the factor `by`.
    """
    t = steps.t
    end = float(np.abs(t).max())
    u = steps.u_px * np.where(np.arange(len(t)) == wrong, by, 1.0)
    p_steps = 1.0 - len(t) * _P_WRONG if wrong < 0 else _P_WRONG / len(_WRONG_STEP_STD)
    columns = [np.ones_like(t), t, t**2, t * (t / end) ** 2]
    skew = scale * SKEW_PRIOR_STD if kind == "tilt" else _FLAT_PRIOR_STD * scale / end
    widths = [_FLAT_PRIOR_STD * scale * end, _FLAT_PRIOR_STD * scale, skew, cubic_std * scale]
    if steps.by_hysteresis is not None:
        columns.append(scale * steps.by_hysteresis)
        widths.append(_FLAT_PRIOR_STD * end / float(np.abs(steps.by_hysteresis).max()))
    width = np.array(widths)
    design = np.column_stack(columns) * width / u[:, None]
    position = steps.place_px / u
    precision = design.T @ design + np.eye(len(width))
    values = np.linalg.solve(precision, design.T @ position)
    residual = position - design @ values
    chi2 = float(residual @ residual)
    log_probability = (
        math.log(max(p_steps, _P_WRONG))
        - 0.5 * (chi2 + float(values @ values))
        - 0.5 * float(np.linalg.slogdet(precision)[1])
        - float(np.log(u).sum())
    )
    covariance = np.linalg.inv(precision) * np.outer(width, width)
    spent = (cubic_std > _CUBIC_STD[0]) + (wrong >= 0)
    return _Model(log_probability, values * width, covariance, chi2, wrong, spent)
