"""A ladder (steps of known tilts, or of known shifts, with the spot's positions) and its scale."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calibration.birge import birge_ratio
from processing.arrays import Floats
from processing.errors import DataError
from processing.number_text import with_uncertainty
from processing.units import ARCSEC_RAD

_MIN_STEPS = 5
"""Smallest number of steps; at most origin, scale, skew and hysteresis are fitted along the motion, so that
one degree of freedom remains.
"""
SKEW_PRIOR_STD = 0.3
"""Prior standard deviation of the skew (a sensor tilted by 17 degrees has this skew)."""
_CUBIC_STD = (3e-4, 1e-3, 5e-3)
"""Prior standard deviations of the cubic part at the ladder's end, relative to the displacement there, all
equally probable. No reference is exactly linear: the part that the steps cannot show is in the uncertainty.
"""
_WRONG_STEP_STD = (6.0, 60.0)
"""Standard deviations of a wrong step, in units of its stated uncertainty."""
_P_WRONG_STEP = 0.02
"""Prior probability that a step is wrong, in equal parts for each of `_WRONG_STEP_STD`."""
_MIN_REPORTED_P = 0.5
"""Probability of a wrong step above which a note reports it."""
_MIN_REPORTED_CUBIC = 3.0
"""Cubic part in standard uncertainties above which a note reports it."""
_FLAT_PRIOR_STD = 1e6
"""Prior standard deviation of an unknown parameter, in units in which the ladder is about 1."""


@dataclass(frozen=True, slots=True)
class LadderSteps:
    """Steps of a ladder in the order of the measurement, arrays (n,)."""

    reference: Floats
    """Known tilts in rad, or known shifts in m."""
    u_reference: Floats
    """Standard uncertainty of each setting, without that of a factor common to all settings."""
    x_px: Floats
    y_px: Floats
    """Mean positions of the spot."""
    u_x_px: Floats
    u_y_px: Floats
    """Standard uncertainties of the positions."""


def check_steps(steps: LadderSteps, kind: str) -> None:
    """Raise DataError for a ladder of this kind ("tilt" or "shift") that cannot be fitted."""
    count = len(steps.reference)
    if count < _MIN_STEPS:
        raise DataError(f"the ladder has {count} of the {_MIN_STEPS} steps that are needed at least")
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
    """Directions of approach (n,): +1 from below, -1 from above; a repeated setting keeps the last one."""
    approach = np.sign(np.diff(reference))
    for i in range(1, len(approach)):
        approach[i] = approach[i] or approach[i - 1]
    first = approach[np.flatnonzero(approach)[0]] if np.any(approach) else 1.0
    approach[approach == 0] = first
    return np.concatenate([[first], approach])


def two_sided_approach(reference: Floats, approach: Floats) -> Floats | None:
    """The directions of approach; None if the steps cannot tell a hysteresis from offset, scale and skew."""
    x = reference / np.abs(reference).max()
    design = np.column_stack([np.ones_like(x), x, x**2, approach])
    return approach if np.linalg.matrix_rank(design) == design.shape[1] else None


class LadderTrace(NamedTuple):
    """A ladder along the motion of the spot, arrays (n,)."""

    t: Floats
    """Tangents of twice the tilt, or shifts in m."""
    position_px: Floats
    u_px: Floats
    """Standard uncertainties of the positions, including those of the reference."""
    d_t_d_hysteresis: Floats | None
    """Derivative of t with respect to the hysteresis; None if hysteresis is not fitted."""


@dataclass(frozen=True, slots=True)
class LadderSolution:
    """Solution of the least-squares problem along and across the motion of the spot.

    Fields that `LadderFit` also has are described there; `skew` is 0 and `hysteresis` NaN where they are not
    fitted.
    """

    scale: float
    u_scale: float
    origin_px: Floats
    u_origin_px: Floats
    direction_rad: float
    u_direction_rad: float
    skew: float
    u_skew: float
    hysteresis: float
    u_hysteresis: float
    chi2: float
    dof: int
    birge: float
    birge_across: float
    """Birge ratios along and across the motion, by which the uncertainties are enlarged."""
    birge_dof: float
    """Degrees of freedom of the scatter that gave `birge`; infinite if `birge` is 1."""
    trace: LadderTrace
    residual_px: Floats


def _fit_line(design: Floats, positions_px: Floats, u_px: Floats) -> tuple[Floats, Floats, float]:
    """Coefficients of a weighted fit, their covariance by the stated uncertainties, and chi-square."""
    weighted = design / u_px[:, None]
    values, *_ = np.linalg.lstsq(weighted, positions_px / u_px, rcond=None)
    unexplained = (positions_px - design @ values) / u_px
    covariance: Floats = np.linalg.pinv(weighted.T @ weighted, hermitian=True).astype(np.float64)
    return values.astype(np.float64), covariance, float(unexplained @ unexplained)


def solve_ladder(steps: LadderSteps, kind: str, approach: Floats | None, *, fit_skew: bool) -> LadderSolution:
    """Least squares, with the skew as a parameter if `fit_skew` and the hysteresis if `approach` is given.

    An error of a setting moves the spot along the motion alone: its uncertainty is added to that of the
    position there (the effective variance of W. A. Fuller, Measurement Error Models, 1987).
    """
    # the spot's position is proportional to t, whose derivative with respect to the setting is `slope`
    t, slope = steps.reference, np.ones_like(steps.reference)
    if kind == "tilt":
        t, slope = np.tan(2.0 * steps.reference), 2.0 / np.cos(2.0 * steps.reference) ** 2
    positions_px = np.column_stack([steps.x_px, steps.y_px])
    direction = np.polyfit(t, positions_px, 1)[0]
    # rows: unit vectors along and across the motion
    rotation = np.array([direction, [-direction[1], direction[0]]]) / np.hypot(*direction)
    u_along_px, u_across_px = np.sqrt(rotation**2 @ np.array([steps.u_x_px, steps.u_y_px]) ** 2)
    u_along_px = np.hypot(u_along_px, np.hypot(*direction) * slope * steps.u_reference)
    along_px, across_px = rotation @ positions_px.T
    columns = [np.ones_like(t), t]
    columns += [t**2] if fit_skew else []
    d_t_d_hysteresis = None if approach is None else 0.5 * approach * slope
    columns += [] if d_t_d_hysteresis is None else [d_t_d_hysteresis]
    design = np.column_stack(columns)
    values, covariance, chi2_along = _fit_line(design, along_px, u_along_px)
    values_across, covariance_across, chi2_across = _fit_line(design[:, :2], across_px, u_across_px)
    dof_along, dof_across = len(t) - len(values), len(t) - 2
    birge, birge_across = birge_ratio(chi2_along, dof_along), birge_ratio(chi2_across, dof_across)
    scale, u_along = float(values[1]), birge * np.sqrt(np.diag(covariance))
    u_across = birge_across * np.sqrt(np.diag(covariance_across))
    origin_px = rotation.T @ [values[0], values_across[0]]
    kx, ky = rotation.T @ [scale, values_across[1]]
    fitted_px = np.outer((design @ values - values[0]) / scale, [kx, ky])
    return LadderSolution(
        scale=scale,
        u_scale=float(u_along[1]),
        origin_px=origin_px,
        u_origin_px=np.sqrt(rotation.T**2 @ np.array([u_along[0], u_across[0]]) ** 2),
        direction_rad=math.atan2(kx, -ky),
        u_direction_rad=float(u_across[1]) / scale,
        skew=float(values[2]) / scale if fit_skew else 0.0,
        u_skew=float(u_along[2]) / scale if fit_skew else 0.0,
        hysteresis=math.nan if approach is None else float(values[-1]) / scale,
        u_hysteresis=math.nan if approach is None else float(u_along[-1]) / scale,
        chi2=chi2_along + chi2_across,
        dof=dof_along + dof_across,
        birge=birge,
        birge_across=birge_across,
        birge_dof=dof_along if birge > 1.0 else math.inf,
        trace=LadderTrace(t, along_px - values[0], u_along_px, d_t_d_hysteresis),
        residual_px=positions_px - origin_px - fitted_px,
    )


def leave_one_out(
    steps: LadderSteps, kind: str, approach: Floats | None, fit_skew: bool, scale: float, u_scale: float
) -> Floats:
    """Changes (n,) of the scale without each step, over the changes' standard uncertainties; NaN: no fit."""
    change = np.full(len(steps.reference), np.nan)
    for i in range(len(change)):
        others = LadderSteps(*(np.delete(getattr(steps, name), i) for name in LadderSteps.__slots__))
        if len(np.unique(others.reference)) < 3:
            continue
        other_approach = (
            None if approach is None else two_sided_approach(others.reference, np.delete(approach, i))
        )
        solution = solve_ladder(others, kind, other_approach, fit_skew=fit_skew)
        spread = math.sqrt(max(solution.u_scale**2 - u_scale**2, (0.05 * u_scale) ** 2))
        change[i] = (solution.scale - scale) / spread
    return change


