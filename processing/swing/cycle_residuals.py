"""Residuals of whole cycles from a known motion, and derivatives with respect to the parameters still free.

Half-cycles that are measured one by one adapt to an error that is fixed on the sensor, since each has an
amplitude and a time of its own. A whole cycle, two half-cycles with a common amplitude, time and rest
position, passes every deflection twice, in both directions, and can adapt only by a constant and a scale.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.deflections import Deflections, joined
from processing.noise_models import MAD_TO_SIGMA
from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    RATE,
    SHAPE,
    STATES,
    TIME,
    linearise,
    propagate,
    tabulated,
)
from processing.swing.half_cycle_fit import OUTLIER_U
from processing.swing.prediction import KnownMotion
from processing.swing.turning_point import HalfCycle
from processing.swing.waveform import SHAPES, zero_phases
from processing.units import NS_PER_S, seconds

_FREE = np.array([AMPLITUDE, TIME, RATE, *range(SHAPE, SHAPE + SHAPES), CENTRE, DRIFT])
"""Entries of the state (see `half_cycle`) that are free."""
_IS_OF_CYCLE = np.isin(_FREE, (AMPLITUDE, TIME, CENTRE, DRIFT))
"""Which of them each cycle has for itself."""
_TIMING_DEGREE = 3
"""Degree of the polynomial, in the deflection, of the timing error that a rolling shutter causes."""
SHARED_PARAMETERS = 1 + SHAPES + _TIMING_DEGREE
"""Number of parameters that all cycles have in common: frequency, shape and timing."""
_REACH_HALF_PERIODS = 0.6
"""Half periods before the first and after the second turning point within which the cycle lies."""
_MIN_SAMPLES = 8
"""Fewest samples of a half-cycle: the number of the cycle's four parameters and the fast mode's four."""
_MIN_LINE_PROMINENCE = 40.0
"""Smallest power of a fast mode's line in the fast deflection, relative to the median of all frequencies."""

_RIDGE = 1e-10
"""Ridge on a normal matrix over its mean diagonal: a term may vanish, or be a combination of others."""


class CycleResiduals(NamedTuple):
    """Samples of one cycle, from a zero crossing to the next but one, as arrays of n samples."""

    deflection: Floats
    """Deflection of the fitted motion. The measured deflection contains the residual itself and would
    correlate with it."""
    residual: Floats
    """Measured deflection minus that of the motion before the fit."""
    weight: Floats
    """Inverse square of the deflection's uncertainty; 0 for outliers."""
    cycle_derivatives: Floats
    """(n, q) derivatives with respect to the cycle's amplitude, time, centre and drift, and a fast mode."""
    shared_derivatives: Floats
    """(n, SHARED_PARAMETERS) derivatives by frequency, shape and the polynomial of the timing error."""


class CycleExtractor:
    """Extraction of the cycles from a stream of deflections; `motion` was fitted to all their half-cycles.

    Two neighbouring half-cycles without a flag make a cycle.
    """

    def __init__(self, half_cycles: Sequence[HalfCycle], motion: KnownMotion) -> None:
        self._motion = motion
        self._cycles = _cycles_of(half_cycles)
        self._reach_ns = round(_REACH_HALF_PERIODS * round(NS_PER_S * math.pi / motion.rate_rad_per_s))
        self._blocks: list[Deflections] = []

    @property
    def pending_cycles(self) -> int:
        """Number of cycles whose deflections have not arrived."""
        return len(self._cycles)

    def update(self, block: Deflections) -> Iterator[CycleResiduals]:
        """The cycles that end within this block of deflections."""
        if not self._cycles or not len(block):
            return
        self._blocks.append(block)
        last_ns = int(block.times_ns[-1]) - self._reach_ns
        if self._cycles[0][1].turn_time_ns > last_ns:
            return
        stored = joined(self._blocks, block.unit)
        while self._cycles and self._cycles[0][1].turn_time_ns <= last_ns:
            first, second = self._cycles.pop(0)
            begin, end = np.searchsorted(
                stored.times_ns, [first.turn_time_ns - self._reach_ns, second.turn_time_ns + self._reach_ns]
            )
            residuals = _residuals(stored[int(begin) : int(end)], first, self._motion)
            if residuals is not None:
                yield residuals
        if self._cycles:
            stored = stored.since(self._cycles[0][0].turn_time_ns - self._reach_ns)
        self._blocks = [stored]


def _cycles_of(half_cycles: Sequence[HalfCycle]) -> list[tuple[HalfCycle, HalfCycle]]:
    cycles: list[tuple[HalfCycle, HalfCycle]] = []
    first: HalfCycle | None = None
    for half_cycle in half_cycles:
        if half_cycle.flags:
            first = None
        elif first is not None and half_cycle.index == first.index + 1 and half_cycle.side != first.side:
            cycles.append((first, half_cycle))
            first = None
        else:
            first = half_cycle
    return cycles


