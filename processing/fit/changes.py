"""Changes while a pendulum swings: drifts over the whole run, and events that are found and dated.

A friction that ages evenly is not seen in one decay: amplitude and time fall together, and an exponent takes
up the effect of the age. The effect of such drifts on the parameters follows from the map, for a budget.

An event is sought at every half-cycle: a knock (a step of both quadratures of the oscillation), a step of the
friction, a step of the period. Each is judged by the restricted likelihood, with the drive of the ground
estimated anew, and counts where no smooth error of the law explains the decay as well.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import log, pi
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG
from processing.decay_summary import mean_period
from processing.fit.exact_model import ExactModel, LawErrors
from processing.fit.ground import Noise
from processing.fit.result import FITTED_DRIFTS, FRICTION_STEP, Change, ChangeKind, FitResult
from processing.fit.terms import DrivenRows, LinearisedFit, Term
from processing.least_squares import FactoredJacobian
from processing.noise_models import robust_scatter

_GROWTH_STEP = 1e-3
"""Relative growth of a friction by which the derivatives of its harmonics are taken."""
DRIFTS = ("ageing", "adhesion_ageing", "drag_drift", "period_drift")
"""What may drift evenly over a run, by the names of `RigQuantities`: the growth of the friction b, of the
constant friction c, of the drag and of the period from the first turning point to the last, relative.

They have different causes, and one of them alone moves parameters that all together would leave in place."""


def loss_shares(model: ExactModel, columns: Floats) -> Callable[[Floats], Floats]:
    """Shares of a half-swing's loss, as a function of amplitudes (n,) in units of the reference.

    The rows (2, n) are the contact's share and that of its constant friction. The drag takes
    ``A w0 drag pi / 2`` in a half-swing, the constant friction ``2 c`` at any amplitude.
    """
    values = model.values(columns)
    amplitude, loss = model.losses(columns)
    of_air = pi**2 * values.get(DRAG.key, 0.0) / values["period0_s"] * amplitude / loss
    of_adhesion = 2.0 * values.get("c", 0.0) / model.reference / loss
    shares = np.clip([1.0 - of_air, of_adhesion], 0.0, 1.0)[:, ::-1]
    log_amplitude = np.log(amplitude[::-1])
    return lambda x: np.array([np.interp(np.log(x), log_amplitude, share) for share in shares])


def drift_effects(at: LinearisedFit) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters of an exact fit by `DRIFTS`.

    The parameters refer to the middle of the run.
    """
    return dict(zip(DRIFTS, at.moved_by(-drift_term(at).columns).T, strict=True))


def drift_term(at: LinearisedFit, u_drifts: Mapping[str, float] | None = None) -> Term:
    """The term of `DRIFTS` about zero; without `u_drifts` they have no prior."""
    rows = rows_with_drifts(at.model, at.coordinates, at.noise)
    prior = np.inf if u_drifts is None else np.array([u_drifts.get(name, 0.0) for name in DRIFTS])
    return Term(FITTED_DRIFTS, rows.in_scatter(at.scale).by_errors, prior)


def rows_with_drifts(model: ExactModel, columns: Floats, noise: Noise) -> DrivenRows:
    """The rows of a model for a drive, with their derivatives by `DRIFTS`."""
    shares = loss_shares(model, columns)
    lasting_s = float(model.points.time_s[-1] - model.points.time_s[0])

    def of_loss(amplitude: Floats, time_s: Floats) -> Floats:
        of_contact, of_adhesion = shares(amplitude)
        parts = np.column_stack([of_contact - of_adhesion, of_adhesion, 1.0 - of_contact])
        return np.asarray(parts * _since_middle(time_s, lasting_s)[:, None])

    def slower(_: Floats, time_s: Floats) -> Floats:
        return _since_middle(time_s, lasting_s)[:, None]

    of_waveform = np.zeros((len(model.evidence_rows(columns)[0]), len(DRIFTS)))
    waveform = model.evidence.waveform
    if waveform is not None and model.pendulum is not None:
        amplitude, values = waveform.amplitude_rad / model.reference, model.values(columns)
        passed_s = np.interp(-amplitude, -model.points.amplitude / model.reference, model.points.time_s)
        since = _since_middle(passed_s - model.points.time_s[0], lasting_s)[:, None]
        here = waveform.predicted_rad(model.law, values, model.pendulum)
        for column, name in enumerate(("b", "c")):
            grown = values | {name: (1 + _GROWTH_STEP) * values.get(name, 0.0)}
            moved = (waveform.predicted_rad(model.law, grown, model.pendulum) - here) / _GROWTH_STEP
            reduced = waveform.reduced(since * moved)
            of_waveform[: len(reduced), column] = reduced
    return DrivenRows.of(model, columns, noise, LawErrors(of_loss, slower), of_waveform)


def _since_middle(time_s: Floats, lasting_s: float) -> Floats:
    """Time from the middle of the run over its duration, -1/2 to 1/2."""
    return time_s / lasting_s - 0.5


