"""Joint fit of the exact half-swing map to all amplitudes and times, on ground that may move."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from itertools import chain
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
from processing.fit.exact_result import (
    FEWEST_HALF_CYCLES,
    IMPOSSIBLE_U,
    OUTLIER,
    check_turning_points,
    impossible_signs,
    result_of,
)
from processing.fit.ground import GROUND_SEEN, GroundFit, Noise, density_of_step
from processing.fit.noise_estimate import LikeliestNoise, NoiseSearch
from processing.fit.result import FitResult
from processing.least_squares import Loss, Solution, propagate, solve
from processing.number_text import plain
from processing.swing import TurningPoints

_GOOD_CHI2 = 1.5
"""Reduced chi-square above which a minimum may be a local one; other start values are tried then."""
_GOOD_EVIDENCE = 8.0
"""Mean square of the evidence's residuals above which a minimum may be a local one, too: a strong drive gives
any turning points a good chi-square."""
_MAX_ITERATIONS = 12
"""Most alternations of noise and parameters; two or three suffice."""
_MAX_EVALUATIONS = 60
"""Most evaluations of the model in one alternation; the last search has as many as it needs."""
_MAX_LINEARISED = 24
"""Most fits to a partly linearised model; one that lacks an effect in the data converges slowly."""
_CONVERGED_U = 0.02
"""Change of the parameters, in standard uncertainties, below which the alternation ends."""
_LINEAR_U = 0.5
"""Change of the parameters, and error of the evidence, in standard uncertainties, up to which the evidence is
taken as linear."""
_LINEAR_SHARE = 0.01
"""The same error as a share of the evidence, where that contradicts the law."""
_MAX_HALVINGS = 8
"""Most times that a step is halved until the sum of squares, with the evidence not linearised, falls."""
_MIN_AMPLITUDE_STEPS = 10.0
"""Smallest amplitude fitted, in steps of the drive: amplitude and phase do not describe a smaller motion."""


class _Minimum(NamedTuple):
    """A minimum: the model with its weights, and the noise that belongs to it."""

    model: ExactModel
    solution: Solution
    likeliest: LikeliestNoise


def _minimum_from(model: ExactModel, start: Floats, loss: Loss, kind: Noise) -> _Minimum | None:
    """The minimum from one start, noise and parameters in turn until both stay; None without convergence."""
    coordinates = start
    last_step: float | None = None
    linearised: ExactModel | None = None
    is_linear = False
    for _ in range(_MAX_ITERATIONS):
        try:
            if linearised is None or not is_linear:
                linearised = model.linearised_at(coordinates)
            likeliest = NoiseSearch(linearised, coordinates, loss, kind).likeliest()
            if not np.isfinite(likeliest.deviance):
                return None
            noise = likeliest.noise
            weighted = linearised.on_ground(coordinates, noise.as_weights, noise.scale)
            solution = solve(
                weighted,
                coordinates,
                lower=model.lower,
                upper=model.upper,
                loss=loss,
                cost_tolerance=1e-9,
                max_evaluations=_MAX_EVALUATIONS,
            )
        except DataError:
            return None
        is_unmoved = np.array_equal(solution.values, coordinates)
        change_u = _largest_change_u(coordinates, solution)
        is_linear = change_u < _LINEAR_U and _evidence_is_linear(weighted, solution.values)
        if is_linear:
            coordinates = solution.values
        else:
            coordinates = _descending_share(weighted, coordinates, solution.values)
        is_same_noise = last_step is not None and abs(noise.step - last_step) <= 0.01 * last_step
        if is_same_noise and is_linear and change_u < _CONVERGED_U:
            break
        last_step = noise.step
    if not _evidence_is_linear(weighted, coordinates):
        # the minimum is that of a linearised evidence, which there is not the law's
        return None
    # where the last search found no step, a finer tolerance would find none either
    if not is_unmoved:
        solution = solve(weighted, coordinates, lower=model.lower, upper=model.upper, loss=loss)
    return _Minimum(weighted, solution, likeliest) if solution.converged else None


def _evidence_is_linear(model: ExactModel, coordinates: Floats) -> bool:
    """Whether the evidence agrees with its linearisation, within a part of its uncertainty."""
    linear = model.evidence_rows(coordinates)[0]
    try:
        evidence = model.evidence_residuals(coordinates)
    except DataError:
        return False
    error, size = float(np.linalg.norm(evidence - linear)), float(np.linalg.norm(evidence))
    return error <= max(_LINEAR_U, _LINEAR_SHARE * size)


def _descending_share(model: ExactModel, start: Floats, end: Floats) -> Floats:
    """The end of a step, or of its largest share that lowers the sum of squares with the evidence itself.

    It is taken whole where no share descends, as in a bent valley out of which every straight way leads.
    """
    at_start = _sum_of_squares(model, start)
    for share in (0.5**halvings for halvings in range(_MAX_HALVINGS)):
        # between two points inside the limits rounding may leave them
        coordinates = np.clip(share * end + (1.0 - share) * start, model.lower, model.upper)
        if _sum_of_squares(model, coordinates) <= at_start:
            return coordinates
    return end


def _sum_of_squares(model: ExactModel, coordinates: Floats) -> float:
    """Of all residuals, those of the evidence not linearised; infinite where the pendulum would not swing."""
    try:
        evidence = model.scale * model.evidence_residuals(coordinates)
    except DataError:
        return np.inf
    of_points = model(coordinates)[0][: 2 * len(model.points)]
    total = float(of_points @ of_points + evidence @ evidence)
    return total if np.isfinite(total) else np.inf


def _largest_change_u(start: Floats, solution: Solution) -> float:
    """Largest change of a coordinate, in standard uncertainties, of those that are determined."""
    change_u = np.abs(solution.values - start) / np.sqrt(np.diag(solution.covariance))
    return float(np.max(change_u[np.isfinite(change_u)], initial=0.0))


def _likeliest_minimum(
    model: ExactModel, loss: Loss, kind: Noise, near: FitResult | None, start: Floats | None
) -> _Minimum:
    """Likeliest minimum over the start values; the first clear one that fits the data is accepted.

    One with a sign that cannot be is taken only where it is likelier by the square of `IMPOSSIBLE_U`.
    """
    best: _Minimum | None = None
    lowest, is_sure = np.inf, False
    start_count = 0
    known = [] if start is None else [_inside(model, start)]
    others = (other for other in starts_of(model) if start is None or not np.array_equal(other, start))
    for coordinates in chain(start_near(model, near), known, others):
        start_count += 1
        minimum = _minimum_from(model, coordinates, loss, kind)
        if minimum is None:
            continue
        is_possible, is_clear = _is_possible_and_clear(minimum)
        worse = 0.0 if is_possible else IMPOSSIBLE_U**2
        # the restricted likelihood contains the information, which differs with the coordinates
        deviance = minimum.likeliest.unrestricted + worse
        if best is None or deviance < lowest:
            best, lowest, is_sure = minimum, deviance, is_possible and is_clear
        evidence = best.model.evidence_rows(best.solution.values)[0]
        agrees = float(evidence @ evidence) <= _GOOD_EVIDENCE * (len(evidence) + 1)
        if best.likeliest.noise.scale**2 < _GOOD_CHI2 and agrees and is_sure:
            break
    if not start_count:
        raise DataError("no start from which the half-swing map reaches the last half-cycle")
    if best is None:
        raise DataError(
            f"the exact fit did not converge from {start_count} starts: the law does not describe these "
            "amplitudes, or they hardly show it: check for disturbed half-cycles, start at a larger amplitude"
        )
    return best


def _is_possible_and_clear(minimum: _Minimum) -> tuple[bool, bool]:
    """Whether no parameter that cannot be negative is so beyond chance, and whether elasticity is seen.

    Otherwise the minimum may be one beside the law's; a drive of the ground gives it a good chi-square, too.
    """
    model, solution = minimum.model, minimum.solution
    values, slopes = model.parametrisation.physical(solution.values)
    u = np.sqrt(np.diag(propagate(slopes, solution.covariance)))
    estimates = {name: Estimate(*pair) for name, *pair in zip(model.names, values, u, strict=True)}
    elastic = [estimates[name] for name in model.parametrisation.elastic]
    is_clear = all(value > IMPOSSIBLE_U * u_value for value, u_value in elastic)
    return not impossible_signs(model.law, estimates), is_clear


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
    start: Floats | None = None,
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
        Evidence that restrains the fit in addition to the turning points.
    loss
        ``linear``, or a robust loss that reduces the influence of outliers.
    averaged
        Whether the turning points were measured on the samples of their half-cycles, as by the swing
        detector. Otherwise amplitude and time are those of the instant at which the pendulum turns.
    near
        An exact fit of nearly the same points, at which the first of all searches starts.
    start
        First of the `starts_of` a model of these points, if it is known; the next search starts there.

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
    fitted = points
    while True:
        model = ExactModel(fitted, pendulum, law=law, drag=drag, evidence=evidence)
        minimum = _likeliest_minimum(model, loss, kind, near, start)
        likeliest = minimum.likeliest
        lowest = _MIN_AMPLITUDE_STEPS * likeliest.noise.step * model.reference
        lost = np.nonzero(fitted.amplitude < lowest)[0]
        if not len(lost):
            break
        if lost[0] < FEWEST_HALF_CYCLES:
            raise DataError(
                "the ground drives the pendulum as strongly as it swings: amplitudes below "
                f"{plain(lowest, 2)} are lost in its motion, which leaves {lost[0]} half-cycles; "
                "start higher, or wait for a quieter hour"
            )
        fitted = fitted.first(int(lost[0]))
    search = NoiseSearch(minimum.model, minimum.solution.values, loss, kind)
    bounds = search.bounds(likeliest)
    half_period_s = 0.5 * mean_period(fitted)
    step, reference = likeliest.noise.step, model.reference
    ground = GroundFit(
        density_rad_per_s2_rthz=Estimate(
            density_of_step(step * reference, half_period_s),
            density_of_step(bounds.u_step * reference, half_period_s),
        ),
        upper_95=density_of_step(bounds.highest_step * reference, half_period_s),
        noise=replace(likeliest.noise, step=step * reference),
        seen=likeliest.against_rest > GROUND_SEEN,
        measurement_scale=likeliest.noise.scale,
        left_out_half_cycles=len(points) - len(fitted),
        deviance=likeliest.deviance,
        unrestricted=search.least_unrestricted(),
    )
    covariance_over_steps = search.averaged_covariance(likeliest, bounds)
    return result_of(
        minimum.model, minimum.solution, ground, loss, likeliest.covariance, covariance_over_steps
    )


def fit_exact_with(
    points: TurningPoints, pendulum: PendulumOnBall, like: FitResult, *, drag: bool
) -> FitResult:
    """The exact fit of another model to the same turning points, with the noise of an earlier fit of them.

    Models are compared with one noise: with its own, each would take an effect that it lacks for a drive.
    """
    model = ExactModel(
        points.first(like.half_cycles), pendulum, law=like.law, drag=drag, evidence=like.evidence
    )
    noise, scale = model.noise_of(like), like.ground_fit.measurement_scale
    is_linear = noise.at_rest and like.evidence == NO_EVIDENCE
    best: tuple[ExactModel, Solution] | None = None
    for coordinates in chain(start_near(model, like), starts_of(model)):
        try:
            for _ in range(_MAX_LINEARISED):
                weighted = model.on_ground(coordinates, noise, scale).linearised_at(coordinates)
                solution = solve(weighted, coordinates, lower=model.lower, upper=model.upper, loss=like.loss)
                change_u = _largest_change_u(coordinates, solution)
                coordinates = solution.values
                if is_linear or change_u < _CONVERGED_U:
                    break
        except DataError:
            continue
        # a cost whose weights and evidence are those of other coordinates is not this model's
        is_own_cost = is_linear or change_u < _LINEAR_U
        if solution.converged and is_own_cost and (best is None or solution.cost < best[1].cost):
            best = weighted, solution
        if best is not None and 2 * best[1].cost / best[1].dof < _GOOD_CHI2:
            break
    if best is None:
        raise DataError("the exact fit did not converge with the noise of the earlier one")
    return result_of(*best, like.ground_fit, like.loss)


_VALLEY_RANGE = 6.0
"""Range below the largest friction, as a logarithm, in which starts along the valley lie."""
_VALLEY_STARTS, _VALLEY_STEPS = 7, (0.5, 0.25)
"""Number of starts along the valley, and the steps from the best of them that are tried then."""
_MUCH_BETTER = 0.25
"""Chi-square of the evidence, over that at a start, below which the start is moved."""


def starts_of(model: ExactModel) -> Iterator[Floats]:
    """Start values for which the map reaches the last half-cycle, the most promising first.

    Where none does, the first start of each kind is tried: a driven pendulum may swing for longer than any
    free one. Where the waveform contradicts the first start, the point along the law's valley of friction and
    drag that describes the waveform best precedes it.
    """
    is_any_usable = False
    others: list[Floats] = []
    for attempts in model.parametrisation.starts(model.points):
        inside = [_inside(model, attempt) for attempt in attempts]
        coordinates = next((start for start in inside if np.all(np.isfinite(model(start)[0]))), None)
        if coordinates is not None:
            if not is_any_usable:
                yield from _by_waveform(model, coordinates)
            is_any_usable = True
            yield coordinates
        others += inside[:1]
    if not is_any_usable:
        yield from others


def _by_waveform(model: ExactModel, coordinates: Floats) -> Iterator[Floats]:
    """A start moved to the share of friction and drag that the evidence prefers, if that is much better."""
    valley = model.parametrisation.valley
    if valley is None or model.evidence.waveform is None:
        return

    def moved(value: float) -> Floats:
        return np.where(np.arange(len(coordinates)) == valley, value, coordinates)

    @cache
    def chi2(value: float) -> float:
        with suppress(DataError):
            if np.all(np.isfinite(model(moved(value))[0])):
                return float(np.sum(model.evidence_residuals(moved(value)) ** 2))
        return np.inf

    end = float(model.upper[valley])
    best = min(np.linspace(end - _VALLEY_RANGE, end, _VALLEY_STARTS).tolist(), key=chi2)
    for step in _VALLEY_STEPS:
        best = min(best, best - step, min(best + step, end), key=chi2)
    if chi2(best) < _MUCH_BETTER * chi2(float(coordinates[valley])):
        yield _inside(model, moved(best))


def start_near(model: ExactModel, fit: FitResult | None) -> Iterator[Floats]:
    """The parameters of an earlier fit as a start, where the map then reaches the last half-cycle."""
    if fit is None:
        return
    coordinates = _inside(model, model.parametrisation.from_physical({DRAG.key: 0.0} | fit.named_values))
    if np.all(np.isfinite(model(coordinates)[0])):
        yield coordinates


def _inside(model: ExactModel, coordinates: Floats) -> Floats:
    return np.clip(coordinates, model.lower + 1e-9, model.upper - 1e-9)
