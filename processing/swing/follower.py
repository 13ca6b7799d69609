"""Follows one oscillation from half-cycle to half-cycle."""

import math
from collections import deque

import numpy as np

from processing.swing.arc import Arc, HalfCycleSamples, state_on_arc
from processing.swing.half_cycle import AMPLITUDE, CENTRE, DRIFT, RATE, SHAPE, TIME, Matrix
from processing.swing.half_cycle_fit import HalfCycleFit, excess, fit_half_cycle
from processing.swing.judgement import judge
from processing.swing.onset import Onset
from processing.swing.prediction import SLOPE_WANDER, predict
from processing.swing.swing import SwingFlag
from processing.swing.term_selection import extend
from processing.swing.waveform import DAMPING, RISE

_NOISE_MEMORY = 15
"""Half-cycles whose median chi-square says how far the samples' uncertainties are believed."""

_REFITS = (8, 16, 32, 64)
_LINEAR_REFITS = (6, 8, 10, 12, 16, 24, 32, 64)
_ANCHORS = (128, 256, 512, 1024)
"""Half-cycles after which the whole arc so far is fitted anew, or just expanded about a new state."""

_JUMP = 100.0
"""Chi-square (two degrees) of a half-cycle against its prediction that speaks of a kick."""

_SURPRISED = 3.0
_CALM = 100.0
_RESTLESS_AT_FIRST = 30.0
_WITHIN = 0.15
"""Part of the wandering from one half-cycle to the next that falls on a turning point within one."""
_ARC_EXCESS = 4.0
"""Deviations of chi-square up to which a long arc without any wandering is believed."""
_MOST_RESTLESS = 1e12
_SETTLED = 8
_PATIENCE = 3
"""Disturbed half-cycles in a row after which the oscillation counts as lost."""

_RUNAWAY = 10.0
_BLUR = 0.1
"""Uncertainty of the next turning point, in half periods, at which it counts as lost."""


