"""Prediction of the next half-cycle, frequency and waveform of a known motion, random walk by a drive."""

import math
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints, Matrix, Vector
from processing.kernel import kernel
from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    FAST_COSINE,
    FAST_DAMPING,
    FAST_RATE,
    FAST_SINE,
    RATE,
    SHAPE,
    STATES,
    TIME,
    propagate,
)
from processing.swing.waveform import BEND, DAMPING, DRY, RISE, SHAPES, STIFF, N, P, Table, zero_phases
from processing.units import NS_PER_S, S_PER_NS


@dataclass(frozen=True, slots=True)
class KnownMotion:
    """Frequency and shape of the motion at every amplitude (see `waveform` for the equation)."""

    rate_rad_per_s: float
    """Angular frequency of the linear part of the waveform's equation at the reference amplitude."""
    reference: float
    """Reference amplitude, unit of the deflection."""
    damping: float = 0.0
    """The first of the state's shape terms; they follow in their order and are dimensionless."""
    dry: float = 0.0
    rise: float = 0.0
    p: float = 1.0
    stiff: float = 0.0
    n: float = 1.0
    bend: float = 0.0

    def put_into(self, x: Floats) -> Floats:
        """Copy of the state `x` (see `half_cycle`) with this motion's frequency and shape."""
        state = np.array(x, dtype=np.float64)
        assert state.shape == (STATES,)
        state[RATE] = self.rate_rad_per_s
        state[SHAPE : SHAPE + SHAPES] = astuple(self)[2:]
        return state


SLOPE_WANDER = 1e-3
"""Standard deviation of the drift's change from one half-cycle to the next, in resolutions per half-cycle."""


@kernel
def predict(
    x: Vector,
    covariance: Matrix,
    table: Table,
    turn: Matrix,
    reference: float,
    active: Ints,
    resolution: float,
    process_noise: float,
    drift_noise: float,
    walk: float,
) -> tuple[int, Vector, Matrix, float]:
    """Predict the next half-cycle.

    Parameters
    ----------
    x, covariance : state at the present turning point and its covariance (see `half_cycle`)
    table, turn : the waveform of that state (see `tabulate_state`)
    reference : amplitude to which the shape terms refer
    active : free entries of the state
    resolution : uncertainty of an amplitude if all else were known; scale of the process noise
    process_noise : factor on the variances of all terms but centre and drift; 1 while predictions are right
    drift_noise : factor on the variance of the drift; its square root applies to the centre
    walk : variance of the steps that a drive adds to the amplitude, and to the phase times the amplitude,
        from one half-cycle to the next; square of the unit of the deflection

    Returns
    -------
    step_ns, state, covariance, end_s
        Difference of the reference times (a whole number of ns), predicted state and covariance, and the end
        of the half-cycle's window in s after its reference time.
    """
    rate = x[RATE]
    step_ns = round((x[TIME] + turn[0, 0] / rate) * NS_PER_S)
    elapsed = step_ns * S_PER_NS
    next_state, transition = propagate(x, turn, elapsed)
    u_phase = resolution / x[AMPLITUDE]
    loss = abs(1.0 - turn[1, 0])
    wander = np.zeros(STATES)
    wander[AMPLITUDE] = 0.2 * resolution
    wander[TIME] = 0.2 * u_phase / rate
    # a stiffness that depends on the amplitude changes the frequency with every loss of amplitude; a part of
    # that change may be wrong
    softness = abs(x[SHAPE + STIFF]) + abs(x[SHAPE + BEND])
    wander[RATE] = max(min(3e-3 * u_phase, 1e-4), 0.03 * loss * softness) * rate
    ratio = x[AMPLITUDE] / reference
    wander[SHAPE + DAMPING] = 1e-3 * u_phase
    wander[SHAPE + DRY] = min(2e-3 * u_phase, 1e-3 * loss) * ratio
    wander[SHAPE + RISE] = min(2e-3 * u_phase, 1e-3 * loss) * ratio
    wander[SHAPE + P] = 1e-4
    wander[SHAPE + STIFF] = 1e-3 * u_phase
    wander[SHAPE + BEND] = 1e-3 * u_phase
    wander[SHAPE + N] = 1e-4
    wander[CENTRE] = 0.01 * resolution
    wander[DRIFT] = SLOPE_WANDER * resolution / elapsed
    wander[FAST_COSINE] = wander[FAST_SINE] = 0.1 * resolution
    size = math.hypot(x[FAST_COSINE], x[FAST_SINE]) + resolution
    wander[FAST_RATE] = 1e-2 * resolution / (size * elapsed)
    wander[FAST_DAMPING] = 1e-2 * resolution / (size * elapsed)
    # F P F^T, active entries only
    half_product = np.zeros((STATES, STATES))
    predicted = np.zeros((STATES, STATES))
    for i in active:
        for j in active:
            for k in active:
                half_product[i, j] += transition[i, k] * covariance[k, j]
    for i in active:
        for j in active:
            for k in active:
                predicted[i, j] += half_product[i, k] * transition[j, k]
    for i in active:
        for j in active:
            if j < i:
                predicted[i, j] = predicted[j, i]
        scale = process_noise
        if i == DRIFT:
            scale = drift_noise
        elif i == CENTRE:
            scale = math.sqrt(drift_noise)
        predicted[i, i] += scale * wander[i] * wander[i]
    predicted[AMPLITUDE, AMPLITUDE] += walk
    predicted[TIME, TIME] += walk / (x[AMPLITUDE] * rate) ** 2
    # the next half-cycle crosses zero at nearly the same phase as this one
    _, after = zero_phases(table)
    return step_ns, next_state, predicted, next_state[TIME] + after / rate


