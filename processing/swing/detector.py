"""Detection of the turning points of a decaying oscillation, with uncertainties, in a stream of samples."""

import math
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from processing.deflections import Deflections
from processing.swing.arc import HalfCycleSamples
from processing.swing.follower import OscillationFollower
from processing.swing.half_cycle_fit import HalfCycleFit
from processing.swing.judgement import holds_turning_point
from processing.swing.modes import separate_modes
from processing.swing.onset import FirstHalfCycle, Onset, OnsetSearch
from processing.swing.prediction import KnownMotion
from processing.swing.sample_buffer import SampleBuffer
from processing.swing.turning_point import HalfCycle, HalfCycleFlag
from processing.units import nanoseconds, seconds

_MAX_TIME_ERROR_HALF_PERIODS = 0.05
"""Largest deviation of a turning point after a disturbance at which the motion counts as the same, without a
new release."""
_MAX_AMPLITUDE_RATIO = 1.02
"""Largest ratio of the amplitudes after and before a disturbance at which the motion counts as the same."""
_MIN_AMPLITUDE_RATIO = 0.8
"""Smallest such ratio of each half period."""


class TurningPointDetector:
    """Measurement of every half-cycle of a decaying oscillation while the samples arrive.

    Period, centre, damping, dry friction, anharmonic stiffness, a drift of the rest position and a second,
    faster mode are estimated in the course of the record by a Kalman filter with one step per half-cycle.
    The amplitude and time of each turning point are fitted to the samples of its own half-cycle only, from
    zero crossing to zero crossing; the other parameters come mainly from the half-cycles before. Errors of
    neighbouring half-cycles are therefore nearly independent. Errors of friction and stiffness shift the
    times of many half-cycles in common, by less than their uncertainties; a `known` motion has no such shifts
    (see `processing.fit.refinement`).

    The first four half-cycles are returned together, each later one with the first sample after its end.

    `HalfCycle.index` counts half periods and continues through a release or a kick. Half-cycles with too few
    samples are missing, doubtful ones are flagged (`HalfCycleFlag`). After three disturbed half-cycles in a
    row a new search for the oscillation starts at the first of them.

    The result does not depend on how the samples are divided into blocks. Memory is bounded.

    Parameters
    ----------
    known
        Frequency and shape of the motion, if they are known from a fit; they are then not estimated.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = np.arange(0.0, 60.0, 0.01)
    >>> deflection = 300.0 * np.exp(-0.002 * time_s) * np.cos(1.5 * time_s)
    >>> detector = TurningPointDetector()
    >>> half_cycles = detector.update((time_s * 1e9).astype(np.int64), deflection, np.full(6000, 0.02))
    >>> half_cycles += detector.finish()
    >>> len(half_cycles)
    28
    """

    def __init__(self, known: KnownMotion | None = None) -> None:
        self._samples = SampleBuffer()
        self._known = known
        self._search: OnsetSearch | None = OnsetSearch(self._samples, 0, known=known)
        self._follower: OscillationFollower | None = None
        self._previous_follower: OscillationFollower | None = None
        self._half_period_s = math.nan
        self._last: HalfCycle | None = None
        self._last_unflagged: HalfCycle | None = None
        self._last_before_loss: HalfCycle | None = None

    def update(self, times_ns: ArrayLike, deflection: ArrayLike, u_deflection: ArrayLike) -> list[HalfCycle]:
        """Add samples and return the half-cycles that they complete.

        Parameters
        ----------
        times_ns : (n,) int64, ns, not decreasing, also from one block to the next
        deflection : (n,) any unit; NaN where the spot was lost
        u_deflection : (n,) standard uncertainties, same unit, positive where the deflection is not NaN

        Raises
        ------
        DataError
            Lengths differ, times decrease, or an uncertainty is not positive. Nothing of the block is
            added then.
        """
        self._samples.append(times_ns, deflection, u_deflection)
        return self._process(final=False)

    def finish(self) -> list[HalfCycle]:
        """Return the remaining half-cycles, also one that the record's end cuts after its turning point."""
        return self._process(final=True)

    def _process(self, final: bool) -> list[HalfCycle]:
        half_cycles: list[HalfCycle] = []
        while True:
            if self._search is not None:
                onset = self._search.advance(final)
                if onset is None:
                    return half_cycles
                self._begin(onset, half_cycles)
            elif self._follower is None or not self._follow(self._follower, half_cycles, final):
                return half_cycles

    def _begin(self, onset: Onset, half_cycles: list[HalfCycle]) -> None:
        """Report the half-cycles of a new oscillation and start following it."""
        if math.isnan(self._half_period_s):
            self._half_period_s = onset.half_period_s
        index = 0
        for k, first in enumerate(onset.first_half_cycles):
            if k:
                index += 1
            elif self._last is not None:
                # the nearest number of half periods, odd if and only if the sides differ
                time_s = seconds(first.half.reference_ns - self._last.turn_time_ns)
                odd = int(first.half.side != self._last.side)
                index = self._last.index + 2 * round((time_s / self._half_period_s - odd) / 2) + odd
            if not first.result.valid or (self._last is not None and index <= self._last.index):
                continue
            flags = first.flags
            if self._last_before_loss is not None:
                flags |= self._start_flag(self._last_before_loss, first)
                self._last_before_loss = None
            half_cycles.append(self._half_cycle(index, first.half, first.result, flags))
        self._search = None
        self._follower = OscillationFollower(onset, index, self._previous_follower)
        self._samples.forget_before(self._samples.position(self._follower.start_ns))

    def _start_flag(self, last: HalfCycle, first: FirstHalfCycle) -> HalfCycleFlag:
        """START if the motion after a disturbance is another: not a whole number of half periods, of the
        right parity, after the `last` unflagged turning point, or of an amplitude that no decay has."""
        time_s = seconds(first.half.reference_ns - last.turn_time_ns) + first.result.time_s
        half_periods = time_s / self._half_period_s
        time_error = abs(math.remainder(half_periods - int(first.half.side != last.side), 2.0))
        has_grown = first.result.amplitude > last.amplitude * _MAX_AMPLITUDE_RATIO
        min_amplitude = last.amplitude * _MIN_AMPLITUDE_RATIO ** max(half_periods, 1.0)
        differs = time_error > _MAX_TIME_ERROR_HALF_PERIODS or has_grown
        return HalfCycleFlag.START if differs or first.result.amplitude < min_amplitude else HalfCycleFlag(0)

    def _follow(self, follower: OscillationFollower, half_cycles: list[HalfCycle], final: bool) -> bool:
        """Measure the present half-cycle if all its samples have arrived; False if not."""
        if self._samples.last_ns < (follower.start_ns if final else follower.end_ns):
            return False
        index, end_ns = follower.index, follower.end_ns
        half = self._samples.between(follower.reference_ns, follower.side, follower.start_ns, end_ns)
        self._half_period_s = follower.half_period_s
        result, flags = follower.take(half)
        if holds_turning_point(result, half):
            half_cycles.append(self._half_cycle(index, half, result, flags))
        if follower.lost:
            position = self._samples.position(follower.first_miss_ns if follower.misses else end_ns)
            if follower.misses:
                self._last_before_loss = self._last_unflagged
            self._follower = None
            self._search = OnsetSearch(
                self._samples, position, self._half_period_s, half.reference_ns, self._known,
                follower.noise.level.effective,
            )  # fmt: skip
            self._previous_follower = follower
        elif not follower.misses:
            self._samples.forget_before(self._samples.position(end_ns))
        return True

    def _half_cycle(
        self, index: int, half: HalfCycleSamples, result: HalfCycleFit, flags: HalfCycleFlag
    ) -> HalfCycle:
        self._last = HalfCycle(
            index=index,
            turn_time_ns=half.reference_ns + nanoseconds(result.time_s),
            u_turn_time_s=float(result.u_time_s),
            amplitude=float(result.amplitude),
            u_amplitude=float(result.u_amplitude),
            half_period_s=math.nan,
            u_half_period_s=math.nan,
            centre=float(result.centre),
            side=half.side,
            flags=int(flags),
        ).since(self._last)
        if not flags:
            self._last_unflagged = self._last
        return self._last


