"""Residuals of whole cycles from a known motion, with the derivatives with respect to what the motion may
still explain.

Half-cycles that are measured one by one adapt to an error that is fixed on the sensor, since each has an
amplitude and a time of its own. A whole cycle, two half-cycles with one amplitude, time and rest position,
passes every place of its range twice, in both directions, and can adapt no more than a constant and a scale.
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
from processing.swing.prediction import KnownMotion
from processing.swing.swing import HalfCycle
from processing.swing.waveform import SHAPES, zero_phases
from processing.units import NS_PER_S, seconds

_ACTIVE = np.array([AMPLITUDE, TIME, RATE, *range(SHAPE, SHAPE + SHAPES), CENTRE, DRIFT])
_OWN = np.isin(_ACTIVE, (AMPLITUDE, TIME, CENTRE, DRIFT))
_TIMING_POWERS = 3
"""Highest power of the place in the error of a sample's time, which rows exposed in turn cause."""
SHARED_COLUMNS = 1 + SHAPES + _TIMING_POWERS
"""Number of columns that all cycles have in common: frequency, shape and timing."""

_REACH_HALF_PERIODS = 0.6
"""Half periods before the first and after the second turning point within which the cycle lies."""
_MIN_SAMPLES = 8
"""Fewest samples of a half-cycle: as many as its own four terms and the fast mode's four."""
_OUTLIER_U = 6.0
"""Standard deviations beyond which a sample is an outlier: of noise alone 2e-9 of the samples."""
_LINE_PROMINENCE = 40.0
"""Power of a line in the fast deflection, relative to the median of all frequencies, that is a fast mode."""


class CycleResiduals(NamedTuple):
    """Samples of one cycle, from a zero crossing to the next but one, as arrays of n samples."""

    place: Floats
    """Deflection by the known motion fitted to this cycle; a measured one would explain the residual."""
    residual: Floats
    """Measured deflection minus that of the motion before the fit."""
    weight: Floats
    """Inverse square of the deflection's uncertainty; 0 for outliers."""
    own: Floats
    """(n, q) derivatives with respect to amplitude, time, equilibrium, drift of the cycle and a fast mode."""
    shared: Floats
    """(n, SHARED_COLUMNS) derivatives with respect to frequency, shape and an error of time by place."""


class CycleWatch:
    """Extraction of the cycles from a stream of deflections.

    Parameters
    ----------
    swings
        Half-cycles of these deflections. Two neighbours without a flag make a cycle.
    motion
        Frequency and waveform, fitted to all half-cycles.
    """

    def __init__(self, swings: Sequence[HalfCycle], motion: KnownMotion) -> None:
        self._motion = motion
        self._pairs = _pairs(swings)
        self._half_ns = round(NS_PER_S * math.pi / motion.rate_rad_per_s)
        self._blocks: list[Deflections] = []

    @property
    def cycles(self) -> int:
        """Number of cycles whose deflections have not arrived."""
        return len(self._pairs)

    def update(self, block: Deflections) -> Iterator[CycleResiduals]:
        """The cycles that end within this block of deflections."""
        if not self._pairs or not len(block):
            return
        self._blocks.append(block)
        reach_ns = round(_REACH_HALF_PERIODS * self._half_ns)
        last_ns = int(block.times_ns[-1])
        if self._pairs[0][1].turn_time_ns + reach_ns > last_ns:
            return
        kept = joined(self._blocks, block.unit)
        while self._pairs and self._pairs[0][1].turn_time_ns + reach_ns <= last_ns:
            first, second = self._pairs.pop(0)
            begin, end = np.searchsorted(
                kept.times_ns, [first.turn_time_ns - reach_ns, second.turn_time_ns + reach_ns]
            )
            found = _residuals(kept[int(begin) : int(end)], first, self._motion)
            if found is not None:
                yield found
        if self._pairs:
            kept = kept.since(self._pairs[0][0].turn_time_ns - reach_ns)
        self._blocks = [kept]


def _pairs(swings: Sequence[HalfCycle]) -> list[tuple[HalfCycle, HalfCycle]]:
    pairs: list[tuple[HalfCycle, HalfCycle]] = []
    before: HalfCycle | None = None
    for swing in swings:
        if swing.flags:
            before = None
        elif before is not None and swing.index == before.index + 1 and swing.side != before.side:
            pairs.append((before, swing))
            before = None
        else:
            before = swing
    return pairs


