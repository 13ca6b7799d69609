"""Changes during a run: knocks, after which the exact fit begins anew, and steps of friction or period.

A footfall or a touch of the table is no drive that acts all the time. Taken for one, it enlarges
uncertainties some hundred times. The half-swing of a knock has a drive of its own, so large that the turning
points before it tell nothing of the state after it, but as much as ever of the law's parameters.

A step is sought at every half-cycle, by the restricted likelihood with the drive of the ground estimated
anew. It counts where no smooth error of the law explains the decay as well.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import hypot, inf, log, pi
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.effects import loss_shares
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact, starts_of
from processing.fit.exact_model import DiscrepancyColumns, ExactModel
from processing.fit.exact_result import check_turning_points
from processing.fit.ground import Noise
from processing.fit.noise_estimate import NoiseSearch
from processing.fit.result import CLEAR_CHANGE_GAIN, FRICTION_STEP, Change, ChangeKind, FitResult
from processing.fit.terms import DrivenRows, LinearisedFit
from processing.least_squares import FactoredJacobian, Loss
from processing.noise_models import robust_scatter
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
        gain = fit.ground_fit.deviance - with_worst.ground_fit.deviance
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
    model, coordinates = ExactModel.of(points, pendulum, _without(fit, knock))
    search = NoiseSearch(model, coordinates, fit.loss, Noise(averaged=fit.ground_fit.noise.averaged))
    return search.likeliest().deviance - fit.ground_fit.deviance


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


_CHUNK_PLACES = 64
"""Number of half-cycles for which changes are computed together."""
_EDGE_HALF_CYCLES = 5
"""Half-cycles at both ends at which no change is looked for."""
_STEP_PROBABILITY = 0.2
"""Prior probability that a run has a step of the friction."""
_CHANGE_DRIVE_FACTORS = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without changes."""
_MAX_CHANGES = 3
_KINDS = (ChangeKind.FRICTION, ChangeKind.PERIOD)


def with_changes(
    linearised: LinearisedFit, u_step: float, explained: float = 0.0, fit: FitResult | None = None
) -> FitResult:
    """The fit with the changes in its decay, and with the uncertainty by a step of the friction not found.

    A step too small to be found moves the parameters all the same. Their uncertainties hold it in proportion
    to its probability at each half-cycle, so that no uncertainty leaps where a step is found.

    Parameters
    ----------
    u_step
        Prior standard uncertainty of the relative size of a step.
    explained
        Fall of -2 ln L by smooth errors of the law (`DiscrepancySize.against_law`).
    fit
        The fit that receives the changes, where it has terms that `linearised.fit` has not.
    """
    fit = linearised.fit if fit is None else fit
    drives = linearised.noises(_CHANGE_DRIVE_FACTORS) if fit.loss == "linear" else ()
    scans = [scan for noise in drives if (scan := _ChangeScan.of(linearised, noise)) is not None]
    if not scans:
        return fit
    if u_step > 0:
        fit = fit.with_term(
            FRICTION_STEP, linearised.to_physical @ scans[0].hidden_friction(u_step, explained)
        )
    changes = _found_changes(linearised, scans, explained)
    warnings = (f"{change.text}; fit the parts before and after it on their own" for change in changes)
    return replace(fit, changes=(*fit.changes, *changes), warnings=(*fit.warnings, *warnings))


def _found_changes(
    linearised: LinearisedFit, scans: Sequence["_ChangeScan"], explained: float
) -> tuple[Change, ...]:
    points, changes = linearised.points, list[Change]()
    clear_gain = CLEAR_CHANGE_GAIN + 2 * log(len(ChangeKind) * len(points))
    deviance = min(scan.deviance() for scan in scans)
    for _ in range(_MAX_CHANGES):
        best = min((scan.best() for scan in scans), key=lambda change: change.deviance)
        gain = deviance - best.deviance
        # the first change must also explain more than smooth errors of the law
        if not gain > clear_gain + (0.0 if changes else explained):
            break
        place = best.place + _EDGE_HALF_CYCLES
        changes.append(
            Change(
                kind=best.kind,
                half_cycle=int(points.index[place]),
                time_s=float(points.time_s[place]),
                size=float(best.size),
                u_size=float(best.u_size),
                gain=float(gain),
            )
        )
        for scan in scans:
            scan.take(best)
        deviance = min(scan.deviance() for scan in scans)
    return tuple(changes)


