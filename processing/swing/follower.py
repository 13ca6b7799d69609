"""Extended Kalman filter with adaptive noise that follows one oscillation from half-cycle to half-cycle.

Each half-cycle is predicted (`prediction`), measured (`half_cycle_fit`) and judged (`judgement`). Undisturbed
half-cycles update the state. The process noise has two adaptive scales. `_process_noise` multiplies the
variance by which all terms may change, and grows while the normalised innovations of the turning points are
too large. `_drift_noise` multiplies the variance of the rest position's drift, and grows while the
corrections of the centre and of its drift are larger than expected.
"""

import math

import numpy as np

from processing.arrays import Matrix
from processing.swing.arc import Arc, HalfCycleSamples, state_on_arc
from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    FAST_RATE,
    RATE,
    SHAPE,
    STATES,
    TIME,
    tabulated,
)
from processing.swing.half_cycle_fit import HalfCycleFit, excess, fit_half_cycle
from processing.swing.judgement import judge
from processing.swing.noise import SampleNoise
from processing.swing.onset import Onset
from processing.swing.prediction import SLOPE_WANDER, DrivenWalk, predict
from processing.swing.term_selection import ANHARMONIC, FAST_MODE, extend, friction_start, prior
from processing.swing.turning_point import HalfCycleFlag
from processing.swing.waveform import DAMPING, RISE
from processing.units import nanoseconds, seconds

_REFIT_HALF_CYCLES = (8, 16, 32, 64)
"""Numbers of half-cycles after which all of them are fitted again jointly."""
_LINEAR_REFIT_HALF_CYCLES = (6, 8, 10, 12, 16, 24, 32, 64)
"""The same numbers for a model that is still a damped sinusoid."""
_ANCHOR_INDICES = (128, 256, 512, 1024)
"""Indices of half-cycles at which the waveform is expanded about the present state."""
_MIN_KICK_INNOVATION = 100.0
"""Normalised innovation squared (two degrees of freedom) of a turning point above which it was a kick."""
_MAX_CONSISTENT_INNOVATION = 3.0
"""Running mean of the squared innovation per degree of freedom above which the predictions count as wrong."""
_MAX_CALM_DRIFT_NOISE = 100.0
"""Scale of the drift's process noise below which an insignificant drift of the centre may be set to zero."""
_INITIAL_DRIFT_NOISE = 30.0
_CENTRE_WANDER_EFFECT = 0.15
"""Effect on a turning point of the centre's change per half-cycle, relative to that change."""
_MAX_ARC_EXCESS_STD = 4.0
"""Largest chi-square, in standard deviations above its expectation, at which an arc without process noise is
accepted."""
_START_HALF_CYCLES = 8
"""Number of half-cycles before which an unexpected turning point counts as a wrong start, not as a kick."""
_MAX_MISSES = 3
"""Number of disturbed half-cycles in a row after which the oscillation counts as lost."""
_MAX_STILL_DRIFT_NOISE = 1e4
"""Scale of the drift's process noise that a rest position without draughts does not reach."""
_THIRD_HARMONIC_RANGE = 0.4
"""Largest difference between a fast mode's frequency and three times the pendulum's, relative to the
pendulum's, at which the mode may be the third harmonic."""
_MAX_COLOURED_DRIFT_NOISE = 1e6
"""Largest scale of the drift's process noise in slow noise, which already counts as noise of the samples."""
_SHAPE_INFLATION = 2.0
"""Factor on the uncertainties of frequency and shape where they predict a driven motion wrongly."""
_MAX_AMPLITUDE_RATIO = 10.0
"""Amplitude, relative to the reference, above which the filter has diverged."""
_MAX_U_TIME_HALF_PERIODS = 0.1
"""Uncertainty of the next turning point's time above which the oscillation counts as lost."""


