"""Prediction step of the Kalman filter, from one half-cycle to the next.

The state follows the equation of motion; its covariance becomes

    P' = F P F^T + Q

with the transition matrix F (`half_cycle.propagate`) and the process noise Q, a diagonal matrix of the
variances by which each term may change between two half-cycles, beyond the model. Nearly all of Q is
expressed by `resolution`, the uncertainty of a single amplitude: terms may change slowly compared with
what one half-cycle can measure. The filter then averages over many half-cycles, yet follows slow changes.
"""

import math

import numpy as np

from processing.arrays import Ints, Matrix, Vector
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
    tabulated,
)
from processing.swing.waveform import BEND, DAMPING, DRY, RISE, STIFF, N, P, Table, zero_phases
from processing.ticks import NS_PER_S, S_PER_NS

SLOPE_WANDER = 1e-3
"""Standard deviation of the change of the drift per half-cycle, in units of (resolution per half-cycle)."""


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
    x, covariance
        State at the present turning point and its covariance (see `half_cycle`).
    table, turn
        The waveform of that state (see `tabulate_state`).
    reference
        Amplitude to which the shape terms refer.
    active
        Free entries of the state.
    resolution
        Uncertainty of an amplitude if all other parameters were known; scale of the process noise.
    process_noise
        Scale of the process noise: factor on the variances Q of all terms but centre and drift; 1 while
        predictions agree with measurements.
    drift_noise
        The same factor for the drift; its square root applies to the centre.
    walk
        Variance of the steps that a drive adds to the amplitude, and to the phase times the amplitude, from
        one half-cycle to the next; square of the unit of the deflection.

    Returns
    -------
    step_ns, state, covariance, end_s
        Difference of the reference times (a whole number of ns), predicted state and covariance, and the end
        of the half-cycle's window in s after its reference time.
    """
    rate = x[RATE]
    step_ns = round((x[TIME] + turn[0, 0] / rate) * NS_PER_S)
    elapsed = step_ns * S_PER_NS
    following, transition = propagate(x, turn, elapsed)
    u_phase = resolution / x[AMPLITUDE]
    loss = abs(1.0 - turn[1, 0])
    wander = np.zeros(STATES)
    wander[AMPLITUDE] = 0.2 * resolution
    wander[TIME] = 0.2 * u_phase / rate
    # a stiffness that depends on the amplitude changes the frequency with every loss of amplitude; part of
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
    moved = np.zeros((STATES, STATES))
    carried = np.zeros((STATES, STATES))
    for i in active:
        for j in active:
            for k in active:
                moved[i, j] += transition[i, k] * covariance[k, j]
    for i in active:
        for j in active:
            for k in active:
                carried[i, j] += moved[i, k] * transition[j, k]
    for i in active:
        for j in active:
            if j < i:
                carried[i, j] = carried[j, i]
        scale = process_noise
        if i == DRIFT:
            scale = drift_noise
        elif i == CENTRE:
            scale = math.sqrt(drift_noise)
        carried[i, i] += scale * wander[i] * wander[i]
    carried[AMPLITUDE, AMPLITUDE] += walk
    carried[TIME, TIME] += walk / (x[AMPLITUDE] * rate) ** 2
    # the next half-cycle crosses zero at nearly the same phase as this one
    _, after = zero_phases(table)
    return step_ns, following, carried, following[TIME] + after / rate


def window(x: Vector, reference: float) -> tuple[float, float, float]:
    """Zero crossings before and after the turning point and the next turning point, s from the reference."""
    table, turn = tabulated(x, x, reference, np.empty(0, dtype=np.int64))
    before, after = zero_phases(table)
    start, rate = float(x[TIME]), float(x[RATE])
    return start + before / rate, start + after / rate, start + float(turn[0, 0]) / rate
