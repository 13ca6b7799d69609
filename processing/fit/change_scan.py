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
from processing.swing import TurningPoints

_CHUNK = 64
"""Half-cycles whose changes are computed together."""
EDGE = 5
"""Half-cycles at both ends at which no change is looked for."""
_RELATIVE = 1e-9


class _Share:
    """The contact's part of the loss of a half-swing, by the amplitude in units of the reference."""

    def __init__(self, of_air: float, amplitude: Floats, loss: Floats) -> None:
        share = np.clip(1.0 - of_air * amplitude / loss, 0.0, 1.0)
        self._log_amplitude, self._share = np.log(amplitude[::-1]), share[::-1]

    def __call__(self, amplitude: Floats) -> Floats:
        return np.interp(np.log(amplitude), self._log_amplitude, self._share)


def contact_share(model: ExactModel, columns: Floats) -> _Share:
    """What remains of the loss without the drag, which takes ``A w0 drag pi / 2`` in a half-swing."""
    values = dict(zip(model.names, model.columns.physical(columns)[0].tolist(), strict=True))
    of_air = pi**2 * values.get(DRAG.key, 0.0) / values["period0_s"]
    amplitude, loss = model.losses(columns)
    return _Share(of_air, amplitude, loss)


class Best(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class Scan:
    """Whitened residuals for one drive, and what every change would do to them."""

    def __init__(
        self,
        residuals: Floats,
        directions: Floats,
        changes: Floats,
        constant: float,
        points: TurningPoints,
        reference: float,
    ) -> None:
        self._constant = constant
        self._rate = 2 * pi / mean_period(points)
        self._amplitude = points.amplitude[EDGE:] / reference
        self._left = residuals - directions @ (directions.T @ residuals)
        changes -= directions @ (directions.T @ changes)
        # kinds of change (4), places, rows
        self._changes = changes.T.reshape(4, -1, len(residuals))

    @classmethod
    def of(cls, model: ExactModel, columns: Floats, noise: Noise) -> "Scan | None":
        """None where the filter has no value for this drive."""
        contact, law = contact_share(model, columns), len(columns)
        nodes, loss = model.losses(columns)

        def losses(amplitude: Floats) -> Floats:
            return np.interp(-amplitude, -nodes, loss)

        time_s = model.points.time_s - model.points.time_s[0]
        # between the half-cycle before a place and the one at it
        at_s = 0.5 * (time_s[1:] + time_s[:-1])[EDGE - 1 : len(time_s) - EDGE - 1]
        parts: list[Floats] = []
        found = None
        for first in range(0, len(at_s), _CHUNK):
            here_s = at_s[first : first + _CHUNK]

            def of_loss(amplitude: Floats, node_s: Floats, here_s: Floats = here_s) -> Floats:
                knock = _impulses(node_s, here_s) / losses(amplitude)[:, None]
                after = (node_s[:, None] > here_s) * contact(amplitude)[:, None]
                return np.column_stack([knock, after])

            def of_duration(_: Floats, node_s: Floats, here_s: Floats = here_s) -> Floats:
                lasting = np.gradient(node_s)
                knock = _impulses(node_s, here_s) / lasting[:, None]
                return np.column_stack([knock, 1.0 * (node_s[:, None] > here_s)])

            found = model.filtered(columns, noise, errors=Errors(of_loss, of_duration))
            if not np.all(np.isfinite(found.residuals)):
                return None
            parts.append(found.jacobian[:, law:].reshape(len(found.residuals), 4, -1))
        if found is None:
            return None
        beside, beside_by = model.beside(columns)
        count = len(found.residuals)
        changes = np.concatenate(parts, axis=2).reshape(count, -1)
        jacobian, residuals = found.jacobian[:, :law], found.residuals
        # the scatter of the points, by the median: a change is not to hide behind what it does
        scale = max(1.0, float(np.median(np.abs(residuals))) / 0.6745)
        jacobian = np.concatenate([jacobian / scale, beside_by])
        residuals = np.concatenate([residuals / scale, beside])
        changes = np.concatenate([changes / scale, np.zeros((len(beside), changes.shape[1]))])
        norm = np.linalg.norm(jacobian, axis=0)
        norm[norm == 0] = 1.0
        directions, spread, _ = np.linalg.svd(jacobian / norm, full_matrices=False)
        kept = spread > _RELATIVE * spread[0]
        constant = found.log_det + 2 * count * log(scale)
        constant += 2 * float(np.sum(np.log(spread[kept]))) + 2 * float(np.sum(np.log(norm)))
        return cls(residuals, directions[:, kept], changes, constant, model.points, model.reference)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> Best:
        """The change that explains most."""
        out, now = None, self.deviance()
        score, power = self._changes @ self._left, np.sum(self._changes**2, axis=2) + 1e-30
        for kind, at in ((ChangeKind.FRICTION, 1), (ChangeKind.PERIOD, 3)):
            gains = score[at] ** 2 / power[at]
            place = int(np.argmax(gains))
            size, u = -score[at, place] / power[at, place], power[at, place] ** -0.5
            out = _better(out, Best(kind, place, size, u, now - float(gains[place])))
        cross = np.sum(self._changes[0] * self._changes[2], axis=1)
        det = power[0] * power[2] - cross**2
        both = score[0] ** 2 * power[2] + score[2] ** 2 * power[0] - 2 * score[0] * score[2] * cross
        gains = np.where(det > 1e-9 * power[0] * power[2], both / np.maximum(det, 1e-300), 0.0)
        place = int(np.argmax(gains))
        lost = (score[0, place] * power[2, place] - score[2, place] * cross[place]) / det[place]
        late = (score[2, place] * power[0, place] - score[0, place] * cross[place]) / det[place]
        late *= self._rate * self._amplitude[place]
        size, u = np.hypot(lost, late), np.sqrt(power[2, place] / det[place])
        return _better(out, Best(ChangeKind.KNOCK, place, size, u, now - float(gains[place])))

    def take(self, best: Best) -> None:
        """What is left once a change is allowed for."""
        kinds = {ChangeKind.FRICTION: [1], ChangeKind.PERIOD: [3], ChangeKind.KNOCK: [0, 2]}[best.kind]
        own, _ = np.linalg.qr(self._changes[kinds, best.place].T)
        self._left = self._left - own @ (own.T @ self._left)
        self._changes = self._changes - (self._changes @ own) @ own.T


def _better(one: Best | None, other: Best) -> Best:
    return other if one is None or other.deviance < one.deviance else one


def _impulses(node_s: Floats, at_s: Floats) -> Floats:
    """Ones (nodes, places) at the half-swing in which each time lies."""
    node = np.clip(np.searchsorted(node_s, at_s), 0, len(node_s) - 1)
    out = np.zeros((len(node_s), len(at_s)))
    out[node, np.arange(len(at_s))] = 1.0
    return out
