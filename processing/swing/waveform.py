"""Waveform of one half-cycle of a damped, slightly anharmonic pendulum, in units of its own amplitude.

Between two turning points friction does not change its sign and the motion is smooth; at the turning points
the second derivative jumps. The table therefore starts at a turning point, with y = 1 and y' = 0. With the
phase ``s = w t``, ``y = (deflection - centre)/A``, ``r = A/A_ref`` and the Box-Cox function
``box(u, q) = (u^q - 1)/q`` (Box and Cox 1964; the logarithm at q = 0), the equation of motion is

    y'' = -y - 2 damping y' - sign(y') (dry + rise box(r |y|, p))/r
          + y (stiff box(r |y|, n) + (bend - stiff n) (box(r |y|, 1+n) - box(r |y|, n)))

At the reference amplitude `dry` and `rise` are thus the friction and its slope, `stiff` and `bend` the slope
and curvature of the stiffness, as functions of ln r. The exponents p and n enter only in the next order,
which keeps a fit to few half-cycles well conditioned. The form includes a friction moment ``c + b |phi|^p``
and a stiffness ``|phi|^n (1 - const |phi|)`` exactly; with all terms but the damping zero it gives the damped
sinusoid.
"""

import math

import numpy as np

from processing.arrays import Floats, Ints, Matrix, Vector
from processing.kernel import kernel
from processing.swing.small_matrices import copy

DAMPING, DRY, RISE, P, STIFF, N, BEND, LOG_RATIO = range(8)
"""Indices of the terms. LOG_RATIO is ln r; it follows from the amplitude and is not fitted."""
SHAPES = 7
"""Number of terms that are fitted."""
STEP = 1.0 / 16.0
"""Spacing of the table's nodes in phase, rad."""
NODES_BEFORE = 35
"""Number of nodes before the turning point, to -2.1 rad."""
NODES_AFTER = 57
"""Number of nodes from the turning point on, to 3.5 rad, beyond the next turning point."""
NODES = NODES_BEFORE + NODES_AFTER
_MIN_EXPONENT = 1e-3
"""Exponent of the Box-Cox function below which its series replaces it."""
_MIN_Y = 1e-9
"""Smallest |y| in logarithms, which diverge at y = 0."""
_MIN_Y_OF_SLOPE = 1e-2
"""Smallest |y| in slopes of the forces, which diverge at y = 0."""
Table = Floats
"""(2 + SHAPES, NODES, 2): y and dy/ds in row 0, their derivatives with respect to the terms and ln r in the
rows after."""


@kernel
def _box(logarithm: float, power: float, exponent: float) -> tuple[float, float]:
    """Box-Cox function ``(u^q - 1)/q``, and its derivative with respect to q, from ln u and u^q."""
    if abs(exponent) < _MIN_EXPONENT:
        square = logarithm * logarithm
        return logarithm + 0.5 * exponent * square, square * (0.5 + exponent * logarithm / 3.0)
    box = (power - 1.0) / exponent
    return box, (logarithm * power - box) / exponent


@kernel
def _acceleration(y: float, v: float, sense: float, shape: Vector, derivatives: Vector) -> float:
    """Second derivative y''; its derivatives by the terms, ln r, y and v are written into `derivatives`.

    `sense` is +1 after the turning point, and -1 before it, where the integration runs backwards in time.
    v = dy/ds is negative after the turning point, so that friction adds to y''. The derivatives with respect
    to ln r and y follow from d box(u, q)/d ln u = u^q with u = r |y|.
    """
    derivatives[DAMPING] = -2.0 * sense * v
    derivatives[SHAPES + 1] = -1.0
    derivatives[SHAPES + 2] = -2.0 * sense * shape[DAMPING]
    force = -y + derivatives[SHAPES + 2] * v
    limited_y = math.copysign(max(abs(y), _MIN_Y), y)
    ratio = math.exp(shape[LOG_RATIO])
    logarithm = math.log(abs(limited_y)) + shape[LOG_RATIO]
    power = math.exp(shape[N] * logarithm)
    higher = power * abs(limited_y) * ratio
    box, box_n = _box(logarithm, power, shape[N])
    next_box, next_box_n = _box(logarithm, higher, 1.0 + shape[N])
    curve = shape[BEND] - shape[N] * shape[STIFF]
    stiffening = shape[STIFF] * box + curve * (next_box - box)
    stiffening_slope = shape[STIFF] * power + curve * (higher - power)
    friction_power = math.exp(shape[P] * logarithm)
    friction_box, friction_box_p = _box(logarithm, friction_power, shape[P])
    sense_over_ratio = sense / ratio
    friction = sense_over_ratio * (shape[DRY] + shape[RISE] * friction_box)
    friction_slope = sense_over_ratio * shape[RISE] * friction_power
    derivatives[DRY] = sense_over_ratio
    derivatives[RISE] = sense_over_ratio * friction_box
    derivatives[P] = sense_over_ratio * shape[RISE] * friction_box_p
    derivatives[STIFF] = y * (box - shape[N] * (next_box - box))
    derivatives[N] = y * (shape[STIFF] * (box_n - next_box + box) + curve * (next_box_n - box_n))
    derivatives[BEND] = y * (next_box - box)
    derivatives[LOG_RATIO] = y * stiffening_slope + friction_slope - friction
    derivatives[SHAPES + 1] += (
        stiffening + stiffening_slope + friction_slope / math.copysign(max(abs(y), _MIN_Y_OF_SLOPE), y)
    )
    return float(force + y * stiffening + friction)


