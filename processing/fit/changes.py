"""What changes while a pendulum swings: events that are found and dated, drifts that one decay cannot see.

A change is looked for at every half-cycle: a knock (both quadratures of the oscillation step), a friction
that is another one from then on, a period that is. Each is judged by the restricted likelihood, with the
drive of the ground estimated anew, and counts where no smooth error of the law explains the decay as well.

A friction that ages evenly is not seen: amplitude and time fall together, and an exponent takes up what the
age does. What such drifts do to the parameters follows from the map, for a budget.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.change_scan import EDGE, Best, Scan, contact_share
from processing.fit.exact_model import Errors, ExactModel
from processing.fit.ground import Noise
from processing.fit.law_errors import Change, ChangeKind
from processing.fit.misfit import by_harmonics
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.least_squares import covariance_of, propagate
from processing.swing import TurningPoints

_DRIVES = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives that are tried, over the one that the law without changes needs."""
_CERTAIN = 20.0
"""Gain in -2 ln L that a change must have beyond that of choosing among all half-cycles."""
_MOST = 3


class Drifts(NamedTuple):
    """Derivatives (parameters,) of the fitted contact parameters by what drifts evenly over the run.

    `by_ageing` is by the relative growth of the contact's friction from the first turning point to the last,
    `by_period` by that of the period; parameters are those of the middle of the run.
    """

    by_ageing: Floats
    by_period: Floats


def drifts_of(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> Drifts:
    """What drifts do to the contact parameters of an exact fit of these points.

    Raises DataError for another method.
    """
    model, columns = _model(points, pendulum, fit)
    jacobian, drifts = _by_drifts(model, columns, fit)
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    moved = np.linalg.lstsq(jacobian / norm, drifts, rcond=1e-10)[0] / norm[:, None]
    by = (model.columns.physical(columns)[1] @ moved)[: len(fit.contact_names)]
    return Drifts(by[:, 0], by[:, 1])


def _scale(fit: FitResult) -> float:
    return 1.0 if fit.ground is None else fit.ground.measurement_scale


def _by_drifts(model: ExactModel, columns: Floats, fit: FitResult) -> tuple[Floats, Floats]:
    """Derivatives of the residuals by the columns, and by both drifts."""
    return by_drifts(model, columns, model.noise_of(fit), _scale(fit))


def by_drifts(model: ExactModel, columns: Floats, noise: Noise, scale: float) -> tuple[Floats, Floats]:
    """Derivatives of the residuals by the columns, and by both drifts of `Drifts`; `scale` is that of the
    stated uncertainties."""
    contact = contact_share(model, columns)
    lasting_s = float(model.points.time_s[-1] - model.points.time_s[0])

    def ageing(amplitude: Floats, time_s: Floats) -> Floats:
        return (contact(amplitude) * (time_s / lasting_s - 0.5))[:, None]

    def slower(_: Floats, time_s: Floats) -> Floats:
        return (time_s / lasting_s - 0.5)[:, None]

    found = model.filtered(columns, noise, errors=Errors(ageing, slower))
    beside = model.beside(columns)[1]
    waveform, shapes = model.evidence.waveform, None
    if waveform is not None:
        amplitude = waveform.amplitude_rad / model.reference
        passed = np.interp(-amplitude, -model.points.amplitude / model.reference, model.points.time_s)
        shapes = ageing(amplitude, passed - model.points.time_s[0])
    of_waveform = np.column_stack([by_harmonics(model, columns, shapes, 1), np.zeros(len(beside))])
    law = len(columns)
    jacobian = np.concatenate([found.jacobian[:, :law] / scale, beside])
    return jacobian, np.concatenate([found.jacobian[:, law:] / scale, of_waveform])


def with_drifts(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    fit: FitResult,
    u_ageing: float,
    u_period: float,
) -> FitResult:
    """The fit with both drifts among its parameters, each about nought with its standard uncertainty.

    What the data say of them is used: parameters move by it, linearly, and are as uncertain as the drifts
    leave them.
    """
    model, columns = _model(points, pendulum, fit)
    jacobian, drifts = _by_drifts(model, columns, fit)
    residuals = np.concatenate([model(columns)[0], np.zeros(2)])
    residuals[: 2 * len(model.points)] /= _scale(fit)
    kept = np.array([u_ageing, u_period]) > 0
    size = np.where(kept, [u_ageing, u_period], 1e-12)
    known = np.column_stack([np.zeros((2, len(columns))), np.diag(1 / size)])
    both = np.vstack([np.column_stack([jacobian, drifts]), known])
    norm = np.linalg.norm(both, axis=0)
    norm[norm == 0] = 1.0
    change = -np.linalg.lstsq(both / norm, residuals, rcond=1e-12)[0] / norm
    wider = covariance_of(both)[: len(columns), : len(columns)] - covariance_of(jacobian)
    values, to_physical = model.columns.physical(columns + change[: len(columns)])
    added = propagate(to_physical, wider)
    before = np.ones(len(values)) if fit.widened is None else fit.widened
    u = fit.standard_uncertainty
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(np.sqrt(1 + np.maximum(np.diag(added), 0.0) / u**2), nan=1.0)
    return replace(fit, values=values, covariance=fit.covariance + added, widened=before * factor)


def changes_of(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, explained: float = 0.0
) -> tuple[Change, ...]:
    """Changes during a decay, the clearest first; none where smooth errors of the law explain it better.

    Parameters
    ----------
    explained
        By how much -2 ln L is smaller with smooth errors of the law (`Misfit.against_law`).
    """
    if fit.loss != "linear":
        return ()
    model, columns = _model(points, pendulum, fit)
    own = model.noise_of(fit)
    step = own.step if own.step > 0 else 1e-3 * float(np.median(model.u_amplitude))
    scans = []
    for share in _DRIVES:
        noise = Noise(step=share * step, averaged=own.averaged, limit=own.limit)
        scan = Scan.of(model, columns, noise)
        if scan is not None:
            scans.append(scan)
    if not scans:
        return ()
    lowest = min(scan.deviance() for scan in scans)
    chance = 2 * log(3 * len(model.points))
    found: list[Change] = []
    before = lowest
    for _ in range(_MOST):
        best = min((scan.best() for scan in scans), key=lambda one: one.deviance)
        gain = before - best.deviance
        if not gain > _CERTAIN + chance or not (found or gain > _CERTAIN + chance + explained):
            break
        found.append(_change(model, best, gain))
        for scan in scans:
            scan.take(best)
        before = min(scan.deviance() for scan in scans)
    return tuple(found)


def _model(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult
) -> tuple[ExactModel, Floats]:
    if fit.method is not FitMethod.EXACT or fit.ground is None:
        raise DataError("what changes during a run is seen by an exact fit")
    return ExactModel.of(points, pendulum, fit)


def _change(model: ExactModel, best: Best, gain: float) -> Change:
    place = best.place + EDGE
    points = model.points
    size, u_size = best.size, best.u_size
    if best.kind is ChangeKind.KNOCK:
        of_amplitude = model.reference / float(points.amplitude[place])
        size, u_size = size * of_amplitude, u_size * of_amplitude
    return Change(
        kind=best.kind,
        half_cycle=int(points.index[place]),
        time_s=float(points.time_s[place]),
        size=float(size),
        u_size=float(u_size),
        gain=float(gain),
    )


def warnings_of(changes: Sequence[Change]) -> tuple[str, ...]:
    """What is said of changes beside a fit."""
    return tuple(f"{change.text}; fit the parts before and after it on their own" for change in changes)
