"""Terms of a witness beside an exact fit: what they do to its turning points, and whether they pay.

When the witness saw what moved the pendulum is fitted with them: an unknown offset of its clock, a delay and
a drift.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise
from processing.fit.known_drive import KnownDrive, known_drive
from processing.fit.result import FitResult
from processing.fit.terms import Term, solve
from processing.fit.witness.signals import PAIR, Kind, Witness, signals_of
from processing.least_squares import Factored
from processing.periods import mean_period
from processing.swing import TurningPoints

Terms = Sequence[tuple[int, Kind]]
"""Terms of a fit: of each the component's number and its kind."""

_BLOCKS = 10
_MARGIN = 3.0
"""Periods of the witness before and after the run that its signals need."""
_SHIFT = 0.02
"""Shift of the signals, in periods, for the derivative by their time."""
_SPACING = 1 / 8
"""Of offsets that are tried, in periods: gain and quadrature take up what is between."""
_MOST_TRIED = 20_000
_COVERED = 0.6
"""Share of the half-swings that a witness has to cover at an offset that is tried."""


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


def place(component: int, term: Kind) -> int:
    """Column of a term among the signals."""
    return component * len(Kind) + list(Kind).index(term)


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


def cross_validated(residuals: Floats, candidates: Floats, fitted: Floats) -> float:
    """Fall of the squares of residuals by candidates, each block's with what the others say.

    Residuals of amplitudes and then of times; `fitted` (rows, columns) is what was fitted already.
    """
    if not np.all(np.isfinite(candidates)) or not np.all(np.isfinite(residuals)):
        return -inf
    law = Factored(fitted)
    left, of = law.left(residuals), law.left(candidates)
    count = len(residuals) // 2
    block = np.tile(np.arange(count) * _BLOCKS // count, 2)
    fall = 0.0
    for one in range(_BLOCKS):
        here = block == one
        gains = Factored(of[~here]).coefficients(left[~here])
        fall += float(np.sum(left[here] ** 2) - np.sum((left[here] - of[here] @ gains) ** 2))
    return fall


class Clock(NamedTuple):
    """What is to be added to a witness's times, in s, and in s per second from the middle of the run."""

    delay_s: Estimate
    drift: Estimate

    @property
    def wrong(self) -> bool:
        """Whether either is seen, at four standard uncertainties."""
        return any(abs(one.value) > 4 * one.standard_uncertainty for one in self)


def clock_of(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, drives: Drives, chosen: Terms
) -> Clock:
    """What a fit with some terms says of the witness's clock; gain and phase are free beside it.

    A delay turns phases in proportion to the frequency. That the quadrature takes up at the pendulum's
    frequency; what is left is how the phase changes within the band that a half-swing feels.
    """
    drive = started(drives, fit, chosen)
    places = [place(*term) for term in chosen]
    by_s = _SHIFT * drives.period_s
    half_s = 0.5 * float(points.time_s[-1] - points.time_s[0])
    moved = []
    for late, early, size in (
        (drives.later(by_s), drives.later(-by_s), by_s),
        (drives.later(0.0, by_s / half_s), drives.later(0.0, -by_s / half_s), by_s / half_s),
    ):
        change = (late.steps - early.steps)[:, :, places] @ drive.gains / (2 * size)
        moved.append(np.where(late.missing | early.missing, 0.0, change))
    both = KnownDrive(
        np.concatenate([drive.steps, np.stack(moved, axis=2)], axis=2),
        drive.missing,
        np.concatenate([drive.gains, np.zeros(2)]),
    )
    residuals, by_gains, by_law = residuals_with(model_of(points, pendulum, fit, both), fit)
    fitted = np.column_stack([by_law, by_gains[:, :-2]])
    found = solve(residuals, fitted, [Term("clock", by_gains[:, -2:])])
    u = np.sqrt(np.diag(found.covariance)) * found.scatter(fit.dof)
    return Clock(*(Estimate(float(a), float(b)) for a, b in zip(found.values, u, strict=True)))


class Offset(NamedTuple):
    """What is to be added to a witness's times so that it explains most, and among how many it was sought."""

    by_s: float
    tried: int


def found_offset(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    witness: Witness,
    alone: FitResult,
    *,
    averaged: bool = True,
) -> Offset:
    """The offset at which gain and quadrature of all components explain most of the pendulum's motion.

    Raises
    ------
    DataError
        The witness is shorter than what it has to cover, or so long that its offset has to be stated.
    """
    period_s = mean_period(points)
    signals = signals_of(witness, period_s)
    length_s = float(points.time_s[-1] - points.time_s[0])
    first_s, last_s = float(signals.time_s[0]), float(signals.time_s[-1])
    lowest = points.time_s[0] + _COVERED * length_s - last_s
    highest = points.time_s[0] + (1 - _COVERED) * length_s - first_s
    if highest <= lowest:
        raise DataError(
            f"the witness lasts {last_s - first_s:.4g} s and has to cover {100 * _COVERED:.0f} % of the run "
            f"of {length_s:.4g} s"
        )
    step_s = _SPACING * period_s
    tried = int((highest - lowest) / step_s) + 1
    if tried > _MOST_TRIED:
        raise DataError(
            f"the witness lasts {last_s - first_s:.4g} s, too long to search for its offset: state it to "
            f"{0.5 * _MOST_TRIED * step_s:.3g} s, or shorten the witness"
        )
    pair = [place(one, kind) for one in range(len(witness.names)) for kind in PAIR]
    signals = signals.only(pair)
    drive = known_drive(points, signals, averaged=averaged)
    model = model_of(points, pendulum, alone, drive)

    def explained(by_s: float) -> float:
        drive = known_drive(points, signals.delayed(by_s), averaged=averaged)
        if np.count_nonzero(drive.missing) > (1 - _COVERED) * len(drive.missing):
            return 0.0
        return _explained(model, alone, drive)

    coarse = lowest + step_s * np.arange(tried)
    best = float(coarse[int(np.argmax([explained(one) for one in coarse.tolist()]))])
    near = best + step_s * np.linspace(-1, 1, 17)
    return Offset(float(near[int(np.argmax([explained(one) for one in near.tolist()]))]), tried)


def _explained(model: ExactModel, alone: FitResult, drive: KnownDrive) -> float:
    """Fall of the squares of the residuals by the gains of a drive."""
    residuals, by_gains, by_law = residuals_with(model.with_drive(drive), alone)
    law = Factored(by_law)
    return float(np.sum((Factored(law.left(by_gains)).directions.T @ law.left(residuals)) ** 2))