@kernel
def _add_weighted(motion: Matrix, rates: Floats, h: float, row: int) -> None:
    """Move a row of `motion` by the weighted mean of the rates of the four stages."""
    for column in range(2):
        middle_stages = rates[1, row, column] + rates[2, row, column]
        motion[row, column] += h / 6.0 * (rates[0, row, column] + 2.0 * middle_stages + rates[3, row, column])


@kernel
def _step(motion: Matrix, sense: float, shape: Vector, terms: Ints, h: float, rates: Floats) -> None:
    """One step of the classical Runge-Kutta method of order four, for `motion` (2 + SHAPES, 2).

    Row 0 holds y and v; row 1 + k holds their derivatives with respect to term k, which obey the variational
    equation

        dy_k'' = df/dp_k + (df/dy) dy_k + (df/dv) dv_k,   y'' = f(y, v, p).

    `rates` (5, SHAPES + 3, 2) is working memory.
    """
    derivatives = rates[4, :, 0]
    y, v = motion[0, 0], motion[0, 1]
    for stage in range(4):
        step = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
        last = max(stage - 1, 0)
        stage_y, stage_v = y + step * rates[last, 0, 0], v + step * rates[last, 0, 1]
        if stage == 0:
            stage_y, stage_v = y, v
        rates[stage, 0, 0] = stage_v
        rates[stage, 0, 1] = _acceleration(stage_y, stage_v, sense, shape, derivatives)
        for k in terms:
            shift, shift_v = motion[1 + k, 0], motion[1 + k, 1]
            if stage > 0:
                shift += step * rates[last, 1 + k, 0]
                shift_v += step * rates[last, 1 + k, 1]
            rates[stage, 1 + k, 0] = shift_v
            rates[stage, 1 + k, 1] = (
                derivatives[k] + derivatives[SHAPES + 1] * shift + derivatives[SHAPES + 2] * shift_v
            )
    _add_weighted(motion, rates, h, 0)
    for k in terms:
        _add_weighted(motion, rates, h, 1 + k)


@kernel
def _step_on_grid(
    motion: Matrix, start: Matrix, sense: float, shape: Vector, terms: Ints, rates: Floats
) -> None:
    """One step of the table; `start` becomes a copy of `motion` before the step.

    The powers of |y| are not smooth at y = 0. A step that crosses zero is therefore divided there, with the
    crossing found by Newton's method; otherwise the Runge-Kutta method would lose its order.
    """
    copy(motion, start)
    _step(motion, sense, shape, terms, STEP, rates)
    if start[0, 0] > 0.0 > motion[0, 0]:
        fraction = STEP * start[0, 0] / (start[0, 0] - motion[0, 0])
        for _ in range(3):
            motion[0, 0], motion[0, 1] = start[0, 0], start[0, 1]
            _step(motion, sense, shape, terms[:0], fraction, rates)
            fraction -= motion[0, 0] / motion[0, 1]
        copy(start, motion)
        _step(motion, sense, shape, terms, fraction, rates)
        motion[0, 0] = -0.0
        _step(motion, sense, shape, terms, STEP - fraction, rates)


