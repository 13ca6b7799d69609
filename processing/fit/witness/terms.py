"""Terms of a witness beside an exact fit: what they do to its turning points, and whether they pay."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise
from processing.fit.known_drive import KnownDrive, known_drive
from processing.fit.result import FitResult
from processing.fit.witness.signals import Term, Witness, signals_of
from processing.periods import mean_period
from processing.swing import TurningPoints

Terms = Sequence[tuple[int, Term]]
"""Terms of a fit: of each the component's number and its kind."""

_BLOCKS = 10
_LEAST = 1e-10
"""Share of the largest direction below which one is rounding."""
_MARGIN = 3.0
"""Periods of the witness before and after the run that its signals need."""


class Drives:
    """The signals of a witness and what they do to a run's turning points, by component and term."""

    def __init__(self, points: TurningPoints, witness: Witness, *, averaged: bool) -> None:
        self.period_s = mean_period(points)
        margin_s = _MARGIN * self.period_s
        beside = witness.between(points.time_s[0] - margin_s, points.time_s[-1] + margin_s)
        self.names = witness.names
        self.signals = signals_of(beside, self.period_s)
        self._points, self._averaged = points, averaged
        self.every = known_drive(points, self.signals, averaged=averaged)

    def of(self, terms: Terms) -> KnownDrive:
        """That of some terms, each a component's number and its kind."""
        return self.every.only([place(*term) for term in terms])

    def later(self, by_s: float, stretched: float = 0.0) -> KnownDrive:
        """All of them for signals that come later, and by a part of the time from the middle of the run."""
        time = self.signals.time_s
        middle = 0.5 * float(self._points.time_s[0] + self._points.time_s[-1])
        moved = replace(self.signals, time_s=time + by_s + stretched * (time - middle))
        return known_drive(self._points, moved, averaged=self._averaged)


def place(component: int, term: Term) -> int:
    """Column of a term among the signals."""
    return component * len(Term) + list(Term).index(term)


def started(drives: Drives, near: FitResult, chosen: Terms) -> KnownDrive:
    """The terms with the gains that an earlier fit with the first of them found; the others at 0."""
    known = np.zeros(0) if near.evidence.drive is None else near.evidence.drive.gains
    return drives.of(chosen).with_gains(np.concatenate([known, np.zeros(len(chosen) - len(known))]))


def model_of(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, drive: KnownDrive
) -> ExactModel:
    """The model of a fit with a drive whose first gains are the fit's and whose others are 0."""
    evidence = replace(fit.evidence, drive=drive)
    return ExactModel(points, pendulum, law=fit.law, drag=fit.has_drag, evidence=evidence)


def at_fit(model: ExactModel, fit: FitResult) -> tuple[Floats, Noise]:
    """Columns of a model, and its noise, where a fit ended."""
    assert fit.ground is not None
    columns = model.columns.from_physical({name: fit.estimate(name).value for name in model.names})
    return columns, replace(fit.ground.noise, step=fit.ground.noise.step / model.reference)


def residuals_with(model: ExactModel, fit: FitResult) -> tuple[Floats, Floats, Floats]:
    """Whitened residuals at a fit, their derivatives by the gains of the drive and by the other columns."""
    assert model.witnessed is not None
    found = model.filtered(*at_fit(model, fit))
    by_gains = found.jacobian[:, : model.witnessed.terms] / model.witnessed.unit
    return found.residuals, by_gains, found.jacobian[:, model.witnessed.terms :]


def gain_of_prediction(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    fit: FitResult,
    drives: Drives,
    chosen: Terms,
    more: Terms,
) -> float:
    """By how much -2 ln L of blocks of half-cycles falls with more terms, fitted to the other blocks."""
    drive = started(drives, fit, [*chosen, *more])
    residuals, by_gains, by_law = residuals_with(model_of(points, pendulum, fit, drive), fit)
    fitted = np.column_stack([by_law, by_gains[:, : len(chosen)]])
    return cross_validated(residuals, by_gains[:, len(chosen) :], fitted)


def law_free(residuals: Floats, candidates: Floats, fitted: Floats) -> tuple[Floats, Floats]:
    """Residuals and candidates, each of unit size, without what the columns `fitted` take up of them."""
    norm = np.linalg.norm(fitted, axis=0)
    basis, size, _ = np.linalg.svd(fitted / np.where(norm > 0, norm, 1.0), full_matrices=False)
    basis = basis[:, size > _LEAST * size[0]]
    return residuals - basis @ (basis.T @ residuals), candidates - basis @ (basis.T @ candidates)


def cross_validated(residuals: Floats, candidates: Floats, fitted: Floats) -> float:
    """Fall of the squares of residuals by candidates, each block's with what the others say.

    Residuals of amplitudes and then of times; `fitted` (rows, columns) is what was fitted already.
    """
    if not np.all(np.isfinite(candidates)) or not np.all(np.isfinite(residuals)):
        return -inf
    size = np.linalg.norm(candidates, axis=0)
    left, of = law_free(residuals, candidates / np.where(size > 0, size, 1.0), fitted)
    count = len(residuals) // 2
    block = np.tile(np.arange(count) * _BLOCKS // count, 2)
    fall = 0.0
    for one in range(_BLOCKS):
        here = block == one
        gains = np.linalg.lstsq(of[~here], left[~here], rcond=_LEAST)[0]
        fall += float(np.sum(left[here] ** 2) - np.sum((left[here] - of[here] @ gains) ** 2))
    return fall
