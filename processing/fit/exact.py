"""Joint fit of the exact half-swing map to all amplitudes and times, on ground that may move."""

from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import AMPLITUDE, DEFAULT_LAW, DRAG, TIME, Law
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.checks import (
    FEWEST_HALF_CYCLES,
    OUTLIER,
    check_turning_points,
    data_warnings,
    of_correlation,
    of_ground,
    of_limits,
    of_overstated,
)
from processing.fit.evidence import AIR, NO_EVIDENCE, WAVEFORM, Evidence
from processing.fit.exact_model import ExactModel
from processing.fit.ground import AT_REST, GROUND_SEEN, GroundFit, Noise, density_of_step
from processing.fit.noise_estimate import LikeliestNoise, NoiseSearch
from processing.fit.result import FitResult
from processing.fit.whiteness import Whiteness, correlated_covariance, neighbours_covariance, whiteness
from processing.fit_method import FitMethod
from processing.least_squares import Loss, Solution, covariance_of, propagate, solve
from processing.periods import full_periods, mean_period, mean_period_estimate
from processing.swing import TurningPoints

_GOOD_CHI2 = 1.5
"""Reduced chi-square above which a minimum may be a local one; other start values are tried then."""
_GOOD_EVIDENCE = 8.0
"""Mean square of the residuals of the evidence above which it may be a local one, too: a strong drive gives
any turning points a good chi-square."""
_ROUNDS = 12
"""Most alternations of noise and parameters; two or three suffice."""
_STEPS = 60
"""Most steps of one alternation; the last search has as many as it needs."""
_SETTLED = 0.02
"""Change of the parameters, in standard uncertainties, below which the alternation ends."""
_NEAR = 0.5
"""Change of the parameters, in standard uncertainties, over which the evidence is taken as linear."""
_WEAKEST = 10.0
"""Smallest amplitude fitted, in steps of the drive: amplitude and phase do not describe a smaller motion."""


class _Settled(NamedTuple):
    """A minimum: the model with its weights, and the noise that belongs to it."""

    model: ExactModel
    solution: Solution
    likeliest: LikeliestNoise


def _settle(model: ExactModel, start: Floats, loss: Loss, kind: Noise) -> _Settled | None:
    """Noise and parameters in turn from one start, until both stay; None if it does not converge."""
    columns = start
    noise: Noise | None = None
    near: ExactModel | None = None
    moved = np.full(len(start), np.inf)
    for _ in range(_ROUNDS):
        try:
            if near is None or not np.all(moved[np.isfinite(moved)] < _NEAR):
                near = model.about(columns)
            likeliest = NoiseSearch(near, columns, loss, kind).likeliest()
            if not np.isfinite(likeliest.deviance):
                return None
            here = near.on_ground(columns, _kept(likeliest.noise), likeliest.noise.scale)
            solution = solve(
                here,
                columns,
                lower=model.lower,
                upper=model.upper,
                loss=loss,
                cost_tolerance=1e-9,
                max_evaluations=_STEPS,
            )
        except DataError:
            return None
        moved = np.abs(solution.values - columns) / np.sqrt(np.diag(solution.covariance))
        columns = solution.values
        same = noise is not None and abs(likeliest.noise.step - noise.step) <= 0.01 * noise.step
        if same and np.all(moved[np.isfinite(moved)] < _SETTLED):
            break
        noise = likeliest.noise
    final = solve(here, columns, lower=model.lower, upper=model.upper, loss=loss)
    return _Settled(here, final, likeliest) if final.converged else None


def _kept(noise: Noise) -> Noise:
    """The noise by which residuals are weighted; chi2/dof then shows the scale of the uncertainties."""
    return AT_REST if noise.at_rest else noise.in_stated_uncertainties