class OscillationFollower:
    """State of the oscillation, carried from half-cycle to half-cycle."""

    def __init__(self, onset: Onset, index: int, previous: "OscillationFollower | None") -> None:
        """Start from a newly found oscillation; `index` is the index of its last half-cycle.

        The samples' noise is taken over from the `previous` follower, that before a loss.
        """
        arc, last = onset.arc, onset.halves[-1]
        self.index = index
        self.side = last.side
        self.reference_ns = last.reference_ns
        self.noise: SampleNoise = SampleNoise(onset.noise_scale) if previous is None else previous.noise
        self.walk = DrivenWalk()
        self.misses = 0
        self.first_miss_ns = 0
        self._age = 0
        self._active = arc.active
        self._reference = arc.reference
        self._process_noise = 1.0
        self._mean_innovation = 1.0
        self._drift_noise = _INITIAL_DRIFT_NOISE
        self._corrections = np.ones(2)
        # with a known motion, frequency and shape are fixed and no refits are needed
        self._history: list[HalfCycleSamples] | None = list(onset.halves) if RATE in arc.active else None
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
        return self.reference_ns + nanoseconds(float(self._start_s))

    @property
    def end_ns(self) -> int:
        """End of the present half-cycle's window."""
        return self.reference_ns + nanoseconds(float(self._end_s))

    @property
    def half_period_s(self) -> float:
        """About half a period."""
        return math.pi / float(self._x[RATE])

    @property
    def lost(self) -> bool:
        """Whether the oscillation is lost and a new search is needed."""
        max_amplitude = _MAX_AMPLITUDE_RATIO * self._reference
        if not (0.0 < self._x[AMPLITUDE] < max_amplitude and math.isfinite(self._end_s)):
            return True
        u_time_s = math.sqrt(self._covariance[TIME, TIME])
        return u_time_s > _MAX_U_TIME_HALF_PERIODS * self.half_period_s or self.misses >= _MAX_MISSES

    def take(self, half: HalfCycleSamples) -> tuple[HalfCycleFit, HalfCycleFlag]:
        """Measure the present half-cycle, update the state unless it was disturbed, and go on to the next.

        Returns the measurement and its flags, 0 for an undisturbed one.
        """
        result, flags, is_undisturbed = self._measure(half, self._covariance)
        if not is_undisturbed or result.normalised_innovation > _MIN_KICK_INNOVATION:
            # the rest position may have moved: test whether this explains the large residuals
            moved, moved_flags, is_explained = self._measure_moved_rest(half)
            if is_explained and moved.normalised_innovation < _MIN_KICK_INNOVATION:
                result, flags, is_undisturbed = moved, moved_flags, True
                self._drift_noise = max(self._drift_noise, 100.0) * 10.0
        if is_undisturbed and self._drive_begins(result):
            result, flags, is_undisturbed = self._measure(half, self._covariance)
        if result.valid and not flags & HalfCycleFlag.GAP:
            self.noise.learn(result)
        if self._history is not None:
            without_samples = HalfCycleSamples(half.reference_ns, half.side, *np.empty((3, 0)))
            self._history.append(half if is_undisturbed else without_samples)
        self._age += 1
        if is_undisturbed:
            self.misses = 0
            flags |= self._learn(result)
        else:
            if self.misses == 0:
                self.first_miss_ns = self.start_ns
            # a gap in the samples is no disturbance: the motion can be predicted through it
            self.misses += result.samples > 0
        self._advance()
        return result, flags

    def _measure(
        self, half: HalfCycleSamples, covariance: Matrix
    ) -> tuple[HalfCycleFit, HalfCycleFlag, bool]:
        """Measurement of the present half-cycle, its flags, and whether it is valid and undisturbed."""
        result = self._fit(half, covariance)
        flags = HalfCycleFlag.GAP
        if result.valid:
            flags = judge(result, self.noise.level, float(self._x[TIME]), self.half_period_s)
        return result, flags, result.valid and not flags & HalfCycleFlag.VIBRATION

    def _fit(self, half: HalfCycleSamples, covariance: Matrix) -> HalfCycleFit:
        noise = self.noise.level
        drive = self.walk.inflation(self._resolution)
        calm = self._drift_noise < _MAX_CALM_DRIFT_NOISE
        result = fit_half_cycle(
            self._x, covariance, self._anchor, float(self.side), self._reference, self._active,
            noise.effective * drive.samples, calm, self._start_s, self._end_s, half.tau_s, half.deflection,
            half.u_deflection,
        )  # fmt: skip
        # A centre that wanders between half-cycles also wanders within one, which the model of a linear drift
        # does not describe: enlarge the uncertainties accordingly.
        inflation = math.sqrt(1.0 + (_CENTRE_WANDER_EFFECT * SLOPE_WANDER) ** 2 * self._drift_noise)
        return result._replace(
            u_amplitude=result.u_amplitude * inflation * noise.amplitude * drive.amplitude / drive.samples,
            u_time_s=result.u_time_s * inflation * drive.time / drive.samples,
            resolution=result.resolution / drive.samples,
        )

    def _measure_moved_rest(self, half: HalfCycleSamples) -> tuple[HalfCycleFit, HalfCycleFlag, bool]:
        """Measure with wide uncertainties of centre and drift, for a rest position that has moved. A first
        fit finds the shift; the second allows for that shift, and for a drift of it per half period."""
        wide = self._covariance.copy()
        wide[CENTRE, CENTRE] += self._x[AMPLITUDE] ** 2
        shift = float(self._fit(half, wide).state[CENTRE] - self._x[CENTRE])
        wide = self._covariance.copy()
        wide[CENTRE, CENTRE] += shift**2
        wide[DRIFT, DRIFT] += (shift / self.half_period_s) ** 2
        return self._measure(half, wide)

    def _learn_drift_noise(self, result: HalfCycleFit) -> None:
        """Adapt the drift's process noise until the means of correction^2/(P - P'), before and after, are 1.
        The smaller of both counts: slow noise corrects the centre too much whatever the drift's noise is."""
        expected = (self._covariance - result.covariance).diagonal()[[CENTRE, DRIFT]]
        if not np.all(expected > 0.0):
            return
        corrections = np.minimum((result.state - self._x)[[CENTRE, DRIFT]] ** 2 / expected, 16.0)
        self._corrections += (corrections - self._corrections) / 8.0
        mean = self._corrections.min()
        if mean > 1.8:
            self._drift_noise *= max(2.0, corrections.min())
        elif mean < 1.0:
            self._drift_noise = max(self._drift_noise * 0.8, 1.0)

    def _learn(self, result: HalfCycleFit) -> HalfCycleFlag:
        """Update the state by an undisturbed half-cycle; returns further flags of it."""
        has_jumped = (
            result.normalised_innovation > _MIN_KICK_INNOVATION
            and self._mean_innovation < _MAX_CONSISTENT_INNOVATION
        )
        if has_jumped and self._age < _START_HALF_CYCLES:
            # too early to distinguish a kick from a wrong model at the start: search again
            self.misses = _MAX_MISSES
            self.first_miss_ns = self.start_ns
            return HalfCycleFlag.VIBRATION
        self._learn_drift_noise(result)
        self._drift_noise = min(self._drift_noise, self.walk.max_drift_noise(self._resolution))
        if self.noise.level.colour > 1.0:
            self._drift_noise = min(self._drift_noise, _MAX_COLOURED_DRIFT_NOISE)
        self._x, self._covariance = result.state, result.covariance
        self._resolution = result.resolution
        self._mean_innovation += (min(result.normalised_innovation / 2.0, 8.0) - self._mean_innovation) / 8.0
        if self.walk.variance > 0.0:
            if self.walk.biased():
                # frequency and shape predict the driven motion wrongly
                factors = np.full(STATES, _SHAPE_INFLATION)
                factors[[AMPLITUDE, TIME]] = 1.0
                self._covariance *= np.outer(factors, factors)
        elif self._mean_innovation > _MAX_CONSISTENT_INNOVATION:
            self._process_noise = min(self._process_noise * max(2.0, 0.1 * result.normalised_innovation), 1e6)
        else:
            self._process_noise = max(self._process_noise * 0.9, 1.0)
        if has_jumped:
            # a kick: replace amplitude and time by the measured ones and drop the motion before it
            self._history = None
            self._x[AMPLITUDE], self._x[TIME] = result.amplitude, result.time_s
            for k, u in ((AMPLITUDE, result.u_amplitude), (TIME, result.u_time_s)):
                self._covariance[k, :] = self._covariance[:, k] = 0.0
                self._covariance[k, k] = u * u
            return HalfCycleFlag.START
        self._refit()
        # The model is nearly linear in the damping, which changes considerably over a long decay: expand
        # about its present value at every step.
        self._anchor[SHAPE + DAMPING] = self._x[SHAPE + DAMPING]
        if self.index in _ANCHOR_INDICES:
            self._anchor = self._x.copy()
        return HalfCycleFlag(0)

    def _drive_begins(self, result: HalfCycleFit) -> bool:
        """Learn the drive; True if it becomes significant now, and the state is freed for a driven motion."""
        speed = float(self._x[AMPLITUDE] * self._x[RATE])
        differences = result.amplitude - self._x[AMPLITUDE], (result.time_s - self._x[TIME]) * speed
        variances = (
            self._covariance[AMPLITUDE, AMPLITUDE] + result.u_amplitude**2,
            (self._covariance[TIME, TIME] + result.u_time_s**2) * speed**2,
        )
        rest_moves = self._drift_noise > _MAX_STILL_DRIFT_NOISE
        if not self.walk.learn(differences, variances, result.resolution, rest_moves):
            return False
        self._covariance *= self.walk.excess
        self._covariance[AMPLITUDE, AMPLITUDE] += self.walk.variance
        self._covariance[TIME, TIME] += self.walk.variance / speed**2
        self._process_noise = self._mean_innovation = 1.0
        self._corrections = np.ones(2)
        self._drift_noise = min(self._drift_noise, _INITIAL_DRIFT_NOISE)
        # a joint fit of the half-cycles would ignore the drive
        self._history = None
        if RATE in self._active and SHAPE + RISE not in self._active:
            self._add_anharmonic_terms()
        return True

    def _add_anharmonic_terms(self) -> None:
        """Add the anharmonic terms, which joint fits of a driven motion do not find. A fast mode near the
        third harmonic is dropped, because it was fitted in place of these terms."""
        terms = {*self._active.tolist(), *ANHARMONIC}
        if abs(self._x[FAST_RATE] / self._x[RATE] - 3.0) < _THIRD_HARMONIC_RANGE:
            terms -= set(FAST_MODE)
            self._x[list(FAST_MODE)] = 0.0
        sigma = prior(self._x, anharmonic=True)[1]
        self._x = friction_start(self._x)
        self._anchor = self._x.copy()
        for term in ANHARMONIC:
            self._covariance[term, term] = sigma[term] ** 2
        self._active = np.array(sorted(terms), dtype=np.int64)

    def _refit(self) -> None:
        """Fit all half-cycles so far jointly, each time their number has about doubled: terms would keep an
        error from the poor first states about which they were linearised."""
        refits = _REFIT_HALF_CYCLES if SHAPE + RISE in self._active else _LINEAR_REFIT_HALF_CYCLES
        if self._history is None or len(self._history) not in refits:
            return
        arc = extend(self._first, self._history, self._reference, self._active)
        anharmonic = SHAPE + RISE in self._active
        scale = self.noise.level.scale
        if arc is not None and excess(arc.chi2 / scale**2, float(arc.samples)) < _MAX_ARC_EXCESS_STD:
            self._first = arc.states[0].copy()
            if anharmonic or len(arc.active) > len(self._active):
                self._adopt(arc)
        if len(self._history) == _REFIT_HALF_CYCLES[-1]:
            self._history = None

    def _adopt(self, arc: Arc) -> None:
        """Continue from the last state of an arc. It has no process noise: the variances of centre and drift
        are enlarged by a random walk of the drift over its half-cycles."""
        self._active = arc.active
        self._x, self._covariance = state_on_arc(arc, len(arc.states) - 1)
        self._covariance *= self.noise.level.effective**2
        self._anchor = self._x.copy()
        halves = len(arc.states)
        slope = SLOPE_WANDER * self._resolution / self.half_period_s * math.sqrt(halves)
        self._covariance[DRIFT, DRIFT] += slope**2 / 3.0
        self._covariance[CENTRE, CENTRE] += (slope * halves * self.half_period_s) ** 2 / 30.0

    def _advance(self) -> None:
        # no sample may be used twice: the next window starts where this one ended
        end_s = self._end_s
        waveform = tabulated(self._x, self._anchor, self._reference, self._active)
        step_ns, self._x, self._covariance, self._end_s = predict(
            self._x, self._covariance, *waveform, self._reference, self._active, self._resolution,
            self._process_noise, self._drift_noise, self.walk.variance,
        )  # fmt: skip
        self._start_s = end_s - seconds(step_ns)
        self.reference_ns += step_ns
        self.side = -self.side
        self.index += 1
