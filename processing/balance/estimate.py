"""Estimate of the pendulum's balance from its motion, once every slow period.

The spot of a balanced pendulum moves along a straight line in (X, Y). The motion across the line, its
direction, its rotation, its width and the rest position show what is out of balance.
"""

import math
from dataclasses import replace

import numpy as np

from processing.balance.balance import Balance
from processing.deflections import Deflections, DeflectionUnit, joined, no_deflections
from processing.errors import DataError
from processing.swing import TwoModes, separate_modes
from processing.units import nanoseconds, seconds

_WINDOW_PERIODS = 2.0
_HISTORY_ESTIMATES = 8
"""Number of estimates, one a slow period, from which rates follow: half a minute at a period of 4 s."""
_FEWEST_IN_HISTORY = 4
"""Fewest estimates for a rate: a line leaves two degrees of freedom, which show how well it fits."""
_OVERLAP_CORRELATION = 0.5
"""Correlation of neighbouring estimates, whose windows share half of their samples."""

_FEWEST_SAMPLES, _MOST_SAMPLES = 20, 1200
_FIRST_LOOK_S = 0.5
_LONGEST_LOOK_S = 60.0
_LOOK_GROWTH = 1.5
"""Factor by which the window of a search grows until a period is known, so that every period of 0.5 s to a
minute is found soon after it has passed."""
_REST_CHI2 = 4.0
"""Chi-square per sample below which the pendulum is at rest."""
_MAX_HARMONIC_DISTANCE = 0.1
"""Distance from a whole multiple of the slow mode's frequency within which a weak line is a harmonic of its
waveform: damping and noise under the line shift it by more than its uncertainty."""
_LARGEST_DIFFERENCE, _LARGEST_DIFFERENCE_U = 1e-3, 3.0
"""Largest difference of a window and its later half, relative to amplitude and period, and in standard
uncertainties; the larger one applies."""
_MAX_OVERTONE = 1e-3
"""Largest deviation of the waveform from a sine because of friction, as a fraction of the amplitude."""


