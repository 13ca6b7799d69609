"""The process that fits: half-cycles come in on its standard input, parameters go out on its output.

Messages are pickled. It ends when its input does, and thus with the process that started it.
"""

import os
import pickle
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from acquisition.record.topics import RecordedFittedPoint
from calibration import Axes
from processing.balance import Balance
from processing.contact import AMPLITUDE, TIME, PendulumOnBall, turning_points_of
from processing.decay_summary import full_periods, mean_period
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import (
    NO_EVIDENCE,
    Evidence,
    FitOfSwings,
    FitResult,
    LinearisedFit,
    fitted_twice,
    with_misfit,
)
from processing.least_squares import Loss
from processing.swing import HalfCycle, TurningPoints, turning_points
from rig.analysis import PassingDeflections, PlaneBalances, follow_plane


class FittedModel(NamedTuple):
    """The exact fit as the final analysis makes it.

    `clock_rate` is how many true seconds pass in one of the swings' clock, `axes` are the pendulum's.
    """

    pendulum: PendulumOnBall
    drag: bool = True
    loss: Loss = "linear"
    clock_rate: float = 1.0
    axes: Axes | None = None


class PosteriorInput(NamedTuple):
    """What has come since the last message: half-cycles without a flag, and the deflections, in rad.

    All of the same `run`, which are `half_cycles`, are fitted, restrained by the `evidence`.
    """

    run: int
    half_cycles: int
    swings: Sequence[HalfCycle]
    deflections: Deflections
    evidence: Evidence = NO_EVIDENCE


@dataclass(frozen=True, slots=True)
class Posterior:
    """Parameters by key, from the first `half_cycles` unflagged ones of a run; none before the first fit.

    `points` are these beside the fit.
    """

    half_cycles: int = 0
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    points: Sequence[RecordedFittedPoint] = ()


class Answer(NamedTuple):
    """A fit, without estimates where there is none, and the processor time that it took."""

    fit: Posterior
    cpu_s: float


_MOST = 300
"""Half-cycles that are told: more than a chart has pixels for are no news."""


