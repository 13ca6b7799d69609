"""From one half-cycle to the next: the motion, and how far it may stray from what was learned."""

import math

import numpy as np
from numba import njit

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
    Indices,
    Matrix,
    Vector,
    propagate,
    tabulate_state,
)
from processing.swing.waveform import BEND, DAMPING, DRY, NODES, RISE, SHAPES, STIFF, N, P, zero_phases

SLOPE_WANDER = 1e-3
"""Change of the centre's slope from one half-cycle to the next, in amplitude uncertainties a half-cycle."""


@njit(cache=True, nogil=True, error_model="numpy")
def predict(
    x: Vector,
    covariance: Matrix,
    anchor: Vector,
    reference: float,
    active: Indices,
    resolution: float,
    agility: float,
    restlessness: float,
) -> tuple[int, Vector, Matrix, float]:
    """Step in ns to the next turning point, state and covariance there, and the end of its window in s.

    The step is rounded to a whole ns and leads from one reference time to the next. `resolution`
    is what an amplitude's uncertainty is at best, the scale of all wandering allowed for; `agility`
    multiplies its variance and is 1 while the predictions hold, `restlessness` that of the drift.
    """
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate_state(x, anchor, reference, active, table, turn)
    rate = x[RATE]
    step_ns = round((x[TIME] + turn[0, 0] / rate) * 1e9)
    elapsed = step_ns * 1e-9
    following, transition = propagate(x, turn, elapsed)
    u_phase = resolution / x[AMPLITUDE]
    loss = abs(1.0 - turn[1, 0])
    wander = np.zeros(STATES)
    wander[AMPLITUDE] = 0.2 * resolution
    wander[TIME] = 0.2 * u_phase / rate
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
        scale = agility
        if i == DRIFT:
            scale = restlessness
        elif i == CENTRE:
            scale = math.sqrt(restlessness)
        carried[i, i] += scale * wander[i] * wander[i]
    # the next half-cycle reaches zero in nearly the same phase as this one
    _, after = zero_phases(table)
    return step_ns, following, carried, following[TIME] + after / rate


@njit(cache=True, nogil=True, error_model="numpy")
def window(x: Vector, reference: float) -> tuple[float, float, float]:
    """Start and end of the half-cycle (its zero crossings) and its next turning point, s."""
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate_state(x, x, reference, np.empty(0, dtype=np.int64), table, turn)
    before, after = zero_phases(table)
    rate = x[RATE]
    return x[TIME] + before / rate, x[TIME] + after / rate, x[TIME] + turn[0, 0] / rate