def _best(model: ExactModel, loss: Loss, kind: Noise, near: FitResult | None) -> _Settled:
    """Likeliest minimum over the start values; the first one is accepted if it fits the data."""
    best: _Settled | None = None
    tried = 0
    for start in chain(model.start_near(near), model.starts()):
        tried += 1
        found = _settle(model, start, loss, kind)
        if found is None:
            continue
        if best is None or found.likeliest.deviance < best.likeliest.deviance:
            best = found
        if best.likeliest.noise.scale**2 < _GOOD_CHI2 and _believed(best):
            break
    if not tried:
        raise DataError("no start from which the half-swing map reaches the last half-cycle")
    if best is None:
        raise DataError(
            f"the exact fit did not converge from {tried} starts: the amplitudes are no decay that the "
            "law describes; see which half-cycles are disturbed, or start higher"
        )
    return best


def _believed(found: _Settled) -> bool:
    """Whether the minimum agrees with the evidence."""
    beside = found.model.beside(found.solution.values)[0]
    return float(beside @ beside) <= _GOOD_EVIDENCE * len(beside) + _GOOD_EVIDENCE


def fit_exact(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    *,
    law: Law = DEFAULT_LAW,
    drag: bool = False,
    evidence: Evidence = NO_EVIDENCE,
    loss: Loss = "linear",
    averaged: bool = True,
    near: FitResult | None = None,
) -> FitResult:
    """Fit the exact half-swing map to amplitudes and times of the turning points, jointly.

    Parameters
    ----------
    points
        Turning points in rad; at least ten. Half-cycles may be missing (gaps in `index`); the map is applied
        to them as well.
    pendulum
        None if the amplitudes are not calibrated (pixels, volts). R/a, whose effect is a few per mille, is
        then set to zero, ``kappa`` replaces ``gamma_pa``, and the result contains a warning.
    law
        A law of the registry, or another one.
    drag
        Also fit a linear drag, moment ``-m g R drag_s phi'``.
    evidence
        What restrains the fit beside the turning points.
    loss
        ``linear``, or a robust loss that reduces the influence of outliers.
    averaged
        The turning points were measured on the samples of their half-cycles, as the swing detector
        does. False: amplitude and time are those of the instant at which the pendulum turns.
    near
        An exact fit of nearly the same points, from which the search starts before it starts again.

    Raises
    ------
    DataError
        Turning points that cannot be fitted (see `check_turning_points`), no convergence, or a ground
        that drives the pendulum as strongly as it swings.

    Notes
    -----
    Only b is forced to be positive. c, gamma and the drag may become negative, so that the estimate of a
    coefficient near zero is unbiased and its interval covers the true value. See `identifiability`.

    Turning points scatter by their measurement and because the ground drives the pendulum. Both variances are
    estimated along with the parameters (`NoiseSearch`). If there is no drive, the residuals are the
    distances from one free decay; if there is, those from the predictions of a Kalman filter.
    """
    check_turning_points(points)
    kind = Noise(averaged=averaged, limit=np.inf if loss == "linear" else OUTLIER)
    kept = points
    while True:
        model = ExactModel(kept, pendulum, law=law, drag=drag, evidence=evidence)
        found = _best(model, loss, kind, near)
        weakest = _WEAKEST * found.likeliest.noise.step * model.reference
        lost = np.nonzero(kept.amplitude < weakest)[0]
        if not len(lost):
            break
        if lost[0] < FEWEST_HALF_CYCLES:
            raise DataError(
                "the ground drives the pendulum as strongly as it swings: amplitudes below "
                f"{weakest:.2g} are lost in its motion, which leaves {lost[0]} half-cycles; start higher, or "
                "wait for a quieter hour"
            )
        kept = kept.first(int(lost[0]))
    search = NoiseSearch(found.model, found.solution.values, loss, kind)
    bounds = search.bounds(found.likeliest)
    half_period_s = 0.5 * mean_period(kept)
    step, reference = found.likeliest.noise.step, model.reference
    ground = GroundFit(
        density_rad_per_s2_rthz=Estimate(
            density_of_step(step * reference, half_period_s),
            density_of_step(bounds.u_step * reference, half_period_s),
        ),
        upper_95=density_of_step(bounds.highest_step * reference, half_period_s),
        noise=replace(found.likeliest.noise, step=step * reference),
        seen=found.likeliest.against_rest > GROUND_SEEN,
        measurement_scale=found.likeliest.noise.scale,
        left_out_half_cycles=len(points) - len(kept),
        deviance=found.likeliest.deviance,
        unrestricted=found.likeliest.unrestricted,
    )
    averaged_over = search.averaged_covariance(found.likeliest, bounds)
    return _result(found.model, found.solution, ground, loss, found.likeliest.covariance, averaged_over)


