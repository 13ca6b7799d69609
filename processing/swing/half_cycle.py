"""Linearised model of one half-cycle: state, normal equations, step to the next turning point.

The state of the pendulum at a turning point consists of float64 numbers:

====================  =====================================================================
`AMPLITUDE`           distance of the turning point from the centre, unit of the deflection
`TIME`                time of the turning point in s after the reference time
`RATE`                angular frequency in rad/s of the linear part of the waveform's equation
`SHAPE` .. +6         damping, dry, rise, p, stiff, n, bend (see `waveform`), dimensionless
`CENTRE`, `DRIFT`     rest position at the reference time, and its rate of change per s
`FAST_COSINE` ..      fast mode: cosine and sine amplitude at the reference time (unit of the
`FAST_DAMPING`        deflection), angular frequency in rad/s, damping in 1/s
====================  =====================================================================

Each half-cycle has its own reference time, a whole number of ns, so that times in s stay small and lose no
digits. Only the active entries of the state are free; the others are constants.
"""

import math

import numpy as np

from processing.arrays import Ints, Matrix, Vector
from processing.kernel import kernel
from processing.swing.waveform import LOG_RATIO, NODES, NODES_BEFORE, SHAPES, STEP, Table, locate, tabulate

AMPLITUDE, TIME, RATE, SHAPE, CENTRE, DRIFT = 0, 1, 2, 3, 10, 11
FAST_COSINE, FAST_SINE, FAST_RATE, FAST_DAMPING = 12, 13, 14, 15
STATES = 16