def fitted_points(
    swings: Sequence[HalfCycle], points: TurningPoints, fit: FitResult, pendulum: PendulumOnBall
) -> list[RecordedFittedPoint]:
    """The exact fit beside its data: `points` are the unflagged `swings` in true time.

    Times of the fit are 0.
    """
    times_ns = [swing.turn_time_ns for swing in swings if not swing.flags]
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time_s = turning_points_of(fit.parameters, pendulum, start, int(index[-1]))
    fitted, time_s = amplitude[index], time_s[index] + fit.estimate(TIME.key).value
    left = (points.amplitude - fitted) / points.u_amplitude
    periods = full_periods(points)
    at = periods.where
    period_s, left_of_period = np.full((2, len(index)), np.nan)
    period_s[at] = time_s[at + 1] - time_s[at - 1]
    left_of_period[at] = (periods.period_s - period_s[at]) / periods.u_period_s
    # where the law says that friction holds it, it says nothing of the motion
    known = np.flatnonzero(np.isfinite(left))
    table = np.column_stack((fitted, left, period_s, left_of_period)).tolist()
    return [RecordedFittedPoint(0, times_ns[k], *table[k]) for k in known[:: -(-len(known) // _MOST) or 1]]


MOST_SAMPLES = 1 << 22
"""Deflections that are kept, 160 MB: 2.3 hours of 500 frames/s."""
_BEFORE = 4
"""Half-cycles before the first one of which deflections are kept: so many are found together."""


class MeasuredRun:
    """All half-cycles so far; fitted, measured again and fitted as the final analysis does.

    Where there would be more than `most` deflections, the older half of the half-cycles stays as measured
    last: the motion is then known from thousands of them.
    """

    def __init__(self, most: int = MOST_SAMPLES, axes: Axes | None = None) -> None:
        self._most = most
        self._axes = axes
        self._making: PlaneBalances | None = None
        self._balances: list[Balance] = []
        self._stand: list[HalfCycle] = []
        self._open: list[HalfCycle] = []
        self._blocks: list[Deflections] = []
        self._near: FitResult | None = None

    @property
    def samples(self) -> int:
        """Deflections that are kept."""
        return sum(map(len, self._blocks))

    def take(self, swings: Sequence[HalfCycle], deflections: Deflections) -> None:
        """Half-cycles and deflections that follow."""
        self._open += swings
        if not len(deflections):
            return
        self._blocks.append(deflections)
        if self._making is None and len(self._open) > 1:
            self._making = PlaneBalances(self._axes, mean_period(turning_points(self._open)))
            self._balances = [one for block in self._blocks[:-1] for one in self._making.of(block)]
        if self._making is not None:
            self._balances += self._making.of(deflections)

    def fitted(self, fit: FitOfSwings) -> tuple[Sequence[HalfCycle], FitResult]:
        """All of them as they stand, and the fit to them; raises DataError where there is none.

        Where the plane of swing turns, they are those in it.
        """
        swings, blocks = self._in_plane()
        found, self._near = fitted_twice(swings, blocks, fit, self._near, self._stand)
        if found.exact is not None and self.samples > self._most:
            self._let_go(found.swings)
        return found.swings, with_misfit(LinearisedFit.of(fit.points(found.swings), fit.pendulum, self._near))

    def _in_plane(self) -> tuple[Sequence[HalfCycle], Iterable[Deflections]]:
        """The half-cycles that do not stand yet and their deflections, turned into the plane of swing."""
        whole = PassingDeflections(self._blocks, DeflectionUnit.RAD)
        plane = follow_plane([*self._stand, *self._open], whole, self._axes, balances=self._balances)
        if plane.problem:
            raise DataError(plane.problem)
        if not plane.is_turned:
            return self._open, self._blocks
        # numbered from where the deflections begin
        first = self._open[0]
        nearest = min(plane.swings, key=lambda one: abs(one.turn_time_ns - first.turn_time_ns))
        known, shift = {one.index for one in self._open}, first.index - nearest.index
        numbered = [replace(one, index=one.index + shift) for one in plane.swings if not one.flags]
        return [one for one in numbered if one.index in known], plane.deflections

    def _let_go(self, swings: Sequence[HalfCycle]) -> None:
        half = len(self._open) // 2
        if half < _BEFORE:
            return
        from_ns = self._open[half - _BEFORE].turn_time_ns
        self._open = self._open[half:]
        self._stand = [one for one in swings if one.index < self._open[0].index]
        self._blocks = [kept for block in self._blocks if len(kept := block.since(from_ns))]


def main() -> None:
    """Fit until the input ends."""
    incoming, outgoing = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # nothing that a library prints may get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    of_run, run = -1, MeasuredRun()
    warm = False
    # the end of the input, or of who reads the answers
    with suppress(EOFError, OSError):
        model: FittedModel = pickle.load(incoming)
        while True:
            asked: PosteriorInput = pickle.load(incoming)
            if asked.run != of_run:
                of_run, run = asked.run, MeasuredRun(axes=model.axes)
            run.take(asked.swings, asked.deflections)
            if not warm:
                # the first fit of a process loads its kernels, which says nothing of what a fit costs
                _fitted(run, asked, model)
                warm = True
            pickle.dump(_fitted(run, asked, model), outgoing)
            outgoing.flush()


def _fitted(run: MeasuredRun, asked: PosteriorInput, model: FittedModel) -> Answer:
    began_s, found = time.process_time(), Posterior()
    how = FitOfSwings(model.pendulum, model.clock_rate, model.drag, asked.evidence, model.loss)
    with suppress(DataError):
        swings, fit = run.fitted(how)
        points = fitted_points(swings, how.points(swings), fit, model.pendulum)
        found = Posterior(asked.half_cycles, {name: fit.estimate(name) for name in fit.contact_names}, points)
    return Answer(found, time.process_time() - began_s)
