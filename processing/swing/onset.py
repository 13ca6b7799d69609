"""Search for an oscillation of unknown period and amplitude, and measurement of its first half-cycles.

Rough turning points (`Pivot`) are collected until four in a row may belong to one oscillation. An arc is
fitted to the samples around them (`term_selection`, `arc`). If the fit is plausible, each half-cycle is
measured with the prediction from the others as a prior.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from processing.arrays import Matrix, Vector
from processing.swing.arc import Arc, HalfCycleSamples, state_before, state_on_arc
from processing.swing.half_cycle import AMPLITUDE, RATE, TIME, tabulated
from processing.swing.half_cycle_fit import HalfCycleFit, fit_half_cycle
from processing.swing.judgement import holds_turning_point, judge
from processing.swing.noise import NoiseLevel
from processing.swing.prediction import KnownMotion
from processing.swing.sample_buffer import (
    PIVOT,
    PIVOT_TIME,
    SEARCH_STATE,
    Pivot,
    SampleBuffer,
    is_regular,
    search,
)
from processing.swing.term_selection import rough_state, select
from processing.swing.turning_point import HalfCycleFlag
from processing.swing.waveform import zero_phases
from processing.units import nanoseconds, seconds

_START_PIVOTS = 4
"""Number of rough turning points that start a fit."""
_MIN_PIVOTS = 3
"""Number of rough turning points that start a fit at the end of the record."""
_STORED_SAMPLES = 1 << 17
"""Number of samples stored while no oscillation is found, so that memory is bounded."""
_MAX_CHI2 = 1.5
"""Reduced chi-square of a first fit above which a fit without the first half-cycle is tried."""
_MAX_CHI2_RATIO = 4.0
"""Ratio of a half-cycle's reduced chi-square to the median of all above which the fit is rejected."""
_MIN_SILENCE_HALF_PERIODS = 50
"""Fewest half periods after a loss at which an oscillation of any period is accepted."""
_MIN_PERIOD_RATIO, _MAX_PERIOD_RATIO = 0.7, 1.4
"""Range of the ratio of new to old half period that is accepted before that time."""
_MAX_DEVIATION, _MAX_DEVIATION_U = 0.5, 5.0
"""Largest deviation of an amplitude of the same decay from the prediction, as a fraction of the prediction
and in standard uncertainties; the larger one applies."""
_MAX_RELATIVE_RMS = 0.2
"""Largest accepted rms residual, as a fraction of the amplitude."""


@dataclass(frozen=True, slots=True)
class FirstHalfCycle:
    """Measurement of one of the half-cycles at the start: its samples, fit and flags."""

    half: HalfCycleSamples
    result: HalfCycleFit
    flags: HalfCycleFlag


@dataclass(frozen=True, slots=True)
class Onset:
    """A newly found oscillation."""

    arc: Arc
    halves: list[HalfCycleSamples]
    """The half-cycles of the arc."""
    noise_scale: float
    """Factor on the samples' standard uncertainties, from the reduced chi-square; at least 1."""
    first_half_cycles: list[FirstHalfCycle]
    """Measurements of the half-cycles of the arc, after that before it if its turning point was recorded."""

    @property
    def resolution(self) -> float:
        """Uncertainty of the last half-cycle's amplitude if all other parameters were known.

        Of n samples of uncertainty u it is sqrt(2/n) u, since the mean of cos^2 over a half-cycle is 1/2.
        """
        half = self.halves[-1]
        u = half.u_deflection[np.isfinite(half.deflection)] * self.noise_scale
        return math.sqrt(2.0 / float((1.0 / u**2).sum()))

    @property
    def half_period_s(self) -> float:
        """About half a period."""
        return math.pi / float(self.arc.states[-1][RATE])


