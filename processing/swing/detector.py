"""Swing detector: samples of a decaying oscillation in, turning points with uncertainties out."""

import math

from numpy.typing import ArrayLike

from processing.swing.follower import Follower
from processing.swing.half_cycle_fit import HalfCycleFit
from processing.swing.judgement import turned
from processing.swing.known_motion import KnownMotion
from processing.swing.onset import FirstHalfCycle, Onset, OnsetSearch
from processing.swing.sample_buffer import SampleBuffer
from processing.swing.swing import Swing, SwingFlag

_OFF = 0.05
"""Half periods by which a turning point may be off after a disturbance, the motion being the same ..."""

_GROWN, _SHRUNK = 1.02, 0.8
"""... and the amplitude's part of the one before it, the smaller limit for every half period between."""


class SwingDetector:
    """Finds every half-cycle of a decaying oscillation as the samples come in.

    Period, centre, damping, dry friction and anharmonic elasticity, a drift of the rest position
    and a second, faster mode are learned as it runs. Each turning point is fitted to the samples of
    its own half-cycle, from zero crossing to zero crossing; what several cycles share comes from the
    others. Errors of neighbouring half-cycles are therefore nearly independent; what those before them
    got wrong about friction and stiffness shifts times of many together, though, by less than their
    uncertainties. A motion that is `known` has no such shifts (see `processing.fit.remeasure`). The first
    four half-cycles come together, each later one with the first sample after its end.

    A release or kick begins a new count only in time: `Swing.index` goes on in half periods. Half-cycles
    without enough samples are missing, doubtful ones flagged (`SwingFlag`). After three disturbed
    half-cycles in a row the oscillation is looked for anew, from the first of them on.

    The swings do not depend on how the samples are cut into blocks. Memory is bounded.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = np.arange(0.0, 60.0, 0.01)
    >>> deflection = 300.0 * np.exp(-0.002 * time_s) * np.cos(1.5 * time_s)
    >>> detector = SwingDetector()
    >>> swings = detector.update((time_s * 1e9).astype(np.int64), deflection, np.full(6000, 0.02))
    >>> swings += detector.finish()
    >>> len(swings)
    28
    """

    def __init__(self, known: KnownMotion | None = None) -> None:
        self._samples = SampleBuffer()
        self._known = known
        self._search: OnsetSearch | None = OnsetSearch(self._samples, 0, known=known)
        self._follower: Follower | None = None
        self._half_period_s = math.nan
        self._last: Swing | None = None
        self._last_good: Swing | None = None
        self._broken_off: Swing | None = None

    def update(self, times_ns: ArrayLike, deflection: ArrayLike, u_deflection: ArrayLike) -> list[Swing]:
        """Take in samples and return the half-cycles that they complete.

        Parameters
        ----------
        times_ns : (n,) int64, ns, never running backwards, from block to block either
        deflection : (n,) any unit; NaN where the spot was lost
        u_deflection : (n,) standard uncertainty of each, same unit, positive where there is a deflection

        Raises
        ------
        DataError
            Lengths differ, times run backwards, or an uncertainty is not positive. Nothing of the
            block has been taken in then.
        """
        self._samples.append(times_ns, deflection, u_deflection)
        return self._process(final=False)

    def finish(self) -> list[Swing]:
        """End of the samples: return what the last, unfinished half-cycle still carries."""
        return self._process(final=True)

    def _process(self, final: bool) -> list[Swing]:
        swings: list[Swing] = []
        while True:
            if self._search is not None:
                onset = self._search.advance(final)
                if onset is None:
                    return swings
                self._begin(onset, swings)
            elif self._follower is None or not self._follow(self._follower, swings, final):
                return swings

    def _begin(self, onset: Onset, swings: list[Swing]) -> None:
        """Report the half-cycles of an onset and follow it from there."""
        if math.isnan(self._half_period_s):
            self._half_period_s = onset.half_period_s
        index = 0
        for k, first in enumerate(onset.measured):
            if k:
                index += 1
            elif self._last is not None:
                index = self._index_after(self._last, first.half.reference_ns, first.half.side)
            if not first.result.valid or (self._last is not None and index <= self._last.index):
                continue
            flags = first.flags
            if self._broken_off is not None:
                flags |= self._continuation(self._broken_off, first)
                self._broken_off = None
            self._emit(index, first.half.reference_ns, first.half.side, first.result, flags, swings)
        self._search = None
        self._follower = Follower(onset, index)
        self._samples.forget_before(self._samples.position(self._follower.start_ns))

    def _continuation(self, before: Swing, first: FirstHalfCycle) -> SwingFlag:
        """START where the motion after a disturbance is another one than before it."""
        time_s = (first.half.reference_ns - before.turn_time_ns) * 1e-9 + first.result.time_s
        halves = time_s / self._half_period_s
        off = abs(math.remainder(halves - int(first.half.side != before.side), 2.0))
        grown = first.result.amplitude > before.amplitude * _GROWN
        shrunk = first.result.amplitude < before.amplitude * _SHRUNK ** max(halves, 1.0)
        return SwingFlag.START if off > _OFF or grown or shrunk else SwingFlag(0)

    def _index_after(self, last: Swing, time_ns: int, side: int) -> int:
        """Index of a half-cycle after a break: half periods since the last, odd where the sides differ."""
        halves = (time_ns - last.turn_time_ns) * 1e-9 / self._half_period_s
        odd = int(side != last.side)
        return last.index + 2 * round((halves - odd) / 2) + odd

    def _follow(self, follower: Follower, swings: list[Swing], final: bool) -> bool:
        """Take the present half-cycle if its samples are complete; False when there is nothing to do."""
        if self._samples.last_ns < (follower.start_ns if final else follower.end_ns):
            return False
        index, reference_ns, side = follower.index, follower.reference_ns, follower.side
        half = self._samples.between(reference_ns, side, follower.start_ns, follower.end_ns)
        end_ns = follower.end_ns
        self._half_period_s = follower.half_period_s
        result, flags = follower.take(half)
        if turned(result, half):
            self._emit(index, reference_ns, side, result, flags, swings)
        if follower.lost:
            position = self._samples.position(follower.first_miss_ns if follower.misses else end_ns)
            if follower.misses:
                self._broken_off = self._last_good
            self._follower = None
            self._search = OnsetSearch(
                self._samples, position, self._half_period_s, half.reference_ns, self._known
            )
        elif not follower.misses:
            self._samples.forget_before(self._samples.position(end_ns))
        return True

    def _emit(
        self,
        index: int,
        reference_ns: int,
        side: int,
        result: HalfCycleFit,
        flags: SwingFlag,
        swings: list[Swing],
    ) -> None:
        turn_ns = reference_ns + round(result.time_s * 1e9)
        half_period, u_half_period = math.nan, math.nan
        if self._last is not None and self._last.index == index - 1:
            half_period = (turn_ns - self._last.turn_time_ns) * 1e-9
            u_half_period = math.hypot(result.u_time_s, self._last.u_turn_time_s)
        self._last = Swing(
            index=index,
            turn_time_ns=turn_ns,
            u_turn_time_s=float(result.u_time_s),
            amplitude=float(result.amplitude),
            u_amplitude=float(result.u_amplitude),
            half_period_s=half_period,
            u_half_period_s=u_half_period,
            centre=float(result.centre),
            side=side,
            flags=int(flags),
        )
        if not flags:
            self._last_good = self._last
        swings.append(self._last)
