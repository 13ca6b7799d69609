"""What each change of a decay would do to its residuals, at every half-cycle, for one drive of the ground."""

from math import log, pi
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG
from processing.fit.exact_model import Errors, ExactModel
from processing.fit.ground import Noise
from processing.fit.law_errors import ChangeKind
from processing.periods import mean_period

_CHUNK = 64
"""Half-cycles whose changes are computed together."""
EDGE = 5
"""Half-cycles at both ends at which no change is looked for."""
_RELATIVE = 1e-9
_STEP = 0.2
"""Chance of a step of the friction in a run, before its data are seen."""


class Share:
    """A part of the loss of a half-swing, by the amplitude in units of the reference."""

    def __init__(self, amplitude: Floats, share: Floats) -> None:
        self._log_amplitude, self._share = np.log(amplitude[::-1]), np.clip(share, 0.0, 1.0)[::-1]

    def __call__(self, amplitude: Floats) -> Floats:
        return np.interp(np.log(amplitude), self._log_amplitude, self._share)


def contact_share(model: ExactModel, columns: Floats) -> Share:
    """What remains of the loss without the drag, which takes ``A w0 drag pi / 2`` in a half-swing."""
    values = dict(zip(model.names, model.columns.physical(columns)[0].tolist(), strict=True))
    of_air = pi**2 * values.get(DRAG.key, 0.0) / values["period0_s"]
    amplitude, loss = model.losses(columns)
    return Share(amplitude, 1.0 - of_air * amplitude / loss)


def adhesion_share(model: ExactModel, columns: Floats) -> Share:
    """What the friction takes that does not depend on the amplitude, ``2 c`` in a half-swing."""
    values = dict(zip(model.names, model.columns.physical(columns)[0].tolist(), strict=True))
    amplitude, loss = model.losses(columns)
    return Share(amplitude, 2.0 * values.get("c", 0.0) / model.reference / loss)