_CHUNK = 64
"""Places at which changes are computed together."""
_EDGE = 5
"""Half-cycles at both ends at which no change is looked for."""
_STEP_PROBABILITY = 0.2
"""Prior probability that a run has a step of the friction."""
_DRIVE_FACTORS = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without changes."""
_CLEAR_GAIN = 20.0
"""Gain in -2 ln L that a change must have beyond that of choosing among all half-cycles."""
_MOST_CHANGES = 3


def with_changes(
    at: LinearisedFit, u_step: float, explained: float = 0.0, fit: FitResult | None = None
) -> FitResult:
    """The fit with the events in its decay, and with the uncertainty by a step of the friction not found.

    A step too small to be found moves the parameters all the same. Their uncertainties hold it in proportion
    to its probability at each place, so that no uncertainty leaps where a step is found.

    Parameters
    ----------
    u_step
        Prior standard uncertainty of the relative size of a step.
    explained
        By how much -2 ln L is smaller with smooth errors of the law (`DiscrepancySize.against_law`).
    fit
        The fit that receives the changes, where it has terms that `at.fit` has not.
    """
    fit = at.fit if fit is None else fit
    scans = _scans(at) if fit.loss == "linear" else []
    if not scans:
        return fit
    if u_step > 0:
        fit = fit.with_term(FRICTION_STEP, at.to_physical @ scans[0].hidden_friction(u_step, explained))
    changes = _found_changes(at, scans, explained)
    return replace(fit, changes=changes, warnings=(*fit.warnings, *warnings_of(changes)))


def _scans(at: LinearisedFit) -> list["_ChangeScan"]:
    own = at.noise
    step = own.step if own.step > 0 else 1e-3 * float(np.median(at.model.u_amplitude))
    found = (_ChangeScan.of(at, replace(own, step=share * step)) for share in _DRIVE_FACTORS)
    return [scan for scan in found if scan is not None]


def _found_changes(at: LinearisedFit, scans: Sequence["_ChangeScan"], explained: float) -> tuple[Change, ...]:
    chance = 2 * log(3 * len(at.points))
    found: list[Change] = []
    before = min(scan.deviance() for scan in scans)
    for _ in range(_MOST_CHANGES):
        best = min((scan.best() for scan in scans), key=lambda one: one.deviance)
        gain = before - best.deviance
        if not gain > _CLEAR_GAIN + chance or not (found or gain > _CLEAR_GAIN + chance + explained):
            break
        found.append(_change(at, best, gain))
        for scan in scans:
            scan.take(best)
        before = min(scan.deviance() for scan in scans)
    return tuple(found)


def _change(at: LinearisedFit, best: "_ClearestChange", gain: float) -> Change:
    place = best.place + _EDGE
    points = at.points
    size, u_size = best.size, best.u_size
    if best.kind is ChangeKind.KNOCK:
        of_amplitude = at.model.reference / float(points.amplitude[place])
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
    """Warnings of a fit, one for each change during its decay."""
    return tuple(f"{change.text}; fit the parts before and after it on their own" for change in changes)


class _ClearestChange(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class _ChangeScan:
    """Whitened residuals for one drive, and their derivatives by a change at each place.

    The derivatives are computed anew for each search, some places at a time: all of a long decay's would fill
    the memory.
    """

    def __init__(self, at: LinearisedFit, noise: Noise, rows: DrivenRows) -> None:
        self._at, self._noise = at, noise
        model = at.model
        self._shares = loss_shares(model, at.coordinates)
        self._nodes, self._loss = model.losses(at.coordinates)
        time_s = model.points.time_s - model.points.time_s[0]
        # a change lies between the half-cycle before its place and the one at it
        self._places_s = 0.5 * (time_s[1:] + time_s[:-1])[_EDGE - 1 : len(time_s) - _EDGE - 1]
        self._rate = 2 * pi / mean_period(model.points)
        self._amplitude = model.points.amplitude[_EDGE:] / model.reference
        # by the median, which a change hardly moves: it must not hide in a scatter that it makes
        self._scale = max(1.0, robust_scatter(rows.residuals[: rows.points], middle=0.0))
        rows = rows.in_scatter(self._scale)
        self._law = FactoredJacobian(rows.jacobian)
        self._taken: list[FactoredJacobian] = []
        self._left = self._law.left(rows.residuals)
        self._constant = rows.log_det + self._law.log_det

    @classmethod
    def of(cls, at: LinearisedFit, noise: Noise) -> "_ChangeScan | None":
        """None where the filter has no value for this drive, or there is no place to look at."""
        if len(at.points) <= 2 * _EDGE:
            return None
        rows = DrivenRows.of(at.model, at.coordinates, noise)
        return cls(at, noise, rows) if np.all(np.isfinite(rows.residuals)) else None

    def hidden_friction(self, u_size: float, explained: float) -> Floats:
        """Changes (coordinates, places) by one standard deviation of a friction step that was not corrected.

        Prior: a step with the probability `_STEP_PROBABILITY`, at any place alike, its size zero with the
        standard uncertainty `u_size`. The data weigh each place by its gain in -2 ln L beyond `explained`.
        """
        sizes, chances, moved = [], [], []
        for first in range(0, len(self._places_s), _CHUNK):
            raw = self._changes(first, _CHUNK, whole=True)[:, 1]
            changes = self._law.left(raw)
            power = np.einsum("rp,rp->p", changes, changes) + 1e-30
            variance = 1.0 / (1.0 / u_size**2 + power)
            size = -variance * (self._left @ changes)
            gain = np.maximum(size**2 / variance - explained, 0.0)
            sizes.append(size**2 + variance)
            chances.append(np.exp(np.minimum(0.5 * gain, 300.0)) * np.sqrt(variance) / u_size)
            moved.append(self._law.coefficients(raw))
        chance = np.concatenate(chances) * _STEP_PROBABILITY / len(self._places_s)
        weight = np.concatenate(sizes) * chance / (np.sum(chance) + 1.0 - _STEP_PROBABILITY)
        return np.asarray(np.concatenate(moved, axis=1) * np.sqrt(weight))

    def _changes(self, first: int, count: int, *, whole: bool = False) -> Floats:
        """Derivatives (rows, 4, places) of the rows by four unit changes at `count` places from `first` on.

        They are without what law and earlier changes take up, unless they are to be `whole`.
        """
        here_s = self._places_s[first : first + count]

        def of_loss(amplitude: Floats, node_s: Floats) -> Floats:
            knock = _impulses(node_s, here_s) / np.interp(-amplitude, -self._nodes, self._loss)[:, None]
            after = (node_s[:, None] > here_s) * self._shares(amplitude)[0][:, None]
            return np.column_stack([knock, after])

        def of_duration(_: Floats, node_s: Floats) -> Floats:
            lasting = np.gradient(node_s)
            knock = _impulses(node_s, here_s) / lasting[:, None]
            return np.column_stack([knock, 1.0 * (node_s[:, None] > here_s)])

        at, errors = self._at, LawErrors(of_loss, of_duration)
        changes = DrivenRows.of(at.model, at.coordinates, self._noise, errors).by_errors / self._scale
        if not whole:
            changes = self._law.left(changes)
            for taken in self._taken:
                changes = taken.left(changes)
        return changes.reshape(len(changes), 4, -1)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> _ClearestChange:
        """The change that explains most."""
        out = None
        for first in range(0, len(self._places_s), _CHUNK):
            out = _better(out, self._best_of(first))
        assert out is not None
        return out

    def _best_of(self, first: int) -> _ClearestChange:
        """The change that explains most at the places of a chunk from `first` on."""
        changes = self._changes(first, _CHUNK)
        out, now = None, self.deviance()
        score = np.einsum("r,rkp->kp", self._left, changes)
        power = np.einsum("rkp,rkp->kp", changes, changes) + 1e-30
        for kind, at in ((ChangeKind.FRICTION, 1), (ChangeKind.PERIOD, 3)):
            gains = score[at] ** 2 / power[at]
            place = int(np.argmax(gains))
            size, u = -score[at, place] / power[at, place], power[at, place] ** -0.5
            out = _better(out, _ClearestChange(kind, first + place, size, u, now - float(gains[place])))
        cross = np.einsum("rp,rp->p", changes[:, 0], changes[:, 2])
        det = power[0] * power[2] - cross**2
        both = score[0] ** 2 * power[2] + score[2] ** 2 * power[0] - 2 * score[0] * score[2] * cross
        gains = np.where(det > 1e-9 * power[0] * power[2], both / np.maximum(det, 1e-300), 0.0)
        place = int(np.argmax(gains))
        lost = (score[0, place] * power[2, place] - score[2, place] * cross[place]) / det[place]
        late = (score[2, place] * power[0, place] - score[0, place] * cross[place]) / det[place]
        late *= self._rate * self._amplitude[first + place]
        size, u = np.hypot(lost, late), np.sqrt(power[2, place] / det[place])
        return _better(
            out, _ClearestChange(ChangeKind.KNOCK, first + place, size, u, now - float(gains[place]))
        )

    def take(self, best: _ClearestChange) -> None:
        """Let a change explain its part of the residuals in all that follows."""
        kinds = {ChangeKind.FRICTION: [1], ChangeKind.PERIOD: [3], ChangeKind.KNOCK: [0, 2]}[best.kind]
        own = FactoredJacobian(self._changes(best.place, 1)[:, kinds, 0])
        self._left = own.left(self._left)
        self._taken.append(own)


def _better(one: _ClearestChange | None, other: _ClearestChange) -> _ClearestChange:
    return other if one is None or other.deviance < one.deviance else one


def _impulses(node_s: Floats, at_s: Floats) -> Floats:
    """Ones (nodes, places) at the half-swing in which each time lies."""
    node = np.clip(np.searchsorted(node_s, at_s), 0, len(node_s) - 1)
    out = np.zeros((len(node_s), len(at_s)))
    out[node, np.arange(len(at_s))] = 1.0
    return out
