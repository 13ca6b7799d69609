"""Estimate of the pendulum's balance from its motion, once every slow period.

The spot of a balanced pendulum moves along a straight line in (X, Y). The motion across the line, its
direction, its rotation, its width and the rest position show what is out of balance.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from processing.balance.balance import Balance
from processing.deflections import Deflections, DeflectionUnit, joined, no_deflections
from processing.swing import TwoModes, separate_modes
from processing.units import nanoseconds, seconds

_WINDOW_PERIODS = 2.0
"""Length of a fitted window in slow periods."""
_HISTORY_ESTIMATES = 8
"""Number of estimates, one a slow period, from which rates follow: half a minute at a period of 4 s."""
_MIN_HISTORY = 4
"""Smallest number of estimates for a rate: a line leaves two degrees of freedom, which show its scatter."""
_OVERLAP_CORRELATION = 0.5
"""Correlation of neighbouring estimates, whose windows share half of their samples."""

_MIN_SAMPLES, _MAX_SAMPLES = 20, 1200
_MIN_SEARCH_S = 0.5
_MAX_SEARCH_S = 60.0
_SEARCH_GROWTH = 1.5
"""Factor by which the window of a search grows until a period is known."""
_LATER_FRACTION = 0.7
"""Fraction of a search window, at its end, that is searched again if the pendulum rests before it."""
_REST_CHI2 = 4.0
"""Chi-square per sample below which the pendulum is at rest."""
_MAX_HARMONIC_DISTANCE = 0.1
"""Distance from a whole multiple of the slow mode's frequency within which a weak line is a harmonic of its
waveform: damping and noise under the line shift it by more than its uncertainty.
"""
_MAX_DIFFERENCE_U = 3.0
"""Largest difference of a window and its later half, in standard uncertainties."""
_MAX_RELATIVE_DIFFERENCE = 1e-3
"""Difference of a window and its later half, relative to amplitude and period, that is always allowed."""
_MAX_OVERTONE = 1e-3
"""Largest deviation of the waveform from a sine because of friction, as a fraction of the amplitude."""


class _Estimate(NamedTuple):
    """Direction of the line and rest position, with standard uncertainties, from which rates follow."""

    time_s: float
    line_angle_rad: float
    u_line_angle_rad: float
    rest_x: float
    u_rest_x: float
    rest_y: float
    u_rest_y: float


class BalanceEstimator:
    """Continuous estimate of the balance from a stream of samples.

    Both modes are fitted by least squares to two slow periods at a time. The first estimate is made after two
    slow periods, then one every period. The estimates do not depend on how the samples are divided into
    blocks.
    """

    def __init__(self) -> None:
        self._blocks: list[Deflections] = []
        self._samples = no_deflections(DeflectionUnit.RAD)
        self._period_s = math.nan
        self._fast_period_s = math.nan
        self._next_ns: int | None = None
        self._search_s = _MIN_SEARCH_S
        self._history: list[_Estimate] = []

    def update(self, deflections: Deflections) -> list[Balance]:
        """Add deflections (NaN where the spot was lost) and return the estimates that they complete.

        The estimates have the unit of the deflections.
        """
        if len(deflections):
            self._blocks.append(deflections)
        balances: list[Balance] = []
        while self._blocks:
            if self._next_ns is None:
                self._next_ns = int(self._blocks[0].times_ns[0]) + nanoseconds(self._search_s)
            if self._blocks[-1].times_ns[-1] < self._next_ns:
                break
            # a single block, which may be a whole record, is not copied
            single = len(self._blocks) == 1
            self._samples = self._blocks[0] if single else joined(self._blocks, deflections.unit)
            balance = self._estimate(self._next_ns)
            self._blocks = [self._samples]
            if balance is not None:
                balances.append(balance)
        return balances

    def _estimate(self, until_ns: int) -> Balance | None:
        """One estimate from the samples before `until_ns`; also sets the time of the next one."""
        is_search = math.isnan(self._period_s)
        span_s = self._search_s if is_search else _WINDOW_PERIODS * self._period_s
        modes = self._modes(until_ns - nanoseconds(span_s), until_ns, self._period_s)
        if modes is None or modes.slow.period_s * _WINDOW_PERIODS > span_s * 1.05:
            self._extend_search(until_ns)
            return None
        # the next fit starts from a fast mode also if it is removed as a harmonic here, and shows its end
        fast_period_s = modes.fast.period_s if modes.fast is not None else math.nan
        modes = _without_harmonic(modes)
        if is_search:
            later = self._modes(until_ns - nanoseconds(0.5 * span_s), until_ns, modes.slow.period_s)
            if later is None or not _is_same_motion(modes, later):
                # the oscillation began within these samples: leave out the push, or the pendulum at rest
                self._samples = self._samples.since(until_ns - nanoseconds(0.5 * span_s))
                period_s = modes.slow.period_s if later is None else later.slow.period_s
                self._search_s = max(self._search_s, _WINDOW_PERIODS * period_s)
                self._next_ns = None
                return None
        self._period_s = modes.slow.period_s
        self._fast_period_s = fast_period_s
        self._next_ns = until_ns + nanoseconds(self._period_s)
        self._samples = self._samples.since(until_ns - nanoseconds(1.5 * span_s))
        return self._balance(modes)

    def _modes(self, from_ns: int, until_ns: int, period_s: float) -> TwoModes | None:
        first, last = (int(row) for row in np.searchsorted(self._samples.times_ns, [from_ns, until_ns]))
        # a limited number of samples suffices at any frame rate
        window = self._samples[first : last : 1 + (last - first) // _MAX_SAMPLES]
        if np.count_nonzero(window.found) < _MIN_SAMPLES:
            return None
        return separate_modes(
            window.times_ns, window.x, window.y, window.u_x, window.u_y, period_s, self._fast_period_s
        )

    def _extend_search(self, until_ns: int) -> None:
        """Search later if the pendulum was at rest, else in a longer window; at its limit, or after an end,
        anew."""
        self._next_ns = None
        is_search = math.isnan(self._period_s)
        rest_end_ns = until_ns - nanoseconds(_LATER_FRACTION * self._search_s)
        if is_search and self._is_at_rest(rest_end_ns):
            # samples from before a release would only mask the oscillation after it
            self._samples = self._samples.since(rest_end_ns)
        elif is_search and self._search_s < _MAX_SEARCH_S:
            self._search_s *= _SEARCH_GROWTH
        else:
            self._samples = self._samples.since(until_ns)
            self._period_s = self._fast_period_s = math.nan
            self._search_s = _MIN_SEARCH_S
            self._history.clear()

    def _is_at_rest(self, until_ns: int) -> bool:
        """Whether the samples before a time contain only noise. True if nearly all spots are lost, False if
        there are hardly any samples (a low frame rate)."""
        samples = self._samples[: int(np.searchsorted(self._samples.times_ns, until_ns))]
        good = samples.found
        if np.count_nonzero(good) < 3:
            return len(samples) >= 3
        chi2 = 0.0
        for value, u in ((samples.x[good], samples.u_x[good]), (samples.y[good], samples.u_y[good])):
            weight = u**-2.0
            chi2 += float(weight @ (value - np.average(value, weights=weight)) ** 2)
        return bool(chi2 < _REST_CHI2 * 2 * np.count_nonzero(good))

    def _balance(self, modes: TwoModes) -> Balance:
        slow, fast = modes.slow, modes.fast
        angle, u_angle = slow.direction_rad, slow.u_direction_rad
        if self._history:
            # the direction of a line is defined modulo pi: remove jumps near X
            last = self._history[-1].line_angle_rad
            angle = last + math.remainder(angle - last, math.pi)
        rest = modes.rest_x, modes.u_rest_x, modes.rest_y, modes.u_rest_y
        estimate = _Estimate(seconds(modes.time_ns), angle, u_angle, *rest)
        self._history = [*self._history[1 - _HISTORY_ESTIMATES :], estimate]
        rotation, u_rotation = self._rate("line_angle_rad")
        (drift_x, u_drift_x), (drift_y, u_drift_y) = self._rate("rest_x"), self._rate("rest_y")
        # without a fast mode the uncertainty is the limit of its detection
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
            unit=self._samples.unit,
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
            rotation_rad_per_s=rotation,
            u_rotation_rad_per_s=u_rotation,
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

    def _rate(self, name: str) -> tuple[float, float]:
        """Rate of change per s of a quantity of the history, and its standard uncertainty."""
        if len(self._history) < _MIN_HISTORY:
            return math.nan, math.nan
        time, value, u = (
            np.array([getattr(estimate, field) for estimate in self._history])
            for field in ("time_s", name, f"u_{name}")
        )
        weight = u**-2.0
        time = time - np.average(time, weights=weight)
        value = value - np.average(value, weights=weight)
        spread = float(weight @ time**2)
        slope = float(weight @ (time * value)) / spread
        chi2_per_dof = float(weight @ (value - slope * time) ** 2) / (len(time) - 2)
        leverage = time * np.sqrt(weight)
        covariance = 2.0 * _OVERLAP_CORRELATION * float(leverage[1:] @ leverage[:-1])
        return slope, math.sqrt(max(chi2_per_dof, 1.0) * (spread + covariance)) / spread


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
        if abs(value) > max(_MAX_DIFFERENCE_U * u, _MAX_RELATIVE_DIFFERENCE * scale):
            return False
    return True


def _without_harmonic(modes: TwoModes) -> TwoModes:
    """Remove a fast mode that is only a harmonic of the slow mode's waveform, about 5e-4 of its amplitude. A
    weaker fast mode there cannot be distinguished from it: `fast_limit` is raised accordingly."""
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
