"""The program of the live fit: it follows the record of a run and writes parameters to its standard output.

It ends with the record, or with the process that writes the record.
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

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import SPOT, RecordedFittedPoint
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
from processing.swing import HalfCycle, HarmonicsMeasurement, TurningPoints, turning_points
from rig.analysis import (
    PassingDeflections,
    PlaneBalances,
    clock_rate_of,
    drag_of_fit,
    evidence_of,
    follow_plane,
    loss_of,
    stated_ambient,
)
from rig.instrument import pendulum_on_ball, recorded_configuration

FIRST_HALF_CYCLES = 40
"""Half-cycles before the first fit. With fewer, b and c are less than their u for every pair of the paper."""
_HALF_CYCLE_GROWTH = 1.04
"""Growth of the number of half-cycles from fit to fit; an uncertainty then falls by a tenth at most."""
_MAX_CORE_FRACTION = 0.02
"""Largest fraction of the time of a core that fits may take."""
_LOOK_INTERVAL_S = 0.5
_MAX_EARLY_NS = 120_000_000_000
"""Longest time span of deflections that are kept before the first half-cycle."""


def next_fit_half_cycles(half_cycles: int) -> int:
    """Number of half-cycles of the fit that follows a fit of `half_cycles`."""
    return max(half_cycles + 1, round(_HALF_CYCLE_GROWTH * half_cycles))


@dataclass(frozen=True, slots=True)
class Posterior:
    """Parameters fitted to the half-cycles so far."""

    half_cycles: int = 0
    """Number of unflagged half-cycles to which they were fitted."""
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    """Parameters by key; empty if no fit was possible."""
    points: Sequence[RecordedFittedPoint] = ()
    """Comparison of the measured half-cycles with the fit."""


_MAX_POINTS = 300
"""Largest number of points in a posterior: a chart has no pixels for more."""


def fitted_points(
    half_cycles: Sequence[HalfCycle], points: TurningPoints, fit: FitResult, pendulum: PendulumOnBall
) -> list[RecordedFittedPoint]:
    """Comparison of the exact fit with its data; `points` are the unflagged `half_cycles` in true time.

    The time of the fit itself is 0 until it is recorded.
    """
    times_ns = [half_cycle.turn_time_ns for half_cycle in half_cycles if not half_cycle.flags]
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time_s = turning_points_of(fit.parameters, pendulum, start, int(index[-1]))
    fitted, time_s = amplitude[index], time_s[index] + fit.estimate(TIME.key).value
    residual = (points.amplitude - fitted) / points.u_amplitude
    periods = full_periods(points)
    middle = periods.points
    period_s, period_residual = np.full((2, len(index)), np.nan)
    period_s[middle] = time_s[middle + 1] - time_s[middle - 1]
    period_residual[middle] = (periods.period_s - period_s[middle]) / periods.u_period_s
    # NaN where the fitted law says that friction stops the pendulum: there is no amplitude to compare
    comparable = np.flatnonzero(np.isfinite(residual))
    step = max(1, math.ceil(len(comparable) / _MAX_POINTS))
    table = np.column_stack((fitted, residual, period_s, period_residual)).tolist()
    return [RecordedFittedPoint(0, times_ns[k], *table[k]) for k in comparable[::step]]


MAX_SAMPLES = 1 << 22
"""Largest number of deflections that are kept, 160 MB: 2.3 hours of 500 frames/s."""
_EARLIER_HALF_CYCLES = 4
"""Half-cycles kept before the first one that is refined: neighbours are fitted together."""


class MeasuredRun:
    """All half-cycles of a run so far; fitted, refined and fitted again as the final analysis does.

    Once there are more than `max_samples` deflections, the older half of the half-cycles is not refined any
    more: the motion is then known from thousands of them.
    """

    def __init__(self, max_samples: int = MAX_SAMPLES, axes: Axes | None = None) -> None:
        self._max_samples = max_samples
        self._axes = axes
        self._plane_balances: PlaneBalances | None = None
        self._balances: list[Balance] = []
        self._fixed: list[HalfCycle] = []
        self._refinable: list[HalfCycle] = []
        self._blocks: list[Deflections] = []
        self._last_fit: FitResult | None = None

    @property
    def samples(self) -> int:
        """Number of deflections that are kept."""
        return sum(map(len, self._blocks))

    def take(self, half_cycles: Sequence[HalfCycle], deflections: Deflections) -> None:
        """Add the next half-cycles and deflections."""
        self._refinable += half_cycles
        if not len(deflections):
            return
        self._blocks.append(deflections)
        if self._plane_balances is None and len(self._refinable) > 1:
            self._plane_balances = PlaneBalances(self._axes, mean_period(turning_points(self._refinable)))
            for earlier in self._blocks[:-1]:
                self._balances += self._plane_balances.of(earlier)
        if self._plane_balances is not None:
            self._balances += self._plane_balances.of(deflections)

    def fitted(self, fit: DecayFit) -> tuple[Sequence[HalfCycle], FitResult]:
        """All half-cycles, refined, and the fit to them; raises DataError if there is no fit.

        If the plane of swing turns, the half-cycles are those of the motion in that plane.
        """
        half_cycles, blocks = self._half_cycles_in_plane()
        refined, self._last_fit = fitted_twice(half_cycles, blocks, fit, self._last_fit, self._fixed)
        if refined.exact is not None and self.samples > self._max_samples:
            self._fix_older_half(refined.half_cycles)
        return refined.half_cycles, with_discrepancy(
            LinearisedFit.of(fit.points(refined.half_cycles), fit.pendulum, self._last_fit)
        )

    def _half_cycles_in_plane(self) -> tuple[Sequence[HalfCycle], Iterable[Deflections]]:
        """The half-cycles that are still refined and their deflections, turned into the plane of swing."""
        whole = PassingDeflections(self._blocks, DeflectionUnit.RAD)
        plane = follow_plane([*self._fixed, *self._refinable], whole, self._axes, balances=self._balances)
        if plane.problem:
            raise DataError(plane.problem)
        if not plane.is_turned:
            return self._refinable, self._blocks
        # the plane's half-cycles are numbered from the first deflection kept
        first = self._refinable[0]
        nearest = min(plane.half_cycles, key=lambda h: abs(h.turn_time_ns - first.turn_time_ns))
        shift, indices = first.index - nearest.index, {h.index for h in self._refinable}
        numbered = [replace(h, index=h.index + shift) for h in plane.half_cycles if not h.flags]
        return [h for h in numbered if h.index in indices], plane.deflections

    def _fix_older_half(self, half_cycles: Sequence[HalfCycle]) -> None:
        half = len(self._refinable) // 2
        if half < _EARLIER_HALF_CYCLES:
            return
        from_ns = self._refinable[half - _EARLIER_HALF_CYCLES].turn_time_ns
        self._refinable = self._refinable[half:]
        first_index = self._refinable[0].index
        self._fixed = [half_cycle for half_cycle in half_cycles if half_cycle.index < first_index]
        self._blocks = [later for block in self._blocks if len(later := block.since(from_ns))]


class FollowedRun:
    """The unflagged half-cycles in the record of a run so far, and the fit to them.

    Raises RecordError if the record states no pendulum.
    """

    def __init__(self, reader: RecordReader) -> None:
        self._config = config = recorded_configuration(reader)
        pendulum = pendulum_on_ball(config)
        if pendulum is None:
            raise RecordError(f"{reader.path}: states no pendulum on a ball; nothing can be fitted")
        self._pendulum, self._clock_rate = pendulum, clock_rate_of(config)
        self._reader = reader
        self._run = MeasuredRun(axes=config.axes)
        self._waveform = HarmonicsMeasurement()
        self._half_cycles: list[HalfCycle] = []
        self._fitted_half_cycles = 0
        self._new_deflections: list[Deflections] = []

    @property
    def half_cycles(self) -> int:
        """Number of unflagged half-cycles so far."""
        return len(self._half_cycles)

    def read(self) -> None:
        """Read what was flushed since the last call."""
        for piece in self._reader.unread():
            half_cycles = self._reader.half_cycles(piece)
            deflections = self._reader.deflections(self._reader.table(SPOT.topic, piece))
            self._waveform.update(deflections)
            self._waveform.add(half_cycles)
            if len(deflections):
                self._new_deflections.append(deflections)
                if not self._half_cycles:
                    # the pendulum may not swing yet: only deflections that a first half-cycle needs are kept
                    early_ns = int(deflections.times_ns[-1]) - _MAX_EARLY_NS
                    while int(self._new_deflections[0].times_ns[-1]) < early_ns:
                        self._new_deflections.pop(0)
            self._half_cycles += [half_cycle for half_cycle in half_cycles if not half_cycle.flags]

    def fitted(self) -> Posterior:
        """The fit that the final analysis would make of these half-cycles; no estimates without a fit."""
        config, pendulum = self._config, self._pendulum
        new_half_cycles = self._half_cycles[self._fitted_half_cycles :]
        self._run.take(new_half_cycles, joined(self._new_deflections, DeflectionUnit.RAD))
        self._fitted_half_cycles, self._new_deflections = self.half_cycles, []
        with suppress(DataError):
            period_s = mean_period(points_in_true_time(self._half_cycles, self._clock_rate))
            drag, _ = drag_of_fit(config, stated_ambient(config), pendulum, period_s)
            evidence = evidence_of(drag, self._waveform.harmonics())
            decay_fit = DecayFit(
                pendulum, self._clock_rate, config.fit.fits_drag, evidence, loss_of(config.fit)
            )
            half_cycles, fit = self._run.fitted(decay_fit)
            points = fitted_points(half_cycles, decay_fit.points(half_cycles), fit, pendulum)
            estimates = {name: fit.estimate(name) for name in fit.contact_names}
            return Posterior(self.half_cycles, estimates, points)
        return Posterior(self.half_cycles)


def fits(reader: RecordReader, *, synchronous: bool) -> Iterator[Posterior]:
    """Yields the fits of a run while its record grows, whenever `next_fit_half_cycles` is reached.

    Fits take at most `_MAX_CORE_FRACTION` of the time. If `synchronous`, there is one fit for each line on
    the standard input, which says that the record was flushed.
    """
    run, is_warm, due_half_cycles, due_s = FollowedRun(reader), False, FIRST_HALF_CYCLES, 0.0
    flushes = (reader.update() for _ in sys.stdin.buffer)
    for _ in flushes if synchronous else reader.follow(_LOOK_INTERVAL_S):
        run.read()
        if not synchronous and (run.half_cycles < due_half_cycles or time.monotonic() < due_s):
            continue
        if not is_warm:
            # the first fit of a process loads its kernels, so its time does not show what a fit costs
            run.fitted()
            is_warm = True
        began_s = time.process_time()
        yield run.fitted()
        due_half_cycles = next_fit_half_cycles(run.half_cycles)
        due_s = time.monotonic() + (time.process_time() - began_s) / _MAX_CORE_FRACTION


def main() -> None:
    """Fit the run whose record is the first argument; a second argument means `synchronous`."""
    outgoing = os.fdopen(os.dup(1), "wb")
    # text that a library prints must not get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    # an OSError is the end of the process that reads the answers
    with suppress(OSError), RecordReader(Path(sys.argv[1])) as reader:
        for posterior in fits(reader, synchronous=len(sys.argv) > 2):
            pickle.dump(posterior, outgoing)
            outgoing.flush()