def _residuals(samples: Deflections, first: HalfCycle, motion: KnownMotion) -> CycleResiduals | None:
    state = motion.put_into(np.zeros(STATES))
    state[AMPLITUDE], state[CENTRE] = first.amplitude, first.centre
    tau_s = seconds(samples.times_ns - first.turn_time_ns)
    usable = np.isfinite(samples.y) & (samples.u_y > 0.0)
    anchor, transition = state.copy(), np.eye(STATES)
    parts: list[tuple[NDArray[np.intp], Floats, Floats]] = []
    side = float(first.side)
    for _ in range(2):
        table, turn = tabulated(state, anchor, motion.reference, _ACTIVE)
        begin_s, end_s = np.array(zero_phases(table)) / state[RATE] + state[TIME]
        rows = np.flatnonzero(usable & (tau_s >= begin_s) & (tau_s < end_s))
        if len(rows) < _MIN_SAMPLES:
            return None
        residual, jacobian = np.empty(len(rows)), np.empty((len(rows), len(_ACTIVE)))
        linearise(state, side, _ACTIVE, table, tau_s[rows], samples.y[rows], residual, jacobian)
        parts.append((rows, residual, jacobian @ transition[np.ix_(_ACTIVE, _ACTIVE)]))
        if len(parts) == 1:
            # times of both half-cycles count from the first turning point: centre and drift do not change
            state, transition = propagate(state, turn, 0.0)
            side = -side
    rows, residual, jacobian = (np.concatenate([part[k] for part in parts]) for k in range(3))
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        return None
    own = jacobian[:, _OWN]
    by_time = jacobian[:, _ACTIVE == TIME]
    relative = (samples.y[rows, None] - state[CENTRE]) / motion.reference
    shared = np.column_stack([jacobian[:, ~_OWN], by_time * relative ** np.arange(1, _TIMING_POWERS + 1)])
    weight = samples.u_y[rows] ** -2.0
    fast = fast_mode_columns(tau_s[rows], samples.x[rows], own)
    if fast is not None:
        own = np.column_stack([own, fast])
    left = without_columns(residual, own, np.sqrt(weight))
    size = np.abs(left) * np.sqrt(weight)
    far = size > _OUTLIER_U * max(1.0, MAD_TO_SIGMA * float(np.median(size)))
    return CycleResiduals(samples.y[rows] - left, residual, np.where(far, 0.0, weight), own, shared)


def without_columns(values: Floats, columns: Floats, root_weight: Floats | float = 1.0) -> Floats:
    """Residuals (n,) of a linear fit of the columns (n, q) to the values (n,)."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    scaled = columns / np.where(size > 0.0, size, 1.0)
    weighted = (scaled.T * root_weight).T
    return np.asarray(
        values - scaled @ np.linalg.lstsq(weighted, values * root_weight, rcond=1e-9)[0], dtype=np.float64
    )


def fast_mode_columns(tau_s: Floats, fast: Floats, own: Floats) -> Floats | None:
    """Columns (n, 4) of the fast mode: cosine and sine of its frequency, and both multiplied by the time.

    The frequency is that of the strongest line in the deflection `fast` (n,) across the slow axis; None if no
    line is strong or a sample is missing. The mode's part along the slow axis would scatter the residuals
    by more than most errors of the sensor. The last two columns allow for damping and a wrong frequency.
    """
    if not np.isfinite(fast).all():
        return None
    left = without_columns(fast, own)
    count = 4 * len(tau_s)
    even_s = np.linspace(tau_s[0], tau_s[-1], len(tau_s))
    window = np.hanning(len(tau_s))
    power = np.abs(np.fft.rfft(window * np.interp(even_s, tau_s, left), count)) ** 2
    top = int(np.argmax(power))
    if not 0 < top < len(power) - 1 or power[top] < _LINE_PROMINENCE * float(np.median(power)):
        return None
    below, peak, above = np.log(power[top - 1 : top + 2])
    rate = 2.0 * math.pi * (top + 0.5 * (below - above) / (below - 2.0 * peak + above))
    phase = rate * (tau_s - tau_s[0]) / (count * (even_s[1] - even_s[0]))
    line = np.column_stack([np.cos(phase), np.sin(phase)])
    return np.column_stack([line, line * np.linspace(-1.0, 1.0, len(line))[:, None]])
