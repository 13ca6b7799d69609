"""The process that fits: it follows the record of a run, and parameters go out on its standard output.

It ends with the record, or with the process that writes that.
"""

import math
import os
import pickle
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import REFERENCE, SPOT, SWING, RecordedFittedPoint
from calibration import Axes
from processing.balance import Balance
from processing.contact import AMPLITUDE, TIME, PendulumOnBall, turning_points_of
from processing.decay_summary import full_periods, mean_period
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import DataError, RecordError
from processing.estimate import Estimate
from processing.fit import (
    DecayFit,
    FitResult,
    LinearisedFit,
    fitted_twice,
    points_in_true_time,
    with_discrepancy,
)
from processing.spot import Spot
from processing.swing import HalfCycle, HarmonicsWatch, TurningPoints, turning_points
from rig.analysis import (
    PassingDeflections,
    PlaneBalances,
    clock_rate_of,
    evidence_of,
    follow_plane,
    known_drag,
    loss_of,
    stated_surroundings,
)
from rig.instrument import (
    BeamCorrection,
    Block,
    frame_shape,
    optics_of,
    pendulum_on_ball,
    recorded_configuration,
)
from rig.settings import Configuration

FIRST_HALF_CYCLES = 40
"""Fewer determine nothing: u of b and c is then larger than their values for every pair of the paper."""
_GROWTH = 1.04
"""So many times more half-cycles are worth another fit: u falls by a tenth where it falls fastest."""
_SHARE = 0.02
"""Largest part of a core that fits may have."""
_LOOK_S = 0.5
_EARLY_NS = 120_000_000_000
"""Deflections that are kept until the first half-cycles are found in them."""


def following(half_cycles: int) -> int:
    """How many half-cycles are worth a fit after one of so many."""
    return max(half_cycles + 1, round(_GROWTH * half_cycles))


@dataclass(frozen=True, slots=True)
class Posterior:
    """Parameters by key, from the first `half_cycles` unflagged ones of a run; none where they have no fit.

    `points` are these beside the fit.
    """

    half_cycles: int = 0
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    points: Sequence[RecordedFittedPoint] = ()


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

    def fitted(self, fit: DecayFit) -> tuple[Sequence[HalfCycle], FitResult]:
        """All of them as they stand, and the fit to them; raises DataError where there is none.

        Where the plane of swing turns, they are those in it.
        """
        swings, blocks = self._in_plane()
        found, self._near = fitted_twice(swings, blocks, fit, self._near, self._stand)
        if found.exact is not None and self.samples > self._most:
            self._let_go(found.swings)
        return found.swings, with_discrepancy(
            LinearisedFit.of(fit.points(found.swings), fit.pendulum, self._near)
        )

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


class FollowedMotion:
    """Deflections and half-cycles as a record tells them, in rad.

    The beam's motion is subtracted where the record has a reference spot, as it is from what a run shows.
    """

    def __init__(self, reader: RecordReader, config: Configuration) -> None:
        self._reader = reader
        optics = optics_of(config, reader.full_scale_dn)
        self._less: BeamCorrection | None = None
        if optics.reference_gain is not None:
            deflector = optics.deflector(frame_shape(reader))
            self._less = BeamCorrection(deflector, optics.reference_gain, beside=False)
        # of frames whose other spot was not flushed with them
        self._spots, self._references = (reader.rows(kind.topic, ()) for kind in (SPOT, REFERENCE))

    def unread(self) -> Iterator[tuple[Sequence[HalfCycle], Deflections]]:
        """What was flushed since the last call, piece by piece: half-cycles, and deflections up to them."""
        for piece in self._reader.unread():
            spots = self._reader.rows(SPOT.topic, piece.get(SPOT.topic, ()))
            if self._less is None:
                swings = self._reader.swings(piece.get(SWING.topic, ()))
                yield swings, self._reader.deflections(spots)
            else:
                yield self._corrected(self._less, spots, piece)

    def _corrected(
        self, less: BeamCorrection, spots: NDArray[Any], piece: Piece
    ) -> tuple[Sequence[HalfCycle], Deflections]:
        new = self._reader.rows(REFERENCE.topic, piece.get(REFERENCE.topic, ()))
        spots, references = np.append(self._spots, spots), np.append(self._references, new)
        both = min(len(spots), len(references))
        self._spots, self._references = spots[both:], references[both:]
        deflections = self._reader.deflections(spots[:both])
        block = Block(_places(spots[:both]), deflections, [], [], _places(references[:both]))
        shown = less.shown(deflections.times_ns.tolist(), block)
        return shown.swings, shown.deflections