class OnsetSearch:
    """Search of arriving samples for four turning points in a row that belong to one oscillation."""

    def __init__(
        self,
        samples: SampleBuffer,
        position: int,
        half_period_s: float = math.nan,
        lost_ns: int = 0,
        known: KnownMotion | None = None,
        min_noise_scale: float = 1.0,
    ) -> None:
        """Start at a position in the buffer.

        After the loss of an oscillation, `half_period_s` is its half period (NaN at the beginning of a
        record), `lost_ns` the time of the loss, and `min_noise_scale` the factor on the samples'
        uncertainties learned before it. `known` is the frequency and shape of the motion, if they are known.
        """
        self._min_noise_scale = min_noise_scale
        self._samples = samples
        self._known = known
        self._half_period_s = half_period_s
        self._lost_ns = lost_ns
        self._searched = position + samples.dropped
        self._state = np.zeros(SEARCH_STATE)
        self._marks = np.zeros(PIVOT_TIME + 1, dtype=np.int64)
        self._pivots: list[Pivot] = []
        self._attempt_ns: int | None = None

    def advance(self, final: bool) -> Onset | None:
        """Search all samples that have arrived; `final` if no more will. None if no oscillation is found."""
        samples = self._samples
        while True:
            if self._attempt_ns is not None:
                if samples.last_ns < self._attempt_ns and not final:
                    return None
                self._attempt_ns = None
                onset = self._attempt()
                if onset is not None:
                    return onset
            position = search(
                samples.times_ns, samples.deflection, samples.u_deflection, self._searched - samples.dropped,
                samples.tail, self._state, self._marks,
            )  # fmt: skip
            if position < 0:
                self._searched = samples.tail + samples.dropped
                self._forget()
                if (
                    not final
                    or len(self._pivots) < _MIN_PIVOTS
                    or not is_regular(self._pivots[-_MIN_PIVOTS:])
                ):
                    return None
                self._pivots = self._pivots[-_MIN_PIVOTS:]
                return self._attempt()
            self._searched = position + samples.dropped
            self._pivots.append(Pivot(int(self._marks[PIVOT_TIME]), float(self._state[PIVOT])))
            del self._pivots[:-_START_PIVOTS]
            if len(self._pivots) == _START_PIVOTS and is_regular(self._pivots) and not self._is_disturbance():
                self._attempt_ns = self._pivots[-1].time_ns + _spacing_ns(self._pivots) * 6 // 10

    def _is_disturbance(self) -> bool:
        """Whether the period differs, shortly after a loss, from that of the oscillation that was
        followed."""
        if math.isnan(self._half_period_s):
            return False
        silence = seconds(self._pivots[0].time_ns - self._lost_ns) / self._half_period_s
        ratio = seconds(_spacing_ns(self._pivots)) / self._half_period_s
        return silence < _MIN_SILENCE_HALF_PERIODS and not _MIN_PERIOD_RATIO < ratio < _MAX_PERIOD_RATIO

    def _forget(self) -> None:
        # count from the samples searched and not from those received, so that the result does not depend on
        # how the samples are divided into blocks
        self._samples.forget_before(self._searched - self._samples.dropped - _STORED_SAMPLES)

    def _attempt(self) -> Onset | None:
        self._forget()
        pivots = self._pivots
        halves = _cut(self._samples, pivots)
        arc = select(rough_state(pivots), halves, self._known)
        if len(pivots) > 2 and (arc is None or arc.chi2 > _MAX_CHI2 * arc.samples):
            # the first half-cycle may contain the release or a kick
            later = select(rough_state(pivots[1:]), halves[1:], self._known)
            if later is not None and (arc is None or later.reduced_chi2 < 0.5 * arc.reduced_chi2):
                arc, halves = later, halves[1:]
        if arc is None or not _is_plausible(arc, halves):
            return None
        reduced = arc.chi2 / max(arc.samples - len(arc.active), 1)
        noise_scale = max(self._min_noise_scale, math.sqrt(max(1.0, reduced)))
        first_half_cycles = [_measure(arc, k, half, noise_scale) for k, half in enumerate(halves)]
        half_cycle_before = _measure_before(self._samples, arc, halves[0], noise_scale)
        if half_cycle_before is not None:
            first_half_cycles.insert(0, half_cycle_before)
        return Onset(arc, halves, noise_scale, first_half_cycles)


def _spacing_ns(pivots: list[Pivot]) -> int:
    return (pivots[-1].time_ns - pivots[0].time_ns) // (len(pivots) - 1)