@kernel
def invert(matrix: Matrix, inverse: Matrix) -> bool:
    """Inverse of a symmetric positive definite matrix by its Cholesky factor; False for any other matrix.

    The matrix is scaled to a unit diagonal first, because the entries of the state have different units and
    their variances differ by many orders of magnitude.
    """
    n = len(matrix)
    scale = np.empty(n)
    for i in range(n):
        if not matrix[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j] * scale[i] * scale[j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-14:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(n):
        lower[i, i] = 1.0 / lower[i, i]
    for j in range(n):
        for i in range(j + 1, n):
            total = 0.0
            for k in range(j, i):
                total -= lower[i, k] * lower[k, j]
            lower[i, j] = total * lower[i, i]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += lower[k, i] * lower[k, j]
            inverse[i, j] = inverse[j, i] = total * scale[i] * scale[j]
    return True


@kernel
def tabulate_state(
    x: Vector, anchor: Vector, reference: float, active: Ints, table: Table, turn: Matrix
) -> None:
    """Tabulate the waveform of the state `x` and its derivatives with respect to the active shape terms.

    The waveform is expanded to first order in the shape terms about those of another state, the `anchor`.
    Of terms that are hard to distinguish the half-cycles determine linear combinations, which are the same as
    long as the anchor is. With a new expansion at every step these combinations would change, the filter
    would gain information in all of them, and the covariance would be too small (the inconsistency known of
    extended Kalman filters).

    `table` and `turn` are overwritten (see `waveform.tabulate`).
    """
    terms = np.empty(SHAPES + 1, dtype=np.int64)
    count = 1
    for entry in active:
        if SHAPE <= entry < SHAPE + SHAPES:
            terms[count - 1] = entry - SHAPE
            count += 1
    terms[count - 1] = LOG_RATIO
    shape = np.empty(SHAPES + 1)
    for k in range(SHAPES):
        shape[k] = anchor[SHAPE + k]
    shape[LOG_RATIO] = math.log(abs(x[AMPLITUDE]) / reference)
    tabulate(shape, terms[:count], table, turn)
    for k in terms[:count]:
        change = x[SHAPE + k] - anchor[SHAPE + k] if k < SHAPES else 0.0
        if change != 0.0:
            for node in range(NODES):
                table[0, node, 0] += change * table[1 + k, node, 0]
                table[0, node, 1] += change * table[1 + k, node, 1]
            turn[0, 0] += change * turn[0, 1 + k]
            turn[1, 0] += change * turn[1, 1 + k]


def tabulated(x: Vector, anchor: Vector, reference: float, active: Ints) -> tuple[Table, Matrix]:
    """The table and the turn that `tabulate_state` fills, in new arrays.

    Kernels get these arrays from Python, because a kernel that calls `tabulate_state` contains a copy of its
    machine code, which takes long to compile.
    """
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate_state(x, anchor, reference, active, table, turn)
    return table, turn


@kernel
def linearise(
    x: Vector,
    side: float,
    active: Ints,
    table: Table,
    tau: Vector,
    deflection: Vector,
    residual: Vector,
    jacobian: Matrix,
) -> None:
    """Residuals of all samples, and derivatives of the model with respect to the active entries of the state.

    With the time tau since the reference time, the phase s = (tau - TIME) RATE, the tabulated waveform y(s)
    and the amplitude A, the model is

        CENTRE + DRIFT tau + side A y(s)
            + exp(-FAST_DAMPING tau) [FAST_COSINE cos(FAST_RATE tau) + FAST_SINE sin(FAST_RATE tau)]

    y is interpolated between the table's nodes by cubic Hermite polynomials from values and slopes.

    A sample outside the table (more than a third of a period before or half a period after the turning point)
    gets the residual NaN and is ignored by `normal_equations`. `residual` and `jacobian` are overwritten.
    """
    amplitude, rate = x[AMPLITUDE], x[RATE]
    signed = side * amplitude
    y_shape = np.empty(SHAPES)
    has_fast_mode = False
    for entry in active:
        has_fast_mode |= entry >= FAST_COSINE
    for i in range(len(tau)):
        s = (tau[i] - x[TIME]) * rate
        node, f = locate(s)
        if node < 0:
            residual[i] = math.nan
            continue
        # before the turning point the nodes of the table are in order of falling phase
        h = STEP if node >= NODES_BEFORE else -STEP
        g = 1.0 - f
        h00, h10 = (1.0 + 2.0 * f) * g * g, f * g * g * h
        h01, h11 = f * f * (3.0 - 2.0 * f), -f * f * g * h
        y0, v0, y1, v1 = table[0, node, 0], table[0, node, 1], table[0, node + 1, 0], table[0, node + 1, 1]
        y = h00 * y0 + h10 * v0 + h01 * y1 + h11 * v1
        v = 6.0 * f * g * (y1 - y0) / h + g * (1.0 - 3.0 * f) * v0 + f * (3.0 * f - 2.0) * v1
        for entry in active:
            if SHAPE <= entry < SHAPE + SHAPES:
                row = table[1 + entry - SHAPE]
                y_shape[entry - SHAPE] = (
                    h00 * row[node, 0] + h10 * row[node, 1] + h01 * row[node + 1, 0] + h11 * row[node + 1, 1]
                )
        # d(A y)/dA = y + dy/d(ln r), since ln r = ln(A/reference)
        row = table[1 + LOG_RATIO]
        amplitude_derivative = (
            y + h00 * row[node, 0] + h10 * row[node, 1] + h01 * row[node + 1, 0] + h11 * row[node + 1, 1]
        )
        model = x[CENTRE] + x[DRIFT] * tau[i] + signed * y
        cosine = sine = 0.0
        if has_fast_mode:
            decay = math.exp(-x[FAST_DAMPING] * tau[i])
            cosine = decay * math.cos(x[FAST_RATE] * tau[i])
            sine = decay * math.sin(x[FAST_RATE] * tau[i])
            model += x[FAST_COSINE] * cosine + x[FAST_SINE] * sine
        residual[i] = deflection[i] - model
        for n, entry in enumerate(active):
            if entry == AMPLITUDE:
                value = side * amplitude_derivative
            elif entry == TIME:
                value = -signed * v * rate
            elif entry == RATE:
                value = signed * v * (tau[i] - x[TIME])
            elif entry < CENTRE:
                value = signed * y_shape[entry - SHAPE]
            elif entry == CENTRE:
                value = 1.0
            elif entry == DRIFT:
                value = tau[i]
            elif entry == FAST_COSINE:
                value = cosine
            elif entry == FAST_SINE:
                value = sine
            elif entry == FAST_RATE:
                value = tau[i] * (x[FAST_SINE] * cosine - x[FAST_COSINE] * sine)
            else:
                value = -tau[i] * (x[FAST_COSINE] * cosine + x[FAST_SINE] * sine)
            jacobian[i, n] = value


@kernel
def normal_equations(
    residual: Vector, jacobian: Matrix, weight: Vector, information: Matrix, score: Vector
) -> tuple[float, int]:
    """Information matrix J^T W J and score J^T W r; returns chi-square r^T W r and the number of samples.

    Samples with the weight 0 or the residual NaN are ignored.
    """
    n = len(score)
    information[:] = 0.0
    score[:] = 0.0
    total, count = 0.0, 0
    for i in range(len(residual)):
        if weight[i] > 0.0 and residual[i] == residual[i]:
            count += 1
            total += weight[i] * residual[i] * residual[i]
            for j in range(n):
                weighted = weight[i] * jacobian[i, j]
                score[j] += weighted * residual[i]
                for k in range(j + 1):
                    information[j, k] += weighted * jacobian[i, k]
    for j in range(n):
        for k in range(j):
            information[k, j] = information[j, k]
    return total, count


@kernel
def propagate(x: Vector, turn: Matrix, elapsed: float) -> tuple[Vector, Matrix]:
    """State at the next turning point, and the transition matrix: its derivatives by the present state.

    The next reference time is `elapsed` s after the present one. With the phase s' of the next turning point
    and the remaining fraction a of the amplitude (`turn` of `waveform.tabulate`)

        A' = a A,   TIME' = TIME + s'/RATE - elapsed,   CENTRE' = CENTRE + DRIFT elapsed,

    and the phasor of the fast mode is rotated by its phase FAST_RATE elapsed and damped. A negative `elapsed`
    is allowed for centre and fast mode.
    """
    next_state = x.copy()
    transition = np.zeros((STATES, STATES))
    for k in range(STATES):
        transition[k, k] = 1.0
    rate = x[RATE]
    next_state[AMPLITUDE] = x[AMPLITUDE] * turn[1, 0]
    next_state[TIME] = x[TIME] + turn[0, 0] / rate - elapsed
    transition[AMPLITUDE, AMPLITUDE] = turn[1, 0]
    transition[TIME, RATE] = -turn[0, 0] / (rate * rate)
    transition[AMPLITUDE, AMPLITUDE] += turn[1, 1 + LOG_RATIO]
    transition[TIME, AMPLITUDE] = turn[0, 1 + LOG_RATIO] / (rate * x[AMPLITUDE])
    for k in range(SHAPES):
        if turn[0, 1 + k] == turn[0, 1 + k]:
            transition[AMPLITUDE, SHAPE + k] = x[AMPLITUDE] * turn[1, 1 + k]
            transition[TIME, SHAPE + k] = turn[0, 1 + k] / rate
    next_state[CENTRE] = x[CENTRE] + x[DRIFT] * elapsed
    transition[CENTRE, DRIFT] = elapsed
    decay = math.exp(-x[FAST_DAMPING] * elapsed)
    cosine, sine = decay * math.cos(x[FAST_RATE] * elapsed), decay * math.sin(x[FAST_RATE] * elapsed)
    next_state[FAST_COSINE] = x[FAST_COSINE] * cosine + x[FAST_SINE] * sine
    next_state[FAST_SINE] = x[FAST_SINE] * cosine - x[FAST_COSINE] * sine
    transition[FAST_COSINE, FAST_COSINE] = transition[FAST_SINE, FAST_SINE] = cosine
    transition[FAST_COSINE, FAST_SINE], transition[FAST_SINE, FAST_COSINE] = sine, -sine
    transition[FAST_COSINE, FAST_RATE] = elapsed * next_state[FAST_SINE]
    transition[FAST_SINE, FAST_RATE] = -elapsed * next_state[FAST_COSINE]
    transition[FAST_COSINE, FAST_DAMPING] = -elapsed * next_state[FAST_COSINE]
    transition[FAST_SINE, FAST_DAMPING] = -elapsed * next_state[FAST_SINE]
    return next_state, transition