class Follower:
    """State of the oscillation, carried from half-cycle to half-cycle."""

    def __init__(self, onset: Onset, index: int) -> None:
        """Start after an onset; `index` is that of its last half-cycle."""
        arc, last = onset.arc, onset.halves[-1]
        self.index = index
        self.side = last.side
        self.reference_ns = last.reference_ns
        self.noise_scale = onset.noise_scale
        self.misses = 0
        self.first_miss_ns = 0
        self._age = 0
        self._active = arc.active
        self._reference = arc.reference
        self._ratios: deque[float] = deque([onset.noise_scale**2] * _NOISE_MEMORY, maxlen=_NOISE_MEMORY)
        self._agility = 1.0
        self._surprise = 1.0
        self._restlessness = _RESTLESS_AT_FIRST
        self._correction = 1.0
        # a motion that is known is not learned
        learns = RATE in arc.active
        self._history: list[HalfCycleSamples] | None = list(onset.halves) if learns else None
        self._first = arc.states[0].copy()
        self._x, self._covariance = state_on_arc(arc, len(arc.states) - 1)
        self._covariance *= onset.noise_scale**2
        self._resolution = onset.resolution
        self._anchor = self._x.copy()
        self._start_s, self._end_s = arc.windows[-1]
        self._advance()

    @property
    def start_ns(self) -> int:
        """Start of the present half-cycle's window."""
        return self.reference_ns + round(float(self._start_s) * 1e9)

    @property
    def end_ns(self) -> int:
        """End of the present half-cycle's window."""
        return self.reference_ns + round(float(self._end_s) * 1e9)

    @property
    def half_period_s(self) -> float:
        """About half a period."""
        return math.pi / float(self._x[RATE])

    @property
    def lost(self) -> bool:
        """Whether the oscillation has to be looked for anew."""
        if not 0.0 < self._x[AMPLITUDE] < _RUNAWAY * self._reference:
            return True
        blurred = math.sqrt(self._covariance[TIME, TIME]) > _BLUR * self.half_period_s
        return blurred or self.misses >= _PATIENCE

    def take(self, half: HalfCycleSamples) -> tuple[HalfCycleFit, SwingFlag]:
        """Measure the present half-cycle, learn from it unless it was disturbed, and go on to the next."""
        result = self._measure(half, self._covariance)
        flags = self._judge(result)
        if not result.valid or flags & SwingFlag.VIBRATION or result.surprise > _JUMP:
            # the rest position may have moved: see whether that explains it
            again = self._measure_restless(half)
            flags_again = self._judge(again)
            if again.valid and not flags_again & SwingFlag.VIBRATION and again.surprise < _JUMP:
                result, flags = again, flags_again
                self._restlessness = min(max(self._restlessness, 100.0) * 10.0, _MOST_RESTLESS)
        fine = result.valid and not flags & SwingFlag.VIBRATION
        if result.valid and not flags & SwingFlag.GAP:
            self._learn_noise(result)
        if self._history is not None:
            self._history.append(half if fine else _empty(half))
        self._age += 1
        if fine:
            self.misses = 0
            flags |= self._learn(result)
        else:
            if self.misses == 0:
                self.first_miss_ns = self.start_ns
            # a stretch without samples is no disturbance: the motion is known through it
            self.misses += result.samples > 0
        self._advance()
        return result, flags

    def _measure(self, half: HalfCycleSamples, covariance: Matrix) -> HalfCycleFit:
        result = fit_half_cycle(
            self._x,
            covariance,
            self._anchor,
            float(self.side),
            self._reference,
            self._active,
            self.noise_scale,
            self._restlessness < _CALM,
            self._start_s,
            self._end_s,
            half.tau_s,
            half.deflection,
            half.u_deflection,
        )
        # a centre that wanders from half-cycle to half-cycle also wanders within one
        wider = math.sqrt(1.0 + (_WITHIN * SLOPE_WANDER) ** 2 * self._restlessness)
        return result._replace(u_amplitude=result.u_amplitude * wider, u_time_s=result.u_time_s * wider)

    def _measure_restless(self, half: HalfCycleSamples) -> HalfCycleFit:
        """Measure with a centre that may have moved anywhere since, and be moving as fast."""
        loose = self._covariance.copy()
        loose[CENTRE, CENTRE] += self._x[AMPLITUDE] ** 2
        shift = float(self._measure(half, loose).state[CENTRE] - self._x[CENTRE])
        loose = self._covariance.copy()
        loose[CENTRE, CENTRE] += shift**2
        loose[DRIFT, DRIFT] += (shift / self.half_period_s) ** 2
        return self._measure(half, loose)

    def _judge(self, result: HalfCycleFit) -> SwingFlag:
        if not result.valid:
            return SwingFlag.GAP
        return judge(result, self.noise_scale, float(self._x[TIME]), self.half_period_s)

    def _learn_restlessness(self, result: HalfCycleFit) -> None:
        """Let the centre wander as much as it does: its corrections must be as large as expected."""
        expected = self._covariance[CENTRE, CENTRE] - result.covariance[CENTRE, CENTRE]
        if expected > 0.0:
            correction = (result.state[CENTRE] - self._x[CENTRE]) ** 2 / expected
            self._correction += (min(correction, 16.0) - self._correction) / 8.0
            if self._correction > 1.8:
                self._restlessness = min(self._restlessness * max(2.0, min(correction, 16.0)), _MOST_RESTLESS)
            elif self._correction < 1.0:
                self._restlessness = max(self._restlessness * 0.8, 1.0)

    def _learn(self, result: HalfCycleFit) -> SwingFlag:
        jumped = result.surprise > _JUMP and self._surprise < _SURPRISED
        if jumped and self._age < _SETTLED:
            # too early for a kick to be told from a start that was misunderstood
            self.misses = _PATIENCE
            self.first_miss_ns = self.start_ns
            return SwingFlag.VIBRATION
        self._learn_restlessness(result)
        self._x, self._covariance = result.state, result.covariance
        self._resolution = result.resolution
        self._surprise += (min(result.surprise / 2.0, 8.0) - self._surprise) / 8.0
        if self._surprise > _SURPRISED:
            self._agility = min(self._agility * max(2.0, 0.1 * result.surprise), 1e6)
        else:
            self._agility = max(self._agility * 0.9, 1.0)
        if jumped:
            self._accept_jump(result)
            return SwingFlag.START
        self._refit()
        # damping acts linearly enough at every step, and changes for good over a long decay
        self._anchor[SHAPE + DAMPING] = self._x[SHAPE + DAMPING]
        if self.index in _ANCHORS:
            self._anchor = self._x.copy()
        return SwingFlag(0)

    def _accept_jump(self, result: HalfCycleFit) -> None:
        """Take amplitude and time as measured, whatever was predicted; the motion before is another one."""
        self._history = None
        self._x[AMPLITUDE], self._x[TIME] = result.amplitude, result.time_s
        for k, u in ((AMPLITUDE, result.u_amplitude), (TIME, result.u_time_s)):
            self._covariance[k, :] = self._covariance[:, k] = 0.0
            self._covariance[k, k] = u * u

    def _learn_noise(self, result: HalfCycleFit) -> None:
        degrees = max(result.samples - 2, 1)
        self._ratios.append(result.chi2 / degrees)
        median = sorted(self._ratios)[_NOISE_MEMORY // 2]
        scatter = 1.25 * math.sqrt(2.0 / degrees / _NOISE_MEMORY)
        self.noise_scale = math.sqrt(median) if median > 1.0 + 4.0 * scatter else 1.0

    def _refit(self) -> None:
        """Fit all half-cycles so far anew, as one arc, whenever their number has doubled.

        The steps from half-cycle to half-cycle are linearised; terms that the first few of them
        hardly determine would keep the trace of where that was done.
        """
        refits = _REFITS if SHAPE + RISE in self._active else _LINEAR_REFITS
        if self._history is None or len(self._history) not in refits:
            return
        arc = extend(self._first, self._history, self._reference, self._active)
        bent = SHAPE + RISE in self._active
        if arc is not None and excess(arc.chi2 / self.noise_scale**2, float(arc.samples)) < _ARC_EXCESS:
            self._first = arc.states[0].copy()
            if bent or len(arc.active) > len(self._active):
                self._adopt(arc)
        if len(self._history) == _REFITS[-1]:
            self._history = None

    def _adopt(self, arc: Arc) -> None:
        """Go on from the last state of an arc, which knows of no wandering of the rest position."""
        self._active = arc.active
        self._x, self._covariance = state_on_arc(arc, len(arc.states) - 1)
        self._covariance *= self.noise_scale**2
        self._anchor = self._x.copy()
        halves = len(arc.states)
        slope = SLOPE_WANDER * self._resolution / self.half_period_s * math.sqrt(halves)
        self._covariance[DRIFT, DRIFT] += slope**2 / 3.0
        self._covariance[CENTRE, CENTRE] += (slope * halves * self.half_period_s) ** 2 / 30.0

    def _advance(self) -> None:
        # each sample belongs to one half-cycle: the next window starts where this one ended
        end_s = self._end_s
        step_ns, self._x, self._covariance, self._end_s = predict(
            self._x,
            self._covariance,
            self._anchor,
            self._reference,
            self._active,
            self._resolution,
            self._agility,
            self._restlessness,
        )
        self._start_s = end_s - step_ns * 1e-9
        self.reference_ns += step_ns
        self.side = -self.side
        self.index += 1


def _empty(half: HalfCycleSamples) -> HalfCycleSamples:
    nothing = np.empty(0)
    return HalfCycleSamples(half.reference_ns, half.side, nothing, nothing, nothing)