class ScalePosterior(NamedTuple):
    """Scale in px per unit of t, and deviations from a line, averaged over all models of a ladder."""

    scale: float
    u_scale: float
    cubic: float
    """Cubic part at the ladder's end, relative to the displacement there."""
    u_cubic: float
    p_wrong: Floats
    """Probability (n,) of each step to be wrong."""
    birge: float
    """Factor by which the stated uncertainties of the steps were enlarged."""
    dof: float
    """Degrees of freedom of the scatter that gave `birge`; infinite if `birge` is 1."""


class _Model(NamedTuple):
    """Fit of one model to the steps."""

    log_probability: float
    values: Floats
    covariance: Floats
    chi2: float
    wrong_step: int
    """Index of the wrong step, or -1."""
    extra_dof: int
    """Degrees of freedom that the model uses in addition to those of the simplest one."""


def scale_posterior(steps: LadderTrace, kind: Literal["tilt", "shift"], scale: float) -> ScalePosterior:
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
    posterior, best = _posterior(steps, kind, scale, 1.0)
    # the skew of a stage has no prior, so it uses up a degree of freedom, as the scale does
    count, fitted = len(steps.t), (2 if kind == "tilt" else 3) + (steps.d_t_d_hysteresis is not None)
    # only scatter that no model explains is noise in excess of the stated uncertainties
    birge = birge_ratio(best.chi2, max(count - fitted - best.extra_dof, 1))
    if birge == 1.0:
        return posterior
    dof = max(count - fitted, 1)
    simplest = _fit(steps, kind, scale, _CUBIC_STD[0])
    birge = math.sqrt(max(simplest.chi2 / dof, 1.0))
    return _posterior(steps, kind, scale, birge)[0]._replace(birge=birge, dof=float(dof))