class BalanceEstimator:
    """Continuous estimate of the balance from a stream of samples.

    Both modes are fitted by least squares to two slow periods at a time. The first estimate is made after two
    slow periods, then one every period. The estimates do not depend on how the samples are divided into
    blocks.
    """

    def __init__(self) -> None:
        self._blocks: list[Deflections] = []
        self._kept = no_deflections(DeflectionUnit.RAD)
        self._period_s = math.nan
        self._fast_period_s = math.nan
        self._next_ns: int | None = None
        self._look_s = _FIRST_LOOK_S
        self._history: list[tuple[float, ...]] = []

    def update(self, deflections: Deflections) -> list[Balance]:
        """Add deflections (NaN where the spot was lost) and return the estimates that they complete.

        The estimates have the unit of the deflections. Raises DataError if lengths differ.
        """
        times = deflections.times_ns
        columns = [deflections.x, deflections.y, deflections.u_x, deflections.u_y]
        if any(column.shape != times.shape for column in columns):
            raise DataError("times, deflections and uncertainties must be of one length")
        if len(times):
            self._blocks.append(deflections)
        found: list[Balance] = []
        while self._blocks:
            if self._next_ns is None:
                self._next_ns = int(self._blocks[0].times_ns[0]) + nanoseconds(self._look_s)
            if self._blocks[-1].times_ns[-1] < self._next_ns:
                break
            if len(self._blocks) > 1:
                self._kept = joined(self._blocks, deflections.unit)
            else:
                # no copy: a block may be a whole record
                self._kept = self._blocks[0]
            balance = self._estimate(self._next_ns)
            self._blocks = [self._kept]
            if balance is not None:
                found.append(balance)
        return found

    def _estimate(self, until_ns: int) -> Balance | None:
        """One estimate from the samples before `until_ns`; also sets the time of the next one."""
        known = not math.isnan(self._period_s)
        span_s = _WINDOW_PERIODS * self._period_s if known else self._look_s
        modes = self._modes(until_ns - nanoseconds(span_s), until_ns, self._period_s)
        if modes is None or modes.slow.period_s * _WINDOW_PERIODS > span_s * 1.05:
            self._look_again(until_ns)
            return None
        # also of what may be a harmonic: the fast mode, which the next samples may see stop
        fast_period_s = modes.fast.period_s if modes.fast is not None else math.nan
        modes = _without_harmonic(modes)
        if not known:
            later = self._modes(until_ns - nanoseconds(0.5 * span_s), until_ns, modes.slow.period_s)
            if later is None or not _is_same_motion(modes, later):
                # the oscillation began within these samples: leave out the push, or the pendulum at rest
                self._kept = self._kept.since(until_ns - nanoseconds(0.5 * span_s))
                period_s = modes.slow.period_s if later is None else later.slow.period_s
                self._look_s = max(self._look_s, _WINDOW_PERIODS * period_s)
                self._next_ns = None
                return None
        self._period_s = modes.slow.period_s
        self._fast_period_s = fast_period_s
        self._next_ns = until_ns + nanoseconds(self._period_s)
        self._kept = self._kept.since(until_ns - nanoseconds(1.5 * span_s))
        return self._balance(modes)

    def _modes(self, from_ns: int, until_ns: int, period_s: float) -> TwoModes | None:
        first, last = (int(row) for row in np.searchsorted(self._kept.times_ns, [from_ns, until_ns]))
        # use a limited number of samples, which suffices at any frame rate
        stride = 1 + (last - first) // _MOST_SAMPLES
        some = self._kept[first:last:stride]
        if np.count_nonzero(some.found) < _FEWEST_SAMPLES:
            return None
        return separate_modes(
            some.times_ns, some.x, some.y, some.u_x, some.u_y, period_s, self._fast_period_s
        )

    def _look_again(self, until_ns: int) -> None:
        """Without an oscillation, try a longer interval of up to a minute, then later intervals."""
        self._next_ns = None
        if math.isnan(self._period_s) and self._resting(until_ns - round(0.7e9 * self._look_s)):
            # samples from before a release would only mask the oscillation after it
            self._kept = self._kept.since(until_ns - round(0.7e9 * self._look_s))
        elif self._look_s < _LONGEST_LOOK_S and math.isnan(self._period_s):
            self._look_s *= _LOOK_GROWTH
        else:
            self._kept = self._kept.since(until_ns)
            self._period_s = self._fast_period_s = math.nan
            self._look_s = _FIRST_LOOK_S
            self._history.clear()

    def _resting(self, until_ns: int) -> bool:
        """Whether the samples before a time contain only noise."""
        kept = self._kept[: int(np.searchsorted(self._kept.times_ns, until_ns))]
        good = kept.found
        if np.count_nonzero(good) < 3:
            # few good samples: many lost spots count as rest, few samples (a low frame rate) do not
            return len(kept) >= 3
        chi2 = 0.0
        for value, u in ((kept.x[good], kept.u_x[good]), (kept.y[good], kept.u_y[good])):
            weight = u**-2.0
            chi2 += float(weight @ (value - np.average(value, weights=weight)) ** 2)
        return bool(chi2 < _REST_CHI2 * 2 * np.count_nonzero(good))

    def _balance(self, modes: TwoModes) -> Balance:
        slow, fast = modes.slow, modes.fast
        angle, u_angle = slow.direction_rad, slow.u_direction_rad
        if self._history:
            # the direction of a line is defined modulo pi: remove jumps near X
            last = self._history[-1][1]
            angle = last + math.remainder(angle - last, math.pi)
        self._history = [
            *self._history[1 - _HISTORY_ESTIMATES :],
            (
                seconds(modes.time_ns),
                angle,
                u_angle,
                modes.rest_x,
                modes.u_rest_x,
                modes.rest_y,
                modes.u_rest_y,
            ),
        ]
        (turning, u_turning), (drift_x, u_drift_x), (drift_y, u_drift_y) = (self._rate(k) for k in (1, 3, 5))
        transverse, u_transverse = 0.0, modes.fast_limit
        period_ratio, u_period_ratio = math.nan, math.nan
        if fast is not None:
            transverse, u_transverse = fast.x_amplitude, fast.u_x_amplitude
            period_ratio = slow.period_s / fast.period_s
            u_period_ratio = period_ratio * math.hypot(
                slow.u_period_s / slow.period_s, fast.u_period_s / fast.period_s
            )
        along = slow.y_amplitude
        return Balance(
            time_ns=modes.time_ns,
            unit=self._kept.unit,
            period_s=slow.period_s,
            u_period_s=slow.u_period_s,
            amplitude=along,
            u_amplitude=slow.u_y_amplitude,
            transverse=transverse,
            u_transverse=u_transverse,
            transverse_ratio=transverse / along,
            u_transverse_ratio=math.hypot(u_transverse, transverse * slow.u_y_amplitude / along) / along,
            line_angle_rad=slow.direction_rad,
            u_line_angle_rad=u_angle,
            rotation_rad_per_s=turning,
            u_rotation_rad_per_s=u_turning,
            width_ratio=slow.width / slow.amplitude,
            u_width_ratio=slow.u_width / slow.amplitude,
            rest_x=modes.rest_x,
            u_rest_x=modes.u_rest_x,
            rest_y=modes.rest_y,
            u_rest_y=modes.u_rest_y,
            drift_x_per_s=drift_x,
            u_drift_x_per_s=u_drift_x,
            drift_y_per_s=drift_y,
            u_drift_y_per_s=u_drift_y,
            period_ratio=period_ratio,
            u_period_ratio=u_period_ratio,
        )

    def _rate(self, column: int) -> tuple[float, float]:
        """Rate of change per s of a column of the history, and its standard uncertainty."""
        table = np.array(self._history)
        if len(table) < _FEWEST_IN_HISTORY:
            return math.nan, math.nan
        weight = table[:, column + 1] ** -2.0
        time = table[:, 0] - np.average(table[:, 0], weights=weight)
        value = table[:, column] - np.average(table[:, column], weights=weight)
        spread = float(weight @ time**2)
        slope = float(weight @ (time * value)) / spread
        chi2_per_dof = float(weight @ (value - slope * time) ** 2) / (len(table) - 2)
        lever = time * np.sqrt(weight)
        shared = 2.0 * _OVERLAP_CORRELATION * float(lever[1:] @ lever[:-1])
        return slope, math.sqrt(max(chi2_per_dof, 1.0) * (spread + shared)) / spread