_VARIANCE_HALF_CYCLES = 32
"""Number of half-cycles over which the running mean of the steps' variance extends."""
_MEAN_HALF_CYCLES = 16
"""Number of half-cycles over which the other running means extend."""
_MIN_DRIVE_SQUARES = 4.0
"""Sum of the running means of both squares, in units of their variances, above which there is a drive."""
_MIN_DRIVE_SQUARES_MOVING_REST = 3.4
"""The same limit where the rest position seems to move. By chance the sum is 2 ± 0.35."""
_MAX_DEVIATE = 4.0
"""Limit on differences in standard deviations, once there is a drive."""
_MAX_OFFSET = 0.65
"""Running mean of the differences, in standard deviations (it scatters by 0.18), above which the motion
without the drive is predicted wrongly."""
_MAX_ALTERNATION = 0.3
"""Alternating part of the amplitudes' squares above which they are no evidence of a drive."""
_MAX_SQUARE = 32.0
"""Limit on the square of a difference, in its variance, so that a single knock is no drive."""
_MIN_STEP = 0.2
"""Step that the prediction allows for anyway, in units of an amplitude's uncertainty with all else known."""
_AMPLITUDE_ERROR, _TIME_ERROR, _CENTRE_ERROR = 0.35, 0.37, 0.33
"""Errors that a white drive causes within a half-cycle, in steps, in a fit of amplitude, phase and centre to
the samples about a turning point. Half of the amplitude's error is that of the centre, which is fitted with
it. The centre's error is relative to that from white noise of the same resolution."""
_DRIFT_PART = 0.05
"""Standard deviation of the drift's change per half-cycle that a drive's steps allow, in these steps."""
_MAX_DRIFT_NOISE = 1e9


class DriveInflation(NamedTuple):
    """Factors on uncertainties for the effect of a drive within a half-cycle, which resembles noise."""

    samples: float = 1.0
    amplitude: float = 1.0
    time: float = 1.0