class _ClearestChange(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class _ChangeScan:
    """Whitened residuals for one drive, and their derivatives with respect to a change at each half-cycle.

    These are computed anew for each search, some half-cycles at a time: all would fill the memory.
    """

    def __init__(self, linearised: LinearisedFit, noise: Noise, rows: DrivenRows) -> None:
        self._linearised, self._noise = linearised, noise
        model = linearised.model
        self._shares = loss_shares(model, linearised.coordinates)
        time_s = model.points.time_s - model.points.time_s[0]
        # a change lies between its half-cycle and the one before
        between_s = 0.5 * (time_s[1:] + time_s[:-1])
        self._changes_s = between_s[_EDGE_HALF_CYCLES - 1 : len(time_s) - _EDGE_HALF_CYCLES - 1]
        # by the median, which a change hardly moves: it must not hide in a scatter that it makes
        self._scale = max(1.0, robust_scatter(rows.residuals[: rows.points], middle=0.0))
        rows = rows.in_scatter(self._scale)
        self._law = FactoredJacobian(rows.jacobian)
        self._taken: list[FactoredJacobian] = []
        self._left = self._law.residual(rows.residuals)
        self._constant = rows.log_det + self._law.log_det

    @classmethod
    def of(cls, linearised: LinearisedFit, noise: Noise) -> "_ChangeScan | None":
        """The scan for a drive; None where the filter has no value for it, or half-cycles are too few."""
        if len(linearised.points) <= 2 * _EDGE_HALF_CYCLES:
            return None
        rows = DrivenRows.of(linearised.model, linearised.coordinates, noise)
        return cls(linearised, noise, rows) if np.all(np.isfinite(rows.residuals)) else None

    def hidden_friction(self, u_size: float, explained: float) -> Floats:
        """Changes (coordinates, half-cycles) by one standard deviation of a friction step not corrected.

        Prior: a step with the probability `_STEP_PROBABILITY`, at any half-cycle alike, its size zero with
        the standard uncertainty `u_size`. The data weigh each half-cycle by its gain in -2 ln L beyond
        `explained`.
        """
        mean_squares, chances, law_changes = [], [], []
        for first in range(0, len(self._changes_s), _CHUNK_PLACES):
            raw = self._changes(first, _CHUNK_PLACES, whole=True)[:, 0]
            changes = self._law.residual(raw)
            power = np.einsum("rp,rp->p", changes, changes) + 1e-30
            variance = 1.0 / (1.0 / u_size**2 + power)
            size = -variance * (self._left @ changes)
            gain = np.maximum(size**2 / variance - explained, 0.0)
            mean_squares.append(size**2 + variance)
            chances.append(np.exp(np.minimum(0.5 * gain, 300.0)) * np.sqrt(variance) / u_size)
            law_changes.append(self._law.coefficients(raw))
        chance = np.concatenate(chances) * _STEP_PROBABILITY / len(self._changes_s)
        weight = np.concatenate(mean_squares) * chance / (np.sum(chance) + 1.0 - _STEP_PROBABILITY)
        return np.asarray(np.concatenate(law_changes, axis=1) * np.sqrt(weight))

    def _changes(self, first: int, count: int, *, whole: bool = False) -> Floats:
        """Derivatives (rows, 2, half-cycles) by unit steps of friction and period, at `count` half-cycles.

        The part that law and earlier changes take up is subtracted, unless they are to be `whole`.
        """
        changes_s = self._changes_s[first : first + count]

        def loss_errors(amplitude: Floats, node_s: Floats) -> Floats:
            return np.asarray((node_s[:, None] > changes_s) * self._shares(amplitude)[0][:, None])

        def duration_errors(_: Floats, node_s: Floats) -> Floats:
            return np.asarray(1.0 * (node_s[:, None] > changes_s))

        linearised, errors = self._linearised, DiscrepancyColumns(loss_errors, duration_errors)
        rows = DrivenRows.of(linearised.model, linearised.coordinates, self._noise, errors)
        changes = rows.by_errors / self._scale
        if not whole:
            for taken in (self._law, *self._taken):
                changes = taken.residual(changes)
        return changes.reshape(len(changes), 2, -1)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> _ClearestChange:
        """The change that explains most."""
        clearest, deviance = [], self.deviance()
        for first in range(0, len(self._changes_s), _CHUNK_PLACES):
            changes = self._changes(first, _CHUNK_PLACES)
            score = np.einsum("r,rkp->kp", self._left, changes)
            power = np.einsum("rkp,rkp->kp", changes, changes) + 1e-30
            gains = score**2 / power
            for row, kind in enumerate(_KINDS):
                place = int(np.argmax(gains[row]))
                size, u = -score[row, place] / power[row, place], power[row, place] ** -0.5
                with_change = deviance - float(gains[row, place])
                clearest.append(_ClearestChange(kind, first + place, size, u, with_change))
        return min(clearest, key=lambda change: change.deviance)

    def take(self, best: _ClearestChange) -> None:
        """Let a change explain its part of the residuals in all that follows."""
        own = FactoredJacobian(self._changes(best.place, 1)[:, _KINDS.index(best.kind)])
        self._left = own.residual(self._left)
        self._taken.append(own)