def _is_same_motion(whole: TwoModes, later: TwoModes) -> bool:
    """Whether a window and its later half have the same rest position and period."""
    size = whole.slow.amplitude
    for value, u, scale in (
        (later.rest_x - whole.rest_x, math.hypot(later.u_rest_x, whole.u_rest_x), size),
        (later.rest_y - whole.rest_y, math.hypot(later.u_rest_y, whole.u_rest_y), size),
        (
            later.slow.period_s - whole.slow.period_s,
            math.hypot(later.slow.u_period_s, whole.slow.u_period_s),
            whole.slow.period_s,
        ),
    ):
        if abs(value) > max(_LARGEST_DIFFERENCE_U * u, _LARGEST_DIFFERENCE * scale):
            return False
    return True


def _without_harmonic(modes: TwoModes) -> TwoModes:
    """Remove a fast mode that is only a harmonic of the slow mode's waveform.

    Friction makes the waveform deviate from a sine by about 5e-4 of the amplitude; without a fast mode these
    harmonics are the strongest spectral lines. A weaker fast mode at such a frequency cannot be distinguished
    from them: `fast_limit` is raised accordingly.
    """
    slow, fast = modes.slow, modes.fast
    if fast is None:
        return modes
    ratio = slow.period_s / fast.period_s
    u_ratio = ratio * math.hypot(slow.u_period_s / slow.period_s, fast.u_period_s / fast.period_s)
    size = math.hypot(fast.x_amplitude, fast.y_amplitude)
    if size > _MAX_OVERTONE * slow.amplitude or abs(ratio - round(ratio)) > max(
        3.0 * u_ratio, _MAX_HARMONIC_DISTANCE
    ):
        return modes
    return replace(modes, fast=None, fast_limit=max(modes.fast_limit, size))