def _residuals(samples: Deflections, first: HalfCycle, motion: KnownMotion) -> CycleResiduals | None:
    state = motion.put_into(np.zeros(STATES))
    state[AMPLITUDE], state[CENTRE] = first.amplitude, first.centre
    tau_s = seconds(samples.times_ns - first.turn_time_ns)
    usable = np.isfinite(samples.y) & (samples.u_y > 0.0)
    anchor, transition = state.copy(), np.eye(STATES)
    halves: list[tuple[NDArray[np.intp], Floats, Floats]] = []
    side = float(first.side)
    for _ in range(2):
        table, turn = tabulated(state, anchor, motion.reference, _FREE)
        begin_s, end_s = np.array(zero_phases(table)) / state[RATE] + state[TIME]
        rows = np.flatnonzero(usable & (tau_s >= begin_s) & (tau_s < end_s))
        if len(rows) < _MIN_SAMPLES:
            return None
        residual, jacobian = np.empty(len(rows)), np.empty((len(rows), len(_FREE)))
        linearise(state, side, _FREE, table, tau_s[rows], samples.y[rows], residual, jacobian)
        halves.append((rows, residual, jacobian @ transition[np.ix_(_FREE, _FREE)]))
        if len(halves) == 1:
            # times of both half-cycles count from the first turning point: centre and drift do not change
            state, transition = propagate(state, turn, 0.0)
            side = -side
    rows, residual, jacobian = (np.concatenate([half[k] for half in halves]) for k in range(3))
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        return None
    cycle_derivatives = jacobian[:, _IS_OF_CYCLE]
    relative = (samples.y[rows, None] - state[CENTRE]) / motion.reference
    timing = jacobian[:, _FREE == TIME] * relative ** np.arange(1, _TIMING_DEGREE + 1)
    shared_derivatives = np.column_stack([jacobian[:, ~_IS_OF_CYCLE], timing])
    weight = samples.u_y[rows] ** -2.0
    fast_mode = fast_mode_derivatives(tau_s[rows], samples.x[rows], cycle_derivatives)
    if fast_mode is not None:
        cycle_derivatives = np.column_stack([cycle_derivatives, fast_mode])
    remainder = linear_fit_residuals(residual, cycle_derivatives, np.sqrt(weight))
    normalised = np.abs(remainder) * np.sqrt(weight)
    is_outlier = normalised > OUTLIER_U * max(1.0, MAD_TO_SIGMA * float(np.median(normalised)))
    weight = np.where(is_outlier, 0.0, weight)
    return CycleResiduals(
        samples.y[rows] - remainder, residual, weight, cycle_derivatives, shared_derivatives
    )


def linear_fit_residuals(values: Floats, terms: Floats, root_weight: Floats | float = 1.0) -> Floats:
    """Residuals (n,) of a linear fit of the terms (n, q) to the values (n,)."""
    norm = np.sqrt(np.sum(terms**2, axis=0))
    scaled = terms / np.where(norm > 0.0, norm, 1.0)
    weighted = (scaled.T * root_weight).T
    normal = weighted.T @ weighted
    normal[np.diag_indices_from(normal)] += _RIDGE * (np.trace(normal) / len(normal) or 1.0)
    coefficients = np.linalg.solve(normal, weighted.T @ (values * root_weight))
    return np.asarray(values - scaled @ coefficients, dtype=np.float64)


def fast_mode_derivatives(tau_s: Floats, fast_deflection: Floats, terms: Floats) -> Floats | None:
    """Terms (n, 4) of the fast mode: cosine and sine of its frequency, and both multiplied by the time.

    The frequency is that of the strongest line in the deflection (n,) across the slow axis, after a fit of
    the `terms` (n, q) to it; None if no line is strong or a sample is missing. Along the slow axis the mode
    would scatter the residuals by more than most errors of the sensor. The last two terms allow for damping
    and a wrong frequency.
    """
    if not np.isfinite(fast_deflection).all():
        return None
    residual = linear_fit_residuals(fast_deflection, terms)
    count = 4 * len(tau_s)
    even_s = np.linspace(tau_s[0], tau_s[-1], len(tau_s))
    window = np.hanning(len(tau_s))
    power = np.abs(np.fft.rfft(window * np.interp(even_s, tau_s, residual), count)) ** 2
    peak = int(np.argmax(power))
    if not 0 < peak < len(power) - 1 or power[peak] < _MIN_LINE_PROMINENCE * float(np.median(power)):
        return None
    below, top, above = np.log(power[peak - 1 : peak + 2])
    rate = 2.0 * math.pi * (peak + 0.5 * (below - above) / (below - 2.0 * top + above))
    phase = rate * (tau_s - tau_s[0]) / (count * (even_s[1] - even_s[0]))
    line = np.column_stack([np.cos(phase), np.sin(phase)])
    return np.column_stack([line, line * np.linspace(-1.0, 1.0, len(line))[:, None]])
