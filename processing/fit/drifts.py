"""Drifts of contact, air and period over a run, which one decay cannot see.

A friction that ages evenly is not seen: amplitude and time fall together, and an exponent takes up what the
age does. What such drifts do to the parameters follows from the map, for a budget.
"""

from collections.abc import Mapping
from math import pi

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, PendulumOnBall
from processing.fit.exact_model import Errors, ExactModel
from processing.fit.ground import Noise
from processing.fit.result import FITTED_DRIFTS, FitResult
from processing.fit.terms import Linearised, Term
from processing.swing import TurningPoints

_GROWN = 1e-3
"""Relative growth of a friction by which the derivatives of its harmonics are taken."""
DRIFTS = ("ageing", "adhesion_ageing", "drag_drift", "period_drift")
"""What may drift evenly over a run, by the names of `RigQuantities`: the growth of the friction b, of the
constant friction c, of the drag and of the period from the first turning point to the last, relative.

They have different causes, and one that is alone moves what their sum leaves where it is."""


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


def drifts_of(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters of an exact fit of these points by `DRIFTS`.

    Parameters are those of the middle of the run. Raises DataError for another method.
    """
    at = Linearised.of(points, pendulum, fit)
    return dict(zip(DRIFTS, at.moved_by(-drift_term(at).columns).T, strict=True))


def drift_term(at: Linearised, u_drifts: Mapping[str, float] | None = None) -> Term:
    """`DRIFTS` about zero with their standard uncertainties; without them nothing is known of any."""
    noise = at.model.noise_of(at.fit)
    columns = by_drifts(at.model, at.coordinates, noise, at.scale)[1]
    prior = np.inf if u_drifts is None else np.array([u_drifts.get(name, 0.0) for name in DRIFTS])
    return Term(FITTED_DRIFTS, columns, prior)


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
