"""When a witness saw what moved the pendulum: an unknown offset of its clock, a delay and a drift."""

from typing import NamedTuple

import numpy as np

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.exact_model import ExactModel
from processing.fit.known_drive import KnownDrive, known_drive
from processing.fit.result import FitResult
from processing.fit.witness.signals import PAIR, Witness, signals_of
from processing.fit.witness.terms import (
    Drives,
    Terms,
    law_free,
    model_of,
    place,
    residuals_with,
    started,
)
from processing.periods import mean_period
from processing.swing import TurningPoints

_SHIFT = 0.02
"""Shift of the signals, in periods, for the derivative by their time."""
_SPACING = 1 / 8
"""Of offsets that are tried, in periods: gain and quadrature take up what is between."""
_MOST_TRIED = 20_000
_COVERED = 0.6
"""Share of the half-swings that a witness has to cover at an offset that is tried."""


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
    left, of = law_free(residuals, by_gains, np.column_stack([by_law, by_gains[:, :-2]]))
    of = of[:, -2:]
    size = np.linalg.norm(of, axis=0)
    if not np.all(size > 0.0):
        nothing = Estimate(0.0, np.inf)
        return Clock(nothing, nothing)
    inverse = np.linalg.inv((of / size).T @ (of / size)) / np.outer(size, size)
    value = -inverse @ (of.T @ left)
    u = np.sqrt(np.diag(inverse) * max(1.0, float(left @ left) / fit.dof))
    return Clock(*(Estimate(float(a), float(b)) for a, b in zip(value, u, strict=True)))


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
    left, of = law_free(residuals, by_gains, by_law)
    return float(np.sum((of @ np.linalg.lstsq(of, left, rcond=1e-10)[0]) ** 2))