@kernel
def tabulate(shape: Vector, terms: Ints, table: Table, turn: Matrix) -> None:
    """Tabulate the waveform and its derivatives with respect to some terms.

    Parameters
    ----------
    shape : (SHAPES + 1,) terms and ln r
    terms : indices of the terms; the rows of the others are not changed
    table : (2 + SHAPES, NODES, 2), overwritten
    turn : (2, 2 + SHAPES), overwritten: phase of the next turning point and remaining fraction of the
        amplitude, each followed by its derivatives; NaN for the other terms
    """
    motion = np.zeros((2 + SHAPES, 2))
    start = np.empty((2 + SHAPES, 2))
    turning = np.empty((2 + SHAPES, 2))
    rates = np.empty((5, SHAPES + 3, 2))
    motion[0, 0] = 1.0
    # before the turning point the integration runs backwards in time, which reverses friction and damping
    for node in range(NODES_BEFORE):
        table[0, node, 0], table[0, node, 1] = motion[0, 0], -motion[0, 1]
        for k in terms:
            table[1 + k, node, 0], table[1 + k, node, 1] = motion[1 + k, 0], -motion[1 + k, 1]
        _step_on_grid(motion, start, -1.0, shape, terms, rates)
    motion[:] = 0.0
    motion[0, 0] = 1.0
    turn[:] = math.nan
    derivatives = rates[4, :, 0]
    for step in range(NODES_AFTER):
        node = NODES_BEFORE + step
        table[0, node, 0], table[0, node, 1] = motion[0, 0], motion[0, 1]
        for k in terms:
            table[1 + k, node, 0], table[1 + k, node, 1] = motion[1 + k, 0], motion[1 + k, 1]
        _step_on_grid(motion, start, 1.0, shape, terms, rates)
        if step > 1 and start[0, 1] < 0.0 <= motion[0, 1]:
            # y' changes its sign within this step: Newton's method for the turning point, then its
            # derivatives from d(y')/dp + y'' ds/dp = 0
            fraction = 0.5 * STEP
            copy(start, turning)
            for _ in range(3):
                turning[0, 0], turning[0, 1] = start[0, 0], start[0, 1]
                _step(turning, 1.0, shape, terms[:0], fraction, rates)
                fraction -= turning[0, 1] / _acceleration(
                    turning[0, 0], turning[0, 1], 1.0, shape, derivatives
                )
            copy(start, turning)
            _step(turning, 1.0, shape, terms, fraction, rates)
            rate = _acceleration(turning[0, 0], turning[0, 1], 1.0, shape, derivatives)
            turn[0, 0], turn[1, 0] = step * STEP + fraction, -turning[0, 0]
            for k in terms:
                turn[0, 1 + k] = -turning[1 + k, 1] / rate
                turn[1, 1 + k] = -turning[1 + k, 0]


@kernel
def locate(s: float) -> tuple[int, float]:
    """First of the two nodes around phase `s`, position between them (0 to 1); node -1 outside the table.

    A NaN or infinite phase, of a fit that diverges, is outside, too: it cannot be converted to a node.
    """
    if 0.0 <= s < (NODES_AFTER - 1) * STEP:
        cell = int(s / STEP)
        return NODES_BEFORE + cell, s / STEP - cell
    if 0.0 < -s < (NODES_BEFORE - 1) * STEP:
        cell = int(-s / STEP)
        return cell, -s / STEP - cell
    return -1, 0.0


@kernel
def zero_phases(table: Table) -> tuple[float, float]:
    """Phases of the zero crossings before (negative) and after the turning point; NaN if not in the table."""
    before, after = math.nan, math.nan
    for k in range(NODES_BEFORE - 1):
        if table[0, k, 0] > 0.0 >= table[0, k + 1, 0]:
            before = -(k + table[0, k, 0] / (table[0, k, 0] - table[0, k + 1, 0])) * STEP
            break
    for k in range(NODES_BEFORE, NODES_BEFORE + NODES_AFTER - 1):
        if table[0, k, 0] > 0.0 >= table[0, k + 1, 0]:
            after = (k - NODES_BEFORE + table[0, k, 0] / (table[0, k, 0] - table[0, k + 1, 0])) * STEP
            break
    return before, after
