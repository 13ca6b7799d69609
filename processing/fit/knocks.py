"""Exact fit of a decay as it was recorded: with knocks, and with a drag that contradicts its prior.

A footfall or a touch of the table is no drive that acts all the time. Taken for one, it enlarges
uncertainties some hundred times, and leaves intervals that need not hold the true values. The half-swing of a
knock has a drive of its own, so large that the turning points before it tell nothing of the state after it,
but as much as ever of the law's parameters.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import hypot, inf, log, pi

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact, starts_of
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import check_turning_points
from processing.fit.ground import Noise
from processing.fit.noise_estimate import NoiseSearch
from processing.fit.result import CLEAR_CHANGE_GAIN, Change, ChangeKind, FitResult
from processing.least_squares import Loss
from processing.number_text import with_uncertainty
from processing.swing import TurningPoints

_MAX_KNOCKS = 5
"""A decay with more knocks is driven all the time."""
_CONTRADICTS_U = 5.0
"""Distance of a drag above its prior, in standard uncertainties, that contradicts the prior."""


def fit_with_knocks(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    *,
    drag: bool = False,
    evidence: Evidence = NO_EVIDENCE,
    loss: Loss = "linear",
    averaged: bool = True,
    near: FitResult | None = None,
) -> FitResult:
    """The exact fit, anew from each knock on that the decay shows; see `fit_exact` for arguments and errors.

    A knock is sought at the worst outlier of a fit, one at a time: where the law has smooth errors, there is
    none. Knocks of the fit `near` are taken over if these points show them too: what shook the spot alone
    disturbs a first measurement more than the second. All knocks stand in the result's `changes`. The
    prior of the drag is left out, with a warning, where the data contradict it (see `_contradicting_fit`).
    """
    check_turning_points(points)
    by_data, first_drag_s = replace(evidence, drag_s=None), -inf
    start: Floats | None = None
    if near is None:
        # the first start costs as much as half of a fit, and is the same whether the drag has a prior or not
        with suppress(DataError, StopIteration):
            model = ExactModel(points, pendulum, drag=drag, evidence=by_data)
            start = next(starts_of(model))
            first_drag_s = model.values(start).get(DRAG.key, -inf)
    elif near.has_drag:
        first_drag_s = near.estimate(DRAG.key).value
    fitted = partial(fit_exact, points, pendulum, drag=drag, loss=loss, averaged=averaged, start=start)
    contradiction = []
    if drag and evidence.drag_s is not None:
        alone = _contradicting_fit(fitted, by_data, evidence.drag_s, near, first_drag_s)
        if alone is not None:
            known, measured = (
                with_uncertainty(*drag_s) for drag_s in (evidence.drag_s, alone.estimate(DRAG.key))
            )
            contradiction.append(
                f"the data contradict what is known of the drag, {known} s: alone they give {measured} s, "
                "and are fitted alone; state fit.drag = 'open', or look for what else takes energy as a drag "
                "does"
            )
            evidence, near = by_data, alone

    def with_knocks(knocks: Iterable[int], near: FitResult | None) -> FitResult:
        return fitted(evidence=replace(evidence, knocks=tuple(sorted(knocks))), near=near)

    known_knocks, changes = ((), ()) if near is None else (near.evidence.knocks, near.changes)
    gains = {
        change.half_cycle: change.gain
        for change in changes
        if change.kind is ChangeKind.KNOCK and change.half_cycle in known_knocks
    }
    min_gain = CLEAR_CHANGE_GAIN + 2 * log(len(points))
    fit = with_knocks(gains, near)
    for knock in tuple(gains):
        if not _gain(points, pendulum, fit, knock) > min_gain:
            del gains[knock]
            fit = with_knocks(gains, fit)
    while loss == "linear" and fit.outliers and len(gains) < _MAX_KNOCKS:
        worst = _worst_half_cycle(points, pendulum, fit)
        if worst in gains:
            break
        try:
            with_worst = with_knocks({*gains, worst}, fit)
        except DataError:
            break
        assert fit.ground is not None
        assert with_worst.ground is not None
        gain = fit.ground.deviance - with_worst.ground.deviance
        if not gain > min_gain:
            break
        fit, gains[worst] = with_worst, gain
    changes = tuple(_change(points, pendulum, fit, knock, gains[knock]) for knock in sorted(gains))
    warnings = (f"{change.text}; the fit begins anew after it" for change in changes)
    return replace(fit, changes=changes, warnings=(*fit.warnings, *warnings, *contradiction))


def _worst_half_cycle(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> int:
    """Number of the half-cycle farthest from its prediction."""
    model, coordinates = ExactModel.of(points, pendulum, fit)
    residuals = model(coordinates)[0][: 2 * len(model.points)].reshape(2, -1)
    return int(model.points.index[np.argmax(np.max(np.abs(residuals), axis=0))])


def _gain(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, knock: int) -> float:
    """Gain in -2 ln L by one of a fit's knocks, by the model that is linear about this fit."""
    assert fit.ground is not None
    model, coordinates = ExactModel.of(points, pendulum, _without(fit, knock))
    search = NoiseSearch(model, coordinates, fit.loss, Noise(averaged=fit.ground.noise.averaged))
    return search.likeliest().deviance - fit.ground.deviance


def _without(fit: FitResult, knock: int) -> FitResult:
    knocks = tuple(other for other in fit.evidence.knocks if other != knock)
    return replace(fit, evidence=replace(fit.evidence, knocks=knocks))


def _change(
    points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, knock: int, gain: float
) -> Change:
    """The knock before a half-cycle: how far that lies from its prediction without it, over the amplitude."""
    model, coordinates = ExactModel.of(points, pendulum, _without(fit, knock))
    filtered, count = model.filtered(coordinates, model.noise_of(fit)), len(model.points)
    place = int(np.searchsorted(model.points.index, knock))
    per_amplitude, _, per_time = filtered.gains[place, 4:7]
    lost = filtered.residuals[place] / per_amplitude
    # the regression of the time on the amplitude, a thousandth of the size, is neglected
    late_s = filtered.residuals[count + place] / per_time
    amplitude = float(model.points.amplitude[place]) / model.reference
    return Change(
        kind=ChangeKind.KNOCK,
        half_cycle=knock,
        time_s=float(model.points.time_s[place]),
        size=hypot(lost / amplitude, late_s * 2 * pi / fit.mean_period_s.value),
        u_size=float(1.0 / (per_amplitude * amplitude)),
        gain=gain,
    )


def _contradicting_fit(
    fitted: Callable[..., FitResult],
    by_data: Evidence,
    known_s: Estimate,
    near: FitResult | None,
    first_drag_s: float,
) -> FitResult | None:
    """The fit by the data alone where they show a far larger drag than is known; None elsewhere.

    Held near a drag that is far too small, a fit takes the rest of the loss for a drive of the ground, or
    does not converge. A smaller drag than is known is no contradiction: a wrong law produces it as well.
    `first_drag_s`, of an earlier fit or a start, tells whether a fit by the data alone is worth its time.
    """
    if near is not None and near.evidence.drag_s is None:
        return near
    if first_drag_s - known_s.value < _CONTRADICTS_U * known_s.standard_uncertainty:
        return None
    try:
        fit = fitted(evidence=by_data, near=near)
    except DataError:
        return None
    value, u = fit.estimate(DRAG.key)
    contradicts = value - known_s.value > _CONTRADICTS_U * hypot(u, known_s.standard_uncertainty)
    return fit if contradicts else None