def half_cycles_of(times_ns: ArrayLike, deflection: ArrayLike, u_deflection: ArrayLike) -> list[HalfCycle]:
    """All half-cycles of samples in memory; arguments and errors as of `TurningPointDetector.update`."""
    detector = TurningPointDetector()
    return detector.update(times_ns, deflection, u_deflection) + detector.finish()


def half_cycles_of_blocks(blocks: Iterable[Deflections], known: KnownMotion | None = None) -> list[HalfCycle]:
    """All half-cycles of deflections along the slow axis, in blocks that need not be in memory together."""
    detector = TurningPointDetector(known)
    half_cycles: list[HalfCycle] = []
    for block in blocks:
        half_cycles += detector.update(block.times_ns, block.y, block.u_y)
    return half_cycles + detector.finish()


@cache
def compile_kernels() -> None:
    """Run every compiled kernel of this package once, so that numba compiles it or loads it from its cache.

    The first call takes about 10 s after an installation and a few tenths of a second later; further calls do
    nothing. Compilation during the first half-cycle of a measurement would block the processing of samples.
    """
    time_s = np.arange(0.0, 60.0, 0.05)
    phase = 1.5 * time_s
    # dry friction: in each half-cycle the motion is a cosine about a displaced centre, so that the amplitude
    # falls by a constant step; this makes the detector use the anharmonic terms as well
    halves = np.floor(phase / np.pi)
    centre = 0.01 * np.where(halves % 2 == 0, -1.0, 1.0)
    deflection = (0.99 - 0.02 * halves) * np.cos(phase) + centre
    times_ns = nanoseconds(time_s)
    u = np.full(len(time_s), 1e-5)
    half_cycles_of(times_ns, deflection, u)
    separate_modes(times_ns[:200], 0.1 * np.cos(5.0 * phase[:200]), deflection[:200], u[:200], u[:200])
