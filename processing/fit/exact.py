"""Joint fit of the exact half-swing map to all amplitudes and times, on ground that may move."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import DEFAULT_LAW, DRAG, Law
from processing.decay_summary import mean_period
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import FEWEST_HALF_CYCLES, OUTLIER, check_turning_points, result_of
from processing.fit.ground import AT_REST, GROUND_SEEN, GroundFit, Noise, density_of_step
from processing.fit.noise_estimate import LikeliestNoise, NoiseSearch
from processing.fit.result import FitResult
from processing.least_squares import Loss, Solution, solve
from processing.number_text import plain
from processing.swing import TurningPoints

_GOOD_CHI2 = 1.5
"""Reduced chi-square above which a minimum may be a local one; other start values are tried then."""
_GOOD_EVIDENCE = 8.0
"""Mean square of the evidence's residuals above which a minimum may be a local one, too: a strong drive gives
any turning points a good chi-square."""
_MAX_ITERATIONS = 12
"""Most alternations of noise and parameters; two or three suffice."""
_STEPS = 60
"""Most steps of one alternation; the last search has as many as it needs."""
_MOST_LINEARISED = 24
"""Most fits to a partly linearised model; one that lacks an effect in the data converges slowly."""
_CONVERGED_U = 0.02
"""Change of the parameters, in standard uncertainties, below which the alternation ends."""
_LINEAR_U = 0.5
"""Change of the parameters, and error of the evidence, in standard uncertainties, up to which the evidence is
taken as linear."""
_LINEAR_SHARE = 0.01
"""The same error as a share of the evidence, where that contradicts the law."""
_HALVINGS = 8
"""Most times that a step is halved until the evidence itself agrees that it descends."""
_WEAKEST = 10.0
"""Smallest amplitude fitted, in steps of the drive: amplitude and phase do not describe a smaller motion."""


class _Minimum(NamedTuple):
    """A minimum: the model with its weights, and the noise that belongs to it."""

    model: ExactModel
    solution: Solution
    likeliest: LikeliestNoise


def _minimum_from(model: ExactModel, start: Floats, loss: Loss, kind: Noise) -> _Minimum | None:
    """The minimum from one start, noise and parameters in turn until both stay; None without convergence."""
    columns = start
    noise: Noise | None = None
    near: ExactModel | None = None
    near_enough = False
    for _ in range(_MAX_ITERATIONS):
        try:
            if near is None or not near_enough:
                near = model.linearised_at(columns)
            likeliest = NoiseSearch(near, columns, loss, kind).likeliest()
            if not np.isfinite(likeliest.deviance):
                return None
            here = near.on_ground(columns, _as_weights(likeliest.noise), likeliest.noise.scale)
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
        stays = np.array_equal(solution.values, columns)
        moved = _largest_move(columns, solution)
        near_enough = moved < _LINEAR_U and _evidence_is_linear(here, solution.values)
        columns = solution.values if near_enough else _part_that_descends(here, columns, solution.values)
        same = noise is not None and abs(likeliest.noise.step - noise.step) <= 0.01 * noise.step
        if same and near_enough and moved < _CONVERGED_U:
            break
        noise = likeliest.noise
    if not _evidence_is_linear(here, columns):
        # what was minimised is not this law's evidence
        return None
    # where the last search found no step, a finer tolerance would find none either
    final = solution
    if not stays:
        final = solve(here, columns, lower=model.lower, upper=model.upper, loss=loss)
    return _Minimum(here, final, likeliest) if final.converged else None


def _evidence_is_linear(model: ExactModel, columns: Floats) -> bool:
    """Whether the evidence here is what it is by its linearisation, but for a part of its uncertainty."""
    linear = model.evidence_rows(columns)[0]
    try:
        itself = model.evidence_residuals(columns)
    except DataError:
        return False
    off, whole = float(np.linalg.norm(itself - linear)), float(np.linalg.norm(itself))
    return off <= max(_LINEAR_U, _LINEAR_SHARE * whole)


def _part_that_descends(model: ExactModel, before: Floats, after: Floats) -> Floats:
    """The end of a step, or of its largest part that lowers the sum of squares with the evidence itself.

    The step was found with linear evidence, which far from `before` may be wrong by any factor. It is taken
    whole where no part of it descends, as in a bent valley out of which every straight way leads.
    """
    lowest = _sum_of_squares(model, before)
    for part in 0.5 ** np.arange(_HALVINGS):
        # between two points inside the limits rounding may leave them
        reached = np.clip(float(part) * after + (1.0 - float(part)) * before, model.lower, model.upper)
        if _sum_of_squares(model, reached) <= lowest:
            return reached
    return after


def _sum_of_squares(model: ExactModel, columns: Floats) -> float:
    """Of all residuals, those of the evidence not linearised; infinite where the pendulum would not swing."""
    try:
        beside = model.scale * model.evidence_residuals(columns)
    except DataError:
        return np.inf
    linear = len(model.evidence_rows(columns)[0])
    points = model(columns)[0]
    points = points[: len(points) - linear]
    found = float(points @ points + beside @ beside)
    return found if np.isfinite(found) else np.inf


def _largest_move(before: Floats, solution: Solution) -> float:
    """Largest change of a column, in standard uncertainties, of those that are determined."""
    moved = np.abs(solution.values - before) / np.sqrt(np.diag(solution.covariance))
    return float(np.max(moved[np.isfinite(moved)], initial=0.0))


def _as_weights(noise: Noise) -> Noise:
    """The noise by which residuals are weighted; chi2/dof then shows the scale of the uncertainties."""
    return AT_REST if noise.at_rest else noise.in_stated_uncertainties


def _likeliest_minimum(model: ExactModel, loss: Loss, kind: Noise, near: FitResult | None) -> _Minimum:
    """Likeliest minimum over the start values; the first one is accepted if it fits the data."""
    best: _Minimum | None = None
    tried = 0
    for start in chain(start_near(model, near), starts_of(model)):
        tried += 1
        found = _minimum_from(model, start, loss, kind)
        if found is None:
            continue
        if best is None or found.likeliest.deviance < best.likeliest.deviance:
            best = found
        if best.likeliest.noise.scale**2 < _GOOD_CHI2 and _agrees_with_evidence(best):
            break
    if not tried:
        raise DataError("no start from which the half-swing map reaches the last half-cycle")
    if best is None:
        raise DataError(
            f"the exact fit did not converge from {tried} starts: the law does not describe these "
            "amplitudes, or they hardly show it: check for disturbed half-cycles, start at a larger amplitude"
        )
    return best


def _agrees_with_evidence(found: _Minimum) -> bool:
    """Whether the minimum agrees with the evidence."""
    beside = found.model.evidence_rows(found.solution.values)[0]
    return float(beside @ beside) <= _GOOD_EVIDENCE * len(beside) + _GOOD_EVIDENCE


def fit_exact(
    points: TurningPoints,
    pendulum: PendulumOnBall,
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
        found = _likeliest_minimum(model, loss, kind, near)
        weakest = _WEAKEST * found.likeliest.noise.step * model.reference
        lost = np.nonzero(kept.amplitude < weakest)[0]
        if not len(lost):
            break
        if lost[0] < FEWEST_HALF_CYCLES:
            raise DataError(
                "the ground drives the pendulum as strongly as it swings: amplitudes below "
                f"{plain(weakest, 2)} are lost in its motion, which leaves {lost[0]} half-cycles; "
                "start higher, or wait for a quieter hour"
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
        unrestricted=search.least_unrestricted(),
    )
    averaged_over = search.averaged_covariance(found.likeliest, bounds)
    return result_of(found.model, found.solution, ground, loss, found.likeliest.covariance, averaged_over)


def fit_exact_with(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    like: FitResult,
    *,
    drag: bool,
) -> FitResult:
    """The exact fit of another model to the same turning points, with the noise of an earlier fit of them.

    Models are compared with one noise: with its own, each would take an effect that it lacks for a drive.
    """
    if like.ground is None:
        raise DataError(f"the {like.method} fit has no noise that another fit could take over")
    model = ExactModel(
        points.first(like.half_cycles), pendulum, law=like.law, drag=drag, evidence=like.evidence
    )
    noise, scale = model.noise_of(like), like.ground.measurement_scale
    linear = noise.at_rest and like.evidence == NO_EVIDENCE
    best: tuple[ExactModel, Solution] | None = None
    for columns in chain(start_near(model, like), starts_of(model)):
        try:
            for _ in range(_MOST_LINEARISED):
                here = model.on_ground(columns, noise, scale).linearised_at(columns)
                solution = solve(here, columns, lower=model.lower, upper=model.upper, loss=like.loss)
                moved = _largest_move(columns, solution)
                columns = solution.values
                if linear or moved < _CONVERGED_U:
                    break
        except DataError:
            continue
        # a cost whose weights and evidence are those of other columns is not this model's
        settled = linear or moved < _LINEAR_U
        if solution.converged and settled and (best is None or solution.cost < best[1].cost):
            best = here, solution
        if best is not None and 2 * best[1].cost / best[1].dof < _GOOD_CHI2:
            break
    if best is None:
        raise DataError("the exact fit did not converge with the noise of the earlier one")
    return result_of(*best, like.ground, like.loss)


_DOWN_THE_VALLEY, _PLACES = 6.0, 25
"""Range of starts below the largest friction, as a logarithm, and their number."""
_MUCH_BETTER = 0.25
"""Chi-square of the evidence, over that at a start, below which the start is moved."""


def starts_of(model: ExactModel) -> Iterator[Floats]:
    """Start values for which the map reaches the last half-cycle, the most promising first.

    Where none does, the first of each kind: a driven pendulum may swing for longer than any free one.
    Where the waveform contradicts the first start, the place along the law's valley of friction and drag that
    describes the waveform best precedes it.
    """
    usable: list[Floats] = []
    others: list[Floats] = []
    for attempts in model.columns.starts(model.points):
        inside = [_inside(model, attempt) for attempt in attempts]
        reaching = (columns for columns in inside if np.all(np.isfinite(model(columns)[0])))
        for columns in islice(reaching, 1):
            if not usable:
                yield from _by_waveform(model, columns)
            usable.append(columns)
            yield columns
        others += inside[:1]
    if not usable:
        yield from others


def _by_waveform(model: ExactModel, columns: Floats) -> Iterator[Floats]:
    """A start moved to the share of friction and drag that the evidence prefers, if that is much better."""
    valley = model.columns.valley
    if valley is None or model.evidence.waveform is None:
        return
    down = np.linspace(model.upper[valley] - _DOWN_THE_VALLEY, model.upper[valley], _PLACES)
    found: list[tuple[float, Floats]] = []
    for place in [float(columns[valley]), *down.tolist()]:
        moved = columns.copy()
        moved[valley] = place
        with suppress(DataError):
            if np.all(np.isfinite(model(moved)[0])):
                found.append((float(np.sum(model.evidence_residuals(moved) ** 2)), moved))
    if not found:
        return
    best = min(found, key=lambda one: one[0])
    if found[0][1] is not best[1] and best[0] < _MUCH_BETTER * found[0][0]:
        yield _inside(model, best[1])


def start_near(model: ExactModel, fit: FitResult | None) -> Iterator[Floats]:
    """The parameters of an earlier fit as a start, where the map then reaches the last half-cycle."""
    if fit is None:
        return
    columns = _inside(model, model.columns.from_physical({DRAG.key: 0.0} | fit.named_values))
    if np.all(np.isfinite(model(columns)[0])):
        yield columns


def _inside(model: ExactModel, columns: Floats) -> Floats:
    return np.clip(columns, model.lower + 1e-9, model.upper - 1e-9)