def ladder_notes(posterior: ScalePosterior) -> list[str]:
    """Notes for the user on a significant cubic part, and on steps that are probably wrong."""
    notes = []
    if abs(posterior.cubic) > _MIN_REPORTED_CUBIC * posterior.u_cubic:
        notes.append(
            f"not linear: a cubic part of {with_uncertainty(posterior.cubic, posterior.u_cubic)} of the way "
            "at the ladder's end; the scale is that at zero: look for what bends the reference or the "
            "light's path"
        )
    notes.extend(
        f"step {number} is probably wrong (probability {p_wrong:.2g}) and hardly counts: measure it again"
        for number, p_wrong in enumerate(posterior.p_wrong, 1)
        if p_wrong > _MIN_REPORTED_P
    )
    return notes


def _posterior(
    steps: LadderTrace, kind: Literal["tilt", "shift"], scale: float, birge: float
) -> tuple[ScalePosterior, _Model]:
    """The average over all models by their probabilities, and the most probable model."""
    count = len(steps.t)
    enlarged = steps._replace(u_px=birge * steps.u_px)
    # where all steps scatter by more than stated, wrong ones cannot be recognised
    candidates = range(-1, count if birge == 1.0 else 0)
    models = [
        _fit(enlarged, kind, scale, cubic_std, wrong_step, factor)
        for cubic_std in _CUBIC_STD
        for wrong_step in candidates
        for factor in (_WRONG_STEP_STD if wrong_step >= 0 else (1.0,))
    ]
    logs = np.array([model.log_probability for model in models])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    wrong_steps = np.array([model.wrong_step for model in models])

    def mean_and_u(values: Floats, variances: Floats) -> tuple[float, float]:
        mean = float(weight @ values)
        return mean, math.sqrt(float(weight @ (variances + (values - mean) ** 2)))

    scales = np.array([model.values[1] for model in models])
    mean_scale, u_mean_scale = mean_and_u(scales, np.array([model.covariance[1, 1] for model in models]))
    cubic, u_cubic = mean_and_u(
        np.array([model.values[3] for model in models]) / scales,
        np.array([model.covariance[3, 3] for model in models]) / scales**2,
    )
    p_wrong = np.array([weight[wrong_steps == step].sum() for step in range(count)])
    posterior = ScalePosterior(mean_scale, u_mean_scale, cubic, u_cubic, p_wrong, birge=1.0, dof=math.inf)
    return posterior, models[int(np.argmax(logs))]


def _fit(
    steps: LadderTrace, kind: str, scale: float, cubic_std: float, wrong_step: int = -1, factor: float = 1.0
) -> _Model:
    """Fit of one model in closed form; its parameters are origin, scale, scale times skew, scale times cubic
    part, and hysteresis. The uncertainty of the step `wrong_step` is enlarged by `factor`.
    """
    t = steps.t
    end = float(np.abs(t).max())
    u = steps.u_px * np.where(np.arange(len(t)) == wrong_step, factor, 1.0)
    # prior odds against no wrong step; the steps are independent
    odds = _P_WRONG_STEP / (1.0 - _P_WRONG_STEP) / len(_WRONG_STEP_STD) if wrong_step >= 0 else 1.0
    columns = [np.ones_like(t), t, t**2, t * (t / end) ** 2]
    skew = scale * SKEW_PRIOR_STD if kind == "tilt" else _FLAT_PRIOR_STD * scale / end
    widths = [_FLAT_PRIOR_STD * scale * end, _FLAT_PRIOR_STD * scale, skew, cubic_std * scale]
    if steps.d_t_d_hysteresis is not None:
        columns.append(scale * steps.d_t_d_hysteresis)
        widths.append(_FLAT_PRIOR_STD * end / float(np.abs(steps.d_t_d_hysteresis).max()))
    width = np.array(widths)
    design = np.column_stack(columns) * width / u[:, None]
    position = steps.position_px / u
    precision = design.T @ design + np.eye(len(width))
    values = np.linalg.solve(precision, design.T @ position)
    residual = position - design @ values
    chi2 = float(residual @ residual)
    log_probability = (
        math.log(odds)
        - 0.5 * (chi2 + float(values @ values))
        - 0.5 * float(np.linalg.slogdet(precision)[1])
        - float(np.log(u).sum())
    )
    covariance = np.linalg.inv(precision) * np.outer(width, width)
    extra_dof = (cubic_std > _CUBIC_STD[0]) + (wrong_step >= 0)
    return _Model(log_probability, values * width, covariance, chi2, wrong_step, extra_dof)