def fit_exact_with(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    like: FitResult,
    *,
    drag: bool,
) -> FitResult:
    """The exact fit of another model to the same turning points, with the noise of an earlier fit of them.

    Models are compared with one noise: each with its own would call what it lacks a drive.
    """
    if like.ground is None:
        raise DataError(f"the {like.method} fit has no noise that another fit could take over")
    model = ExactModel(
        points.first(like.half_cycles), pendulum, law=like.law, drag=drag, evidence=like.evidence
    )
    noise, scale = model.noise_of(like), like.ground.measurement_scale
    best: tuple[ExactModel, Solution] | None = None
    for columns in chain(model.start_near(like), model.starts()):
        try:
            for _ in range(3):
                here = model.on_ground(columns, noise, scale).about(columns)
                solution = solve(here, columns, lower=model.lower, upper=model.upper, loss=like.loss)
                columns = solution.values
                if noise.at_rest and like.evidence == NO_EVIDENCE:
                    break
        except DataError:
            continue
        if solution.converged and (best is None or solution.cost < best[1].cost):
            best = here, solution
        if best is not None and 2 * best[1].cost / best[1].dof < _GOOD_CHI2:
            break
    if best is None:
        raise DataError("the exact fit did not converge with the noise of the earlier one")
    return _result(*best, like.ground, like.loss)


def _result(
    model: ExactModel,
    solution: Solution,
    ground: GroundFit,
    loss: Loss,
    likeliest: Floats | None = None,
    averaged: Floats | None = None,
) -> FitResult:
    """Physical values, their uncertainties and what is to be said of them.

    `averaged` over the noise that the data allow and at the `likeliest` are covariances of the columns;
    their ratio enlarges the uncertainties.
    """
    points, pendulum = model.points, model.pendulum
    amplitude, time, _, _ = model.curve(solution.values)
    deviation = np.abs(points.amplitude - amplitude * model.reference) / points.amplitude
    values, to_physical = model.columns.physical(solution.values)
    chi2_per_dof = solution.chi2 / solution.dof
    scatter = solution.covariance * (max(1.0, chi2_per_dof) if loss == "linear" else 1.0)
    covariance = propagate(to_physical, scatter)
    widened = np.ones(len(covariance))
    if likeliest is not None and averaged is not None:
        # never smaller: a drive that was seen may still be larger than the likeliest one
        widened *= np.maximum(1.0, _factor(to_physical, averaged, likeliest))
    of_points = solution.residuals[: 2 * len(points)]
    white = whiteness(of_points / np.sqrt(max(1.0, chi2_per_dof)))
    if np.all(np.isfinite(covariance)):
        factor = _by_correlation(to_physical, solution, white, len(points))
        white = replace(white, widened=float(factor.max()))
        widened *= factor
    covariance = covariance * np.outer(widened, widened)
    by_air = _by_air(model, solution)
    if by_air is not None:
        by_air = (
            widened * (to_physical @ by_air) * (max(1.0, chi2_per_dof) ** 0.5 if loss == "linear" else 1.0)
        )

    count = len(points)
    normalised = np.abs(of_points)
    outlying = (normalised[:count] > OUTLIER) | (normalised[count:] > OUTLIER)
    periods = full_periods(points)
    period_model = time[periods.where + 1] - time[periods.where - 1]
    period_deviation = np.abs(periods.period_s - period_model) / periods.period_s
    return FitResult(
        method=FitMethod.EXACT,
        law=model.law,
        names=model.names,
        values=values,
        covariance=covariance,
        chi2_per_dof=chi2_per_dof,
        degrees_of_freedom=solution.dof,
        arae_decay=_mean_of_finite(deviation),
        arae_period=_mean_of_finite(period_deviation),
        reference_rad=model.reference,
        by_log_rho=to_physical @ model.by_log_rho(solution.values),
        mean_period_s=mean_period_estimate(points, chi2_per_dof),
        loss=loss,
        cost=solution.cost,
        outliers=tuple(int(i) for i in points.index[outlying]),
        warnings=(
            *data_warnings(points, pendulum, {"amplitudes and times": chi2_per_dof}, ground.noise.step),
            *of_overstated(chi2_per_dof, solution.dof),
            *of_ground(ground, points),
            *of_correlation(white),
            *of_limits(model.columns.at_limit(solution.values)),
        ),
        half_cycles=count,
        ground=ground,
        reading_covariance=propagate(to_physical, _of_reading(model, solution)),
        widened=widened,
        whiteness=white,
        evidence=model.evidence_at(solution.values, scatter),
        by_air=by_air,
        worth=_worth(model, solution, to_physical),
    )