def _cut(samples: SampleBuffer, pivots: list[Pivot]) -> list[HalfCycleSamples]:
    """Divide the samples into half-cycles: cuts lie midway between the rough turning points."""
    spacing = _spacing_ns(pivots)
    edges = [pivots[0].time_ns - spacing // 2]
    edges += [(a.time_ns + b.time_ns) // 2 for a, b in pairwise(pivots)]
    edges.append(pivots[-1].time_ns + spacing // 2)
    first_side = 1 if pivots[0].deflection > pivots[1].deflection else -1
    return [
        samples.between(p.time_ns, first_side * (-1) ** k, start, end)
        for k, (p, (start, end)) in enumerate(zip(pivots, pairwise(edges), strict=True))
    ]


def _is_plausible(arc: Arc, halves: list[HalfCycleSamples]) -> bool:
    sampled = arc.chi2_each[arc.chi2_each[:, 1] > 0]
    chi2 = sampled[:, 0] / sampled[:, 1]
    if not np.all(np.isfinite(arc.windows)) or len(chi2) == 0:
        return False
    if np.any(~np.isfinite(chi2)) or chi2.max() > _MAX_CHI2_RATIO * max(np.median(chi2), 1.0):
        return False
    u = np.median(np.concatenate([h.u_deflection[np.isfinite(h.deflection)] for h in halves]))
    return bool(math.sqrt(arc.reduced_chi2) * u < _MAX_RELATIVE_RMS * arc.states[-1][AMPLITUDE])


def _fit(
    arc: Arc, x: Vector, covariance: Matrix, half: HalfCycleSamples, start: float, end: float, scale: float
) -> FirstHalfCycle:
    """Measure a half-cycle from `start` to `end`, with a predicted state and covariance as the prior."""
    result = fit_half_cycle(
        x, covariance * scale**2, x, float(half.side), arc.reference, arc.active, scale, True, start, end,
        half.tau_s, half.deflection, half.u_deflection,
    )  # fmt: skip
    flags = HalfCycleFlag(0)
    if result.valid:
        flags = judge(result, NoiseLevel(scale), float(x[TIME]), math.pi / float(x[RATE]))
    return FirstHalfCycle(half, result, flags)


def _measure(arc: Arc, k: int, half: HalfCycleSamples, noise_scale: float) -> FirstHalfCycle:
    """Measure half-cycle `k` of an arc, with the prediction by its other half-cycles as the prior."""
    x, covariance = state_on_arc(arc, k, left_out=k)
    start, end = arc.windows[k]
    start = max(start, float(half.tau_s[0])) if k else start
    return _fit(arc, x, covariance, half, start, end, noise_scale)


def _measure_before(
    samples: SampleBuffer, arc: Arc, first: HalfCycleSamples, noise_scale: float
) -> FirstHalfCycle | None:
    """Measure the half-cycle before the arc; None if its turning point was not recorded. It is flagged START
    if it is disturbed, by the release, or its amplitude does not belong to the decay."""
    x, covariance, reference_ns = state_before(arc, first.reference_ns)
    table, _ = tabulated(x, x, arc.reference, np.empty(0, dtype=np.int64))
    start = float(x[TIME]) + zero_phases(table)[0] / float(x[RATE])
    if not math.isfinite(start):
        return None
    end_ns = first.reference_ns + nanoseconds(arc.windows[0][0])
    half = samples.between(reference_ns, -first.side, reference_ns + nanoseconds(start), end_ns)
    measured = _fit(arc, x, covariance, half, start, seconds(end_ns - reference_ns), noise_scale)
    if not holds_turning_point(measured.result, half):
        return None
    deviation = abs(measured.result.amplitude - x[AMPLITUDE])
    max_deviation = max(_MAX_DEVIATION * x[AMPLITUDE], _MAX_DEVIATION_U * measured.result.u_amplitude)
    if deviation > max_deviation or measured.flags & HalfCycleFlag.VIBRATION:
        return replace(measured, flags=measured.flags & ~HalfCycleFlag.VIBRATION | HalfCycleFlag.START)
    return measured