def _places(rows: NDArray[Any]) -> list[Spot]:
    """Spots of which place and flags are known, from rows of either topic of spots."""
    unknown = [math.nan] * (len(Spot._fields) - 5)
    names = [*Spot._fields[:4], "flags"]
    return [Spot._make((*place, *unknown, flags)) for *place, flags in rows[names].tolist()]


class FollowedRun:
    """The unflagged half-cycles that the record of a run tells so far, and the fit to them.

    Raises RecordError if the record states no pendulum.
    """

    def __init__(self, reader: RecordReader) -> None:
        self._config = config = recorded_configuration(reader)
        pendulum = pendulum_on_ball(config)
        if pendulum is None:
            raise RecordError(f"{reader.path}: states no pendulum on a ball; nothing can be fitted")
        self._pendulum, self._clock_rate = pendulum, clock_rate_of(config)
        self._motion = FollowedMotion(reader, config)
        self._run = MeasuredRun(axes=config.axes)
        self._waveform = HarmonicsWatch()
        self._swings: list[HalfCycle] = []
        self._taken = 0
        self._untaken: list[Deflections] = []

    @property
    def half_cycles(self) -> int:
        """Unflagged ones so far."""
        return len(self._swings)

    def read(self) -> None:
        """Read what was flushed since the last call."""
        for swings, deflections in self._motion.unread():
            self._waveform.update(deflections)
            self._waveform.add(swings)
            if len(deflections):
                self._untaken.append(deflections)
                if not self._swings:
                    # where nothing swings, what half-cycles may need that are found late
                    early_ns = int(deflections.times_ns[-1]) - _EARLY_NS
                    while int(self._untaken[0].times_ns[-1]) < early_ns:
                        self._untaken.pop(0)
            self._swings += [swing for swing in swings if not swing.flags]

    def fitted(self) -> Posterior:
        """The fit as the final analysis of these half-cycles makes it; without estimates where none is."""
        config, pendulum = self._config, self._pendulum
        self._run.take(self._swings[self._taken :], joined(self._untaken, DeflectionUnit.RAD))
        self._taken, self._untaken = len(self._swings), []
        with suppress(DataError):
            period_s = mean_period(points_in_true_time(self._swings, self._clock_rate))
            drag, _ = known_drag(config, stated_surroundings(config), pendulum, period_s)
            evidence = evidence_of(drag, self._waveform.found())
            how = DecayFit(pendulum, self._clock_rate, config.fit.fits_drag, evidence, loss_of(config.fit))
            swings, fit = self._run.fitted(how)
            points = fitted_points(swings, how.points(swings), fit, pendulum)
            return Posterior(self._taken, {name: fit.estimate(name) for name in fit.contact_names}, points)
        return Posterior(self._taken)


def fits(reader: RecordReader, *, in_step: bool) -> Iterator[Posterior]:
    """Fits of a run while its record grows: each time that they are worth it, at most in 2 % of the time.

    `in_step`: one for each line on the standard input, which says that the record was flushed.
    """
    run, warm, due_half_cycles, due_s = FollowedRun(reader), False, FIRST_HALF_CYCLES, 0.0
    for _ in _flushed(reader) if in_step else reader.follow(_LOOK_S):
        run.read()
        if not in_step and (run.half_cycles < due_half_cycles or time.monotonic() < due_s):
            continue
        if not warm:
            # the first fit of a process loads its kernels, which says nothing of what a fit costs
            run.fitted()
            warm = True
        began_s = time.process_time()
        yield run.fitted()
        due_half_cycles = following(run.half_cycles)
        due_s = time.monotonic() + (time.process_time() - began_s) / _SHARE


def _flushed(reader: RecordReader) -> Iterator[None]:
    for _ in sys.stdin.buffer:
        reader.update()
        yield None


def main() -> None:
    """Fit the run whose record is the first argument; a second argument means `in_step`."""
    outgoing = os.fdopen(os.dup(1), "wb")
    # nothing that a library prints may get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    # the end of who reads the answers
    with suppress(OSError), RecordReader(Path(sys.argv[1])) as reader:
        for found in fits(reader, in_step=len(sys.argv) > 2):
            pickle.dump(found, outgoing)
            outgoing.flush()