class Best(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class Scan:
    """Whitened residuals for one drive, and what every change would do to them.

    That is computed anew for each search, some places at a time: of a long decay all of it fills the memory.
    """

    def __init__(self, model: ExactModel, columns: Floats, noise: Noise) -> None:
        self._model, self._columns, self._noise = model, columns, noise
        self._contact = contact_share(model, columns)
        self._nodes, self._loss = model.losses(columns)
        time_s = model.points.time_s - model.points.time_s[0]
        # between the half-cycle before a place and the one at it
        self._at_s = 0.5 * (time_s[1:] + time_s[:-1])[EDGE - 1 : len(time_s) - EDGE - 1]
        self._rate = 2 * pi / mean_period(model.points)
        self._amplitude = model.points.amplitude[EDGE:] / model.reference
        found = model.filtered(columns, noise)
        beside, beside_by = model.beside(columns)
        self._beside = len(beside)
        # the scatter of the points, by the median: a change is not to hide behind what it does
        self._scale = max(1.0, float(np.median(np.abs(found.residuals))) / 0.6745)
        jacobian = np.concatenate([found.jacobian / self._scale, beside_by])
        residuals = np.concatenate([found.residuals / self._scale, beside])
        norm = np.linalg.norm(jacobian, axis=0)
        norm[norm == 0] = 1.0
        directions, spread, turned = np.linalg.svd(jacobian / norm, full_matrices=False)
        kept = spread > _RELATIVE * spread[0]
        self._constant = found.log_det + 2 * len(found.residuals) * log(self._scale)
        self._constant += 2 * float(np.sum(np.log(spread[kept]))) + 2 * float(np.sum(np.log(norm)))
        self._directions = directions[:, kept]
        self._to_columns = (turned[kept].T / spread[kept]) / norm[:, None]
        self._left = residuals - self._directions @ (self._directions.T @ residuals)

    @classmethod
    def of(cls, model: ExactModel, columns: Floats, noise: Noise) -> "Scan | None":
        """None where the filter has no value for this drive, or there is no place to look at."""
        if len(model.points) <= 2 * EDGE or not np.all(np.isfinite(model.filtered(columns, noise).residuals)):
            return None
        return cls(model, columns, noise)

    def hidden_friction(self, u_size: float, explained: float) -> Floats:
        """Covariance of the columns by a step of the friction that may be there and that nothing takes off.

        Its size is believed to be nought with the standard uncertainty `u_size`, its time to be any, and
        there to be one with the chance `_STEP`; the data say how much of it they want, less what is
        `explained` otherwise.
        """
        sizes, chances, moved = [], [], []
        for first in range(0, len(self._at_s), _CHUNK):
            raw = self._changes(first, _CHUNK, whole=True)[:, 1]
            along = self._directions.T @ raw
            changes = raw - self._directions @ along
            power = np.einsum("rp,rp->p", changes, changes) + 1e-30
            told = 1.0 / (1.0 / u_size**2 + power)
            size = -told * (self._left @ changes)
            gain = np.maximum(size**2 / told - explained, 0.0)
            sizes.append(size**2 + told)
            chances.append(np.exp(np.minimum(0.5 * gain, 300.0)) * np.sqrt(told) / u_size)
            moved.append(self._to_columns @ along[: self._to_columns.shape[1]])
        chance = np.concatenate(chances) * _STEP / len(self._at_s)
        weight = np.concatenate(sizes) * chance / (np.sum(chance) + 1.0 - _STEP)
        by = np.concatenate(moved, axis=1)
        return np.asarray((by * weight) @ by.T)

    def _changes(self, first: int, count: int, *, whole: bool = False) -> Floats:
        """What the kinds of change (4) do at some places to the rows that nothing explains yet; `whole`: to
        the rows.

        Shape (rows, 4, places).
        """
        here_s = self._at_s[first : first + count]

        def of_loss(amplitude: Floats, node_s: Floats) -> Floats:
            knock = _impulses(node_s, here_s) / np.interp(-amplitude, -self._nodes, self._loss)[:, None]
            after = (node_s[:, None] > here_s) * self._contact(amplitude)[:, None]
            return np.column_stack([knock, after])

        def of_duration(_: Floats, node_s: Floats) -> Floats:
            lasting = np.gradient(node_s)
            knock = _impulses(node_s, here_s) / lasting[:, None]
            return np.column_stack([knock, 1.0 * (node_s[:, None] > here_s)])

        found = self._model.filtered(self._columns, self._noise, errors=Errors(of_loss, of_duration))
        by_errors = found.jacobian[:, len(self._columns) :]
        changes = np.zeros((len(self._left), by_errors.shape[1]))
        np.divide(by_errors, self._scale, out=changes[: len(by_errors)])
        if not whole:
            changes -= self._directions @ (self._directions.T @ changes)
        return changes.reshape(len(changes), 4, -1)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> Best:
        """The change that explains most."""
        out = None
        for first in range(0, len(self._at_s), _CHUNK):
            out = _better(out, self._best_of(first))
        assert out is not None
        return out

    def _best_of(self, first: int) -> Best:
        """The same of the places from `first` on."""
        changes = self._changes(first, _CHUNK)
        out, now = None, self.deviance()
        score = np.einsum("r,rkp->kp", self._left, changes)
        power = np.einsum("rkp,rkp->kp", changes, changes) + 1e-30
        for kind, at in ((ChangeKind.FRICTION, 1), (ChangeKind.PERIOD, 3)):
            gains = score[at] ** 2 / power[at]
            place = int(np.argmax(gains))
            size, u = -score[at, place] / power[at, place], power[at, place] ** -0.5
            out = _better(out, Best(kind, first + place, size, u, now - float(gains[place])))
        cross = np.einsum("rp,rp->p", changes[:, 0], changes[:, 2])
        det = power[0] * power[2] - cross**2
        both = score[0] ** 2 * power[2] + score[2] ** 2 * power[0] - 2 * score[0] * score[2] * cross
        gains = np.where(det > 1e-9 * power[0] * power[2], both / np.maximum(det, 1e-300), 0.0)
        place = int(np.argmax(gains))
        lost = (score[0, place] * power[2, place] - score[2, place] * cross[place]) / det[place]
        late = (score[2, place] * power[0, place] - score[0, place] * cross[place]) / det[place]
        late *= self._rate * self._amplitude[first + place]
        size, u = np.hypot(lost, late), np.sqrt(power[2, place] / det[place])
        return _better(out, Best(ChangeKind.KNOCK, first + place, size, u, now - float(gains[place])))

    def take(self, best: Best) -> None:
        """What is left once a change is allowed for."""
        kinds = {ChangeKind.FRICTION: [1], ChangeKind.PERIOD: [3], ChangeKind.KNOCK: [0, 2]}[best.kind]
        own, _ = np.linalg.qr(self._changes(best.place, 1)[:, kinds, 0])
        self._left = self._left - own @ (own.T @ self._left)
        # orthogonal to those before, so that both are taken off together
        self._directions = np.column_stack([self._directions, own])


def _better(one: Best | None, other: Best) -> Best:
    return other if one is None or other.deviance < one.deviance else one


def _impulses(node_s: Floats, at_s: Floats) -> Floats:
    """Ones (nodes, places) at the half-swing in which each time lies."""
    node = np.clip(np.searchsorted(node_s, at_s), 0, len(node_s) - 1)
    out = np.zeros((len(node_s), len(at_s)))
    out[node, np.arange(len(at_s))] = 1.0
    return out
