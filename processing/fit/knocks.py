"""Exact fit of a decay as it was recorded: with knocks, and with a drag that contradicts its prior.

A footfall or a touch of the table is no drive that acts all the time. Taken for one, it enlarges
uncertainties some hundred times, and leaves intervals that need not hold the true values. The half-swing of a
knock has a drive of its own, so large that the turning points before it tell nothing of the state after it,
but as much as ever of the law's parameters.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from math import hypot, log, pi
from typing import NamedTuple

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
    prior of the drag is left out, with a warning, where the data contradict it (see `_contradicted_drag`).
    """
    check_turning_points(points)
    start: Floats | None = None
    if near is None:
        # the first start costs as much as half of a fit, and is the same whether the drag has a prior or not
        by_data = replace(evidence, drag_s=None)
        with suppress(DataError):
            start = next(starts_of(ExactModel(points, pendulum, drag=drag, evidence=by_data)), None)
    contradicted = _contradicted_drag(
        points, pendulum, evidence, drag=drag, loss=loss, averaged=averaged, near=near, start=start
    )
    if contradicted is not None:
        evidence, near = replace(evidence, drag_s=None), contradicted.fit

    def fitted(knocks: Iterable[int], near: FitResult | None) -> FitResult:
        return fit_exact(
            points,
            pendulum,
            drag=drag,
            evidence=replace(evidence, knocks=tuple(sorted(knocks))),
            loss=loss,
            averaged=averaged,
            near=near,
            start=start,
        )

    known, changes = ((), ()) if near is None else (near.evidence.knocks, near.changes)
    gains = {
        change.half_cycle: change.gain
        for change in changes
        if change.kind is ChangeKind.KNOCK and change.half_cycle in known
    }
    min_gain = CLEAR_CHANGE_GAIN + 2 * log(len(points))
    fit = fitted(gains, near)
    for knock in tuple(gains):
        if not _gain(points, pendulum, fit, knock) > min_gain:
            del gains[knock]
            fit = fitted(gains, fit)
    while loss == "linear" and fit.outliers and len(gains) < _MAX_KNOCKS:
        worst = _worst_half_cycle(points, pendulum, fit)
        if worst in gains:
            break
        try:
            with_worst = fitted({*gains, worst}, fit)
        except DataError:
            break
        assert fit.ground is not None
        assert with_worst.ground is not None
        gain = fit.ground.deviance - with_worst.ground.deviance
        if not gain > min_gain:
            break
        fit, gains[worst] = with_worst, gain
    changes = tuple(_change(points, pendulum, fit, knock, gains[knock]) for knock in sorted(gains))
    warnings = [f"{change.text}; the fit begins anew after it" for change in changes]
    warnings += [] if contradicted is None else [contradicted.text]
    return replace(fit, changes=changes, warnings=(*fit.warnings, *warnings))


def _worst_half_cycle(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> int:
    """Number of the half-cycle farthest from its prediction."""
    model, coordinates = ExactModel.of(points, pendulum, fit)
    residuals = model(coordinates)[0][: 2 * len(model.points)].reshape(2, -1)
    return int(model.points.index[np.argmax(np.max(np.abs(residuals), axis=0))])


def _gain(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, knock: int) -> float:
    """Gain in -2 ln L by one of the knocks of a fit, by the model that is linear about this fit."""
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


class _ContradictedDrag(NamedTuple):
    """Prior of the drag, and the fit by the data alone that contradicts it."""

    known_s: Estimate
    fit: FitResult

    @property
    def text(self) -> str:
        """Warning in one line."""
        known, measured = (
            with_uncertainty(*drag_s) for drag_s in (self.known_s, self.fit.estimate(DRAG.key))
        )
        return (
            f"the data contradict what is known of the drag, {known} s: alone they give {measured} s, and "
            "are fitted alone; state fit.drag = 'open', or look for what else takes energy as a drag does"
        )


def _contradicted_drag(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    evidence: Evidence,
    *,
    drag: bool,
    loss: Loss,
    averaged: bool,
    near: FitResult | None,
    start: Floats | None,
) -> _ContradictedDrag | None:
    """The fit by the data alone where they show a far larger drag than is known; None elsewhere.

    Held near a drag that is far too small, a fit takes the rest of the loss for a drive of the ground, or
    does not converge. A smaller drag than is known is no contradiction: a wrong law produces it as well.
    `near` is an earlier fit of nearly the same points; without it the `start` of a search tells whether a fit
    by the data alone is worth its time.
    """
    known_s = evidence.drag_s
    if known_s is None or not drag:
        return None
    evidence = replace(evidence, drag_s=None)
    try:
        if near is not None and near.evidence.drag_s is None:
            return _ContradictedDrag(known_s, near)
        if near is not None:
            drag_s = near.estimate(DRAG.key).value
        elif start is not None:
            drag_s = ExactModel(points, pendulum, drag=True, evidence=evidence).values(start)[DRAG.key]
        else:
            return None
        if drag_s - known_s.value < _CONTRADICTS_U * known_s.standard_uncertainty:
            return None
        fit = fit_exact(
            points,
            pendulum,
            drag=True,
            evidence=evidence,
            loss=loss,
            averaged=averaged,
            near=near,
            start=start,
        )
    except DataError:
        return None
    value, u = fit.estimate(DRAG.key)
    contradicts = value - known_s.value > _CONTRADICTS_U * hypot(u, known_s.standard_uncertainty)
    return _ContradictedDrag(known_s, fit) if contradicts else None
