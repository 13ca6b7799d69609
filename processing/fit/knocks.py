"""Exact fit of a decay that was knocked: it begins anew with the amplitude and phase after each knock.

A footfall or a touch of the table is no drive that acts all the time. Taken for one, it enlarges
uncertainties some hundred times, and leaves intervals that need not hold the true values. The half-swing of a
knock has a drive of its own, so large that the turning points before it tell nothing of the state after it,
but as much as ever of the law's parameters.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import hypot, log, pi

import numpy as np

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.drag import contradicted_drag
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import check_turning_points
from processing.fit.ground import Noise
from processing.fit.noise_estimate import NoiseSearch
from processing.fit.result import Change, ChangeKind, FitResult
from processing.least_squares import Loss
from processing.swing import TurningPoints

_MOST_KNOCKS = 5
"""A decay with more knocks is driven all the time."""
_CLEAR_GAIN = 20.0
"""Gain in -2 ln L that a knock must have beyond that of choosing among all half-cycles."""


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
    none. Knocks of the fit `near` are taken over, but those that these points do not show: what shook the
    spot alone disturbs a first measurement more than the second. All stand in the result's `changes`. What is
    known of the drag is left out, with a warning, where the data contradict it (see `contradicted_drag`).
    """
    check_turning_points(points)
    wrong = contradicted_drag(points, pendulum, evidence, loss=loss, averaged=averaged, near=near)
    if wrong is not None:
        evidence, near = replace(evidence, drag_s=None), wrong.fit

    def fitted(knocks: Iterable[int], from_fit: FitResult | None) -> FitResult:
        anew = replace(evidence, knocks=tuple(sorted(knocks)))
        return fit_exact(
            points, pendulum, drag=drag, evidence=anew, loss=loss, averaged=averaged, near=from_fit
        )

    known, changes = ((), ()) if near is None else (near.evidence.knocks, near.changes)
    gains = {
        one.half_cycle: one.gain
        for one in changes
        if one.kind is ChangeKind.KNOCK and one.half_cycle in known
    }
    enough = _CLEAR_GAIN + 2 * log(len(points))
    fit = fitted(gains, near)
    for knock in tuple(gains):
        if not _gain(points, pendulum, fit, knock, averaged=averaged) > enough:
            del gains[knock]
            fit = fitted(gains, fit)
    while loss == "linear" and fit.outliers and len(gains) < _MOST_KNOCKS:
        worst = _worst_half_cycle(points, pendulum, fit)
        if worst in gains:
            break
        try:
            freed = fitted({*gains, worst}, fit)
        except DataError:
            break
        assert fit.ground is not None
        assert freed.ground is not None
        gain = fit.ground.deviance - freed.ground.deviance
        if not gain > enough:
            break
        fit, gains[worst] = freed, gain
    changes = tuple(_change(points, pendulum, fit, knock, gains[knock]) for knock in sorted(gains))
    warnings = [f"{one.text}; the fit begins anew after it" for one in changes]
    warnings += [] if wrong is None else [wrong.text]
    return replace(fit, changes=changes, warnings=(*fit.warnings, *warnings))


def _worst_half_cycle(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> int:
    """Number of the half-cycle farthest from its prediction."""
    model, columns = ExactModel.of(points, pendulum, fit)
    residuals = model(columns)[0][: 2 * len(model.points)].reshape(2, -1)
    return int(model.points.index[np.argmax(np.max(np.abs(residuals), axis=0))])


def _gain(
    points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, knock: int, *, averaged: bool
) -> float:
    """Gain in -2 ln L by one of the knocks of a fit, by the model that is linear about this fit."""
    assert fit.ground is not None
    model, columns = ExactModel.of(points, pendulum, _without(fit, knock))
    search = NoiseSearch(model, columns, fit.loss, Noise(averaged=averaged))
    return search.likeliest().deviance - fit.ground.deviance


def _without(fit: FitResult, knock: int) -> FitResult:
    knocks = tuple(one for one in fit.evidence.knocks if one != knock)
    return replace(fit, evidence=replace(fit.evidence, knocks=knocks))


def _change(
    points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, knock: int, gain: float
) -> Change:
    """The knock before a half-cycle: how far that lies from its prediction without it, over the amplitude."""
    model, columns = ExactModel.of(points, pendulum, _without(fit, knock))
    found, count = model.filtered(columns, model.noise_of(fit)), len(model.points)
    place = int(np.searchsorted(model.points.index, knock))
    per_amplitude, _, per_time = found.gains[place, 4:7]
    lost = found.residuals[place] / per_amplitude
    # what the amplitude tells of the time is a thousandth of the size
    late_s = found.residuals[count + place] / per_time
    amplitude = float(model.points.amplitude[place]) / model.reference
    return Change(
        kind=ChangeKind.KNOCK,
        half_cycle=knock,
        time_s=float(model.points.time_s[place]),
        size=hypot(lost / amplitude, late_s * 2 * pi / fit.mean_period_s.value),
        u_size=float(1.0 / (per_amplitude * amplitude)),
        gain=gain,
    )