class DrivenWalk:
    """Variance of a drive's random steps of amplitude and phase, learned; 0 without a drive."""

    def __init__(self) -> None:
        self.variance = 0.0
        self._means = [1.0, 1.0]
        self._offsets = [0.0, 0.0]
        self._alternation = self._last_deviate = 0.0
        self._count = 0

    def biased(self) -> bool:
        """Whether the differences have a mean, which a drive does not cause for long; resets the mean."""
        if max(map(abs, self._offsets)) < _MAX_OFFSET:
            return False
        self._offsets = [0.0, 0.0]
        return True

    def inflation(self, resolution: float) -> DriveInflation:
        """Factors on uncertainties; `resolution` is the amplitude's uncertainty with all else known."""
        if self.variance == 0.0:
            return DriveInflation()
        relative = self.variance / resolution**2
        samples, amplitude, time = (
            math.sqrt(1.0 + error**2 * relative) for error in (_CENTRE_ERROR, _AMPLITUDE_ERROR, _TIME_ERROR)
        )
        return DriveInflation(samples, amplitude, time)

    def max_drift_noise(self, resolution: float) -> float:
        """Largest `drift_noise` of `predict`: a part of the steps' variance.

        With a drive the rest position seems to move, too. With more noise it would take up the steps of
        amplitude and phase.
        """
        if self.variance == 0.0 or self._alternates:
            return _MAX_DRIFT_NOISE
        return max(1.0, self.variance * (_DRIFT_PART / (SLOPE_WANDER * resolution)) ** 2)

    @property
    def _alternates(self) -> bool:
        """Whether the amplitudes' differences alternate, as with a rest position that wanders."""
        return self._alternation > _MAX_ALTERNATION * self._means[0]

    @property
    def excess(self) -> float:
        """Mean ratio of the squared differences to their expected variances, at least 1."""
        return max(1.0, 0.5 * sum(self._means))

    def learn(
        self,
        differences: tuple[float, float],
        variances: tuple[float, float],
        resolution: float,
        rest_moves: bool,
    ) -> bool:
        """Add one more half-cycle; True if the drive becomes significant with it.

        Parameters
        ----------
        differences : measured minus predicted amplitude, and measured minus predicted time multiplied by
            amplitude and angular frequency; unit of the deflection
        variances : expected variances of the differences, with the present steps
        resolution : uncertainty of the amplitude if all else were known, unit of the deflection
        rest_moves : whether the rest position seems to move as well, as it does with an unknown drive
        """
        squares = [d * d for d in differences]
        ratios = [min(s / v, _MAX_SQUARE) for s, v in zip(squares, variances, strict=True)]
        for k in (0, 1):
            self._means[k] += (ratios[k] - self._means[k]) / _MEAN_HALF_CYCLES
        deviate = math.copysign(math.sqrt(ratios[0]), differences[0])
        self._alternation += (-deviate * self._last_deviate - self._alternation) / _MEAN_HALF_CYCLES
        self._last_deviate = deviate
        if self.variance == 0.0:
            self._offsets = [0.0, 0.0]
            limit = _MIN_DRIVE_SQUARES_MOVING_REST if rest_moves else _MIN_DRIVE_SQUARES
            if sum(self._means) < limit or self._alternates:
                return False
            self._count = 2
            self.variance = max(0.5 * (sum(squares) - sum(variances)), resolution**2)
            return True
        self._count = min(self._count + 1, _VARIANCE_HALF_CYCLES)
        variance = self.variance
        for k in (0, 1):
            deviate = max(-_MAX_DEVIATE, min(differences[k] / math.sqrt(variances[k]), _MAX_DEVIATE))
            square = (deviate - self._offsets[k]) ** 2 - (max(self._alternation, 0.0) if k == 0 else 0.0)
            variance += 0.5 * variances[k] * (square - 1.0)
            self._offsets[k] += (deviate - self._offsets[k]) / _MEAN_HALF_CYCLES
        self.variance += (variance - self.variance) / self._count
        if self.variance < (_MIN_STEP * resolution) ** 2:
            self.variance = 0.0
            self._means = [1.0, 1.0]
        return False
