"""What changes while a pendulum swings: events that are found and dated, drifts that one decay cannot see.

A change is looked for at every half-cycle: a knock (both quadratures of the oscillation step), a friction
that is another one from then on, a period that is. Each is judged by the restricted likelihood, with the
drive of the ground estimated anew, and counts where no smooth error of the law explains the decay as well.

A friction that ages evenly is not seen: amplitude and time fall together, and an exponent takes up what the
age does. What such drifts do to the parameters follows from the map, for a budget.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import log

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.change_scan import EDGE, Best, Scan, adhesion_share, contact_share
from processing.fit.exact_model import Errors, ExactModel
from processing.fit.ground import Noise
from processing.fit.law_errors import Change, ChangeKind
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.least_squares import covariance_of, propagate
from processing.swing import TurningPoints

_DRIVES = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives that are tried, over the one that the law without changes needs."""
_CERTAIN = 20.0
"""Gain in -2 ln L that a change must have beyond that of choosing among all half-cycles."""
_MOST = 3
_GROWN = 1e-3
"""Relative growth of a friction by which the derivatives of its harmonics are taken."""


DRIFTS = ("ageing", "adhesion_ageing", "drag_drift", "period_drift")
"""What may drift evenly over a run, by the names of `RigQuantities`: the growth of the friction b, of the
constant friction c, of the drag and of the period from the first turning point to the last, relative.

They have different causes, and one that is alone moves what their sum leaves where it is."""


def drifts_of(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters of an exact fit of these points by `DRIFTS`.

    Parameters are those of the middle of the run. Raises DataError for another method.
    """
    model, columns = _model(points, pendulum, fit)
    jacobian, drifts = _by_drifts(model, columns, fit)
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    moved = np.linalg.lstsq(jacobian / norm, drifts, rcond=1e-10)[0] / norm[:, None]
    by = (model.columns.physical(columns)[1] @ moved)[: len(fit.contact_names)]
    return dict(zip(DRIFTS, by.T, strict=True))


def _scale(fit: FitResult) -> float:
    return 1.0 if fit.ground is None else fit.ground.measurement_scale


def _by_drifts(model: ExactModel, columns: Floats, fit: FitResult) -> tuple[Floats, Floats]:
    """Derivatives of the residuals by the columns, and by `DRIFTS`."""
    return by_drifts(model, columns, model.noise_of(fit), _scale(fit))


def by_drifts(model: ExactModel, columns: Floats, noise: Noise, scale: float) -> tuple[Floats, Floats]:
    """Derivatives of the residuals by the columns, and by `DRIFTS`; `scale` is that of the stated
    uncertainties."""
    values = dict(zip(model.names, model.columns.physical(columns)[0].tolist(), strict=True))
    contact, adhesion = contact_share(model, columns), adhesion_share(model, columns)
    lasting_s = float(model.points.time_s[-1] - model.points.time_s[0])

    def of_loss(amplitude: Floats, time_s: Floats) -> Floats:
        of_contact, of_adhesion = contact(amplitude), adhesion(amplitude)
        parts = np.column_stack([of_contact - of_adhesion, of_adhesion, 1.0 - of_contact])
        return np.asarray(parts * _since_middle(time_s, lasting_s)[:, None])

    def slower(_: Floats, time_s: Floats) -> Floats:
        return _since_middle(time_s, lasting_s)[:, None]

    found = model.filtered(columns, noise, errors=Errors(of_loss, slower))
    beside = model.beside(columns)[1]
    of_waveform = np.zeros((len(beside), len(DRIFTS)))
    waveform = model.evidence.waveform
    if waveform is not None and model.pendulum is not None:
        amplitude = waveform.amplitude_rad / model.reference
        passed_s = np.interp(-amplitude, -model.points.amplitude / model.reference, model.points.time_s)
        since = _since_middle(passed_s - model.points.time_s[0], lasting_s)[:, None]
        here = waveform.predicted_rad(model.law, values, model.pendulum)
        for column, name in enumerate(("b", "c")):
            grown = values | {name: (1 + _GROWN) * values.get(name, 0.0)}
            moved = (waveform.predicted_rad(model.law, grown, model.pendulum) - here) / _GROWN
            reduced = waveform.reduced(since * moved)
            of_waveform[: len(reduced), column] = reduced
    law = len(columns)
    jacobian = np.concatenate([found.jacobian[:, :law] / scale, beside])
    return jacobian, np.concatenate([found.jacobian[:, law:] / scale, of_waveform])


def _since_middle(time_s: Floats, lasting_s: float) -> Floats:
    """From -1/2 to 1/2."""
    return time_s / lasting_s - 0.5


def with_drifts(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, u_drifts: Mapping[str, float]
) -> FitResult:
    """The fit with `DRIFTS` among its parameters, each about nought with its standard uncertainty.

    What the data say of them is used: parameters move by it, linearly, and are as uncertain as the drifts
    leave them.
    """
    model, columns = _model(points, pendulum, fit)
    jacobian, drifts = _by_drifts(model, columns, fit)
    size = np.array([u_drifts.get(name, 0.0) or 1e-12 for name in DRIFTS])
    residuals = np.concatenate([model(columns)[0] / _scale(fit), np.zeros(len(size))])
    known = np.column_stack([np.zeros((len(size), len(columns))), np.diag(1 / size)])
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


def with_changes(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    fit: FitResult,
    u_step: float,
    explained: float = 0.0,
) -> FitResult:
    """The fit with the changes during its decay, and with the uncertainty that a step of the friction leaves.

    A step too small to be found moves the parameters all the same. It is in their uncertainties by as much
    as the data speak for one, wherever it is: nothing leaps where one is found.

    Parameters
    ----------
    u_step
        Standard uncertainty of the relative size of a step, if there is one.
    explained
        By how much -2 ln L is smaller with smooth errors of the law (`Misfit.against_law`).
    """
    if fit.loss != "linear":
        return fit
    model, columns = _model(points, pendulum, fit)
    scans = _scans(model, columns, fit)
    if not scans:
        return fit
    added = np.zeros_like(fit.covariance)
    if u_step > 0:
        to_physical = model.columns.physical(columns)[1]
        added = propagate(to_physical, scans[0].hidden_friction(u_step, explained))
    changes = _found(model, scans, explained)
    known = np.isfinite(np.diag(fit.covariance))
    before = np.ones(len(known)) if fit.widened is None else fit.widened
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(np.sqrt(1 + np.diag(added) / fit.standard_uncertainty**2), nan=1.0)
    return replace(
        fit,
        changes=changes,
        covariance=fit.covariance + np.where(np.outer(known, known), added, 0.0),
        widened=before * factor,
        change_covariance=added,
        warnings=(*fit.warnings, *warnings_of(changes)),
    )


def changes_of(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, explained: float = 0.0
) -> tuple[Change, ...]:
    """Changes during a decay, the clearest first; none where smooth errors of the law explain it better."""
    return with_changes(points, pendulum, fit, 0.0, explained).changes


def _scans(model: ExactModel, columns: Floats, fit: FitResult) -> list[Scan]:
    own = model.noise_of(fit)
    step = own.step if own.step > 0 else 1e-3 * float(np.median(model.u_amplitude))
    noises = [Noise(step=share * step, averaged=own.averaged, limit=own.limit) for share in _DRIVES]
    return [scan for scan in (Scan.of(model, columns, noise) for noise in noises) if scan is not None]


def _found(model: ExactModel, scans: Sequence[Scan], explained: float) -> tuple[Change, ...]:
    chance = 2 * log(3 * len(model.points))
    found: list[Change] = []
    before = min(scan.deviance() for scan in scans)
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