def _rows_beside(model: ExactModel) -> dict[str, slice]:
    """Rows of the residuals in which each part of the evidence stands."""
    first, count = 2 * len(model.points), len(model.beside(np.zeros(len(model.lower)))[0])
    last = first + count - (model.evidence.drag_s is not None and DRAG.key in model.names)
    rows = {WAVEFORM: slice(first, last), AIR: slice(last, first + count)}
    return {name: part for name, part in rows.items() if part.start < part.stop}


def _by_air(model: ExactModel, solution: Solution) -> Floats | None:
    """Change of the columns for one standard uncertainty of what is known of the drag; None without."""
    rows = _rows_beside(model).get(AIR)
    if rows is None or not np.all(np.isfinite(solution.covariance)):
        return None
    return np.asarray(solution.covariance @ solution.jacobian[rows][0])


def _worth(model: ExactModel, solution: Solution, to_physical: Floats) -> dict[str, dict[str, float]]:
    """By how many times larger uncertainties would be without a part of the evidence."""
    worth = {}
    whole = covariance_of(solution.jacobian)
    for part, rows in _rows_beside(model).items():
        without = covariance_of(np.delete(solution.jacobian, rows, axis=0))
        factor = _factor(to_physical, without, whole)
        blind = ~np.isfinite(np.einsum("ij,jk,ik->i", to_physical, without, to_physical))
        factor = np.where(blind, np.inf, factor)
        kept = (name not in (AMPLITUDE.key, TIME.key) for name in model.names)
        worth[part] = {
            name: float(one) for name, one, stays in zip(model.names, factor, kept, strict=True) if stays
        }
    return worth


def _factor(to_physical: Floats, wider: Floats, covariance: Floats) -> Floats:
    """Ratio of the standard uncertainties by two covariances of the columns."""
    above, below = (np.einsum("ij,jk,ik->i", to_physical, one, to_physical) for one in (wider, covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(above / below, nan=1.0, posinf=1.0)
        return np.asarray(np.sqrt(np.maximum(ratio, 0.0)))


def _of_reading(model: ExactModel, solution: Solution) -> Floats:
    """Covariance of the columns if only the measurement of the turning points were uncertain."""
    residuals, jacobian = model.on_ground(solution.values, AT_REST, model.scale)(solution.values)
    reached = np.isfinite(residuals)
    return np.asarray(covariance_of(jacobian[reached]) * max(1.0, solution.chi2 / solution.dof))


def _mean_of_finite(values: Floats) -> float:
    """The free decay may end before a driven one does."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if len(finite) else float("nan")


def _by_correlation(to_physical: Floats, solution: Solution, white: Whiteness, count: int) -> Floats:
    """By how many times correlated residuals enlarge every standard uncertainty."""
    of_points = slice(2 * count)
    jacobian, covariance = solution.jacobian[of_points], solution.covariance
    factor = _factor(to_physical, neighbours_covariance(white, jacobian, covariance), covariance)
    if white.correlated:
        residuals = solution.residuals[of_points] / np.sqrt(solution.chi2 / solution.dof)
        wider = correlated_covariance(residuals, jacobian, covariance, white.lags)
        factor = np.maximum(factor, _factor(to_physical, wider, covariance))
    return np.asarray(np.maximum(1.0, factor))
