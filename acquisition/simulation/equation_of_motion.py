"""Integration of the equation of motion of one mode: Eq. 4 with Eqs. 1 and 3 on the right-hand side.

    phi'' = w0^2 [ push + ground(t) - phi + kappa |phi|^(n+1) (pi/2 - (R/a) |phi|) sign(phi)
                   - (c + b |phi|^p) sign(phi') - drag phi' ]

For amplitudes of degrees, sin(phi) takes the place of phi, and the round support rolls: with
the radius r of the support and epsilon = r w0^2/g (mass and length cancel) the inertia about the point
of contact is 1 + 2 epsilon (1 - cos phi) times that at rest, whence

    [1 + 2 epsilon (1 - cos phi)] phi'' + epsilon sin(phi) phi'^2 = w0^2 [ the moments above ]

Friction changes sign at the turning points, and |phi|^p and |phi|^(n+1) have no smooth derivatives at
phi = 0. Therefore every step ends at such a point (found by Newton's method on its length) or before it, and
steps shrink geometrically towards phi = 0 and grow again after it. Steps also end at the knots of the ground.
Each is a Gauss collocation with 6 stages (order 12), whose polynomial gives the motion within the step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.smooth_series import Pieces, Stretch, stretch_at, value_after
from processing.kernel import kernel

STAGES = 6
START, LENGTH, POLYNOMIAL = 0, 1, 2
COLUMNS = POLYNOMIAL + STAGES + 2
"""Columns of a row, which is one step of the motion: start in s, length in s, then from `POLYNOMIAL` on the
coefficients of phi, in rad, as a polynomial in (t - start)/length."""
LONGEST_STEP_RAD = 0.35
"""Longest step as a phase of the oscillation; the error within a step is about 1e-10 of the amplitude."""
SHORTEST_STEP_RAD = 1e-4
"""Phase step at phi = 0; the error due to |phi|^p is then below 2e-12 of the amplitude even for p = 0.4."""

TIME, ANGLE, RATE, DIRECTION = 0, 1, 2, 3
"""Entries of a state; the direction is the sign of the velocity, 0 if friction holds the pendulum."""


class Collocation(NamedTuple):
    """Gauss nodes on (0, 1), and matrices from accelerations at the nodes to rates, angles and polynomial."""

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]
    to_rate: NDArray[np.float64]
    to_angle: NDArray[np.float64]
    to_polynomial: NDArray[np.float64]


def collocation() -> Collocation:
    """Nodes and matrices for `STAGES` stages."""
    u, w = np.polynomial.legendre.leggauss(STAGES)
    nodes = 0.5 * (u + 1.0)
    values = np.polynomial.legendre.legvander(u, STAGES)
    integrals = np.empty((STAGES, STAGES))
    integrals[:, 0] = nodes
    for k in range(1, STAGES):
        integrals[:, k] = (values[:, k + 1] - values[:, k - 1]) / (2.0 * (2 * k + 1))
    to_rate = integrals @ np.linalg.inv(values[:, :STAGES])
    to_polynomial = np.linalg.inv(np.vander(nodes, STAGES, increasing=True)).astype(np.float64)
    return Collocation(nodes, 0.5 * w, to_rate, to_rate @ to_rate, to_polynomial)


class ModeConstants(NamedTuple):
    """Constants of the equation of motion of one mode, angles in rad; see the module's docstring."""

    w0_rad_per_s: float
    b: float
    p: float
    c: float
    n: float
    kappa: float
    ball_over_contact_radius: float
    drag_s: float
    push_rad: float = 0.0
    exact: bool = False
    """Sine of the angle and a rolling support; False: Eq. 4 for small angles."""
    rolling: float = 0.0
    """epsilon, the support's radius in units of g/w0^2; used only if `exact`."""


@kernel
def _acceleration(
    angle: float, rate: float, direction: float, ground_rad: float, mode: ModeConstants
) -> float:
    size = max(abs(angle), 1e-300)
    log_size = math.log(size)
    elastic = (
        mode.kappa * math.exp(mode.n * log_size) * (0.5 * math.pi - mode.ball_over_contact_radius * size)
    )
    friction = mode.c + mode.b * math.exp(mode.p * log_size)
    if mode.exact:
        sine = math.sin(angle)
        moment = (
            mode.push_rad + ground_rad + angle * elastic - sine - friction * direction - mode.drag_s * rate
        )
        inertia = 1.0 + 4.0 * mode.rolling * math.sin(0.5 * angle) ** 2
        return (mode.w0_rad_per_s**2 * moment - mode.rolling * sine * rate * rate) / inertia
    forces = mode.push_rad + ground_rad + angle * (elastic - 1.0) - friction * direction - mode.drag_s * rate
    return mode.w0_rad_per_s**2 * forces


@kernel
def _stages(
    angle: float,
    rate: float,
    direction: float,
    length_s: float,
    stretch: Stretch,
    mode: ModeConstants,
    rule: Collocation,
    f: NDArray[np.float64],
) -> tuple[float, float]:
    """Write the accelerations at the nodes into `f`; returns angle and rate at the step's end."""
    h = length_s
    ground = np.empty(STAGES)
    for j in range(STAGES):
        ground[j] = value_after(stretch, rule.nodes[j] * h)
        f[j] = _acceleration(angle + rule.nodes[j] * h * rate, rate, direction, ground[j], mode)
    scale = mode.w0_rad_per_s**2 * (abs(angle) + abs(rate) / mode.w0_rad_per_s + abs(ground[0]))
    for _ in range(40):
        change = 0.0
        for j in range(STAGES):
            to_angle = 0.0
            to_rate = 0.0
            for k in range(STAGES):
                to_angle += rule.to_angle[j, k] * f[k]
                to_rate += rule.to_rate[j, k] * f[k]
            new = _acceleration(
                angle + h * (rule.nodes[j] * rate + h * to_angle),
                rate + h * to_rate,
                direction,
                ground[j],
                mode,
            )
            change = max(change, abs(new - f[j]))
            f[j] = new
        if change <= 4e-16 * scale:
            break
    to_angle = 0.0
    to_rate = 0.0
    for j in range(STAGES):
        to_rate += rule.weights[j] * f[j]
        to_angle += rule.weights[j] * (1.0 - rule.nodes[j]) * f[j]
    return angle + h * (rate + h * to_angle), rate + h * to_rate


@kernel
def _length_to(
    wanted: int,
    angle: float,
    rate: float,
    direction: float,
    longest_s: float,
    stretch: Stretch,
    mode: ModeConstants,
    rule: Collocation,
    f: NDArray[np.float64],
) -> float:
    """Length in s, below `longest_s`, of the step at whose end the angle (`wanted` 1) or rate (2) is zero."""
    low = 0.0
    high = longest_s
    start = angle if wanted == ANGLE else rate
    h = longest_s
    for _ in range(60):
        end_angle, end_rate = _stages(angle, rate, direction, h, stretch, mode, rule, f)
        value = end_angle if wanted == ANGLE else end_rate
        if value * start > 0.0 or (start == 0.0 and value * direction > 0.0):
            low = h
        else:
            high = h
        slope = end_rate
        if wanted == RATE:
            slope = _acceleration(end_angle, end_rate, direction, value_after(stretch, h), mode)
        new = h - value / slope if slope != 0.0 else 0.5 * (low + high)
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - h) <= 1e-15 * longest_s:
            return new
        h = new
    return h


@kernel
def direction_from_rest(angle: float, ground_rad: float, mode: ModeConstants) -> float:
    """Direction (+1, -1) in which the pendulum starts from rest; 0 if friction holds it."""
    free = _acceleration(angle, 0.0, 0.0, ground_rad, mode)
    held = free - _acceleration(angle, 0.0, 1.0, ground_rad, mode)
    if abs(free) <= held:
        return 0.0
    return 1.0 if free > 0.0 else -1.0


@kernel
def direction_at(time_s: float, angle: float, pieces: Pieces, mode: ModeConstants) -> float:
    """Direction (+1, -1) in which the pendulum starts from rest at a time; 0 if friction holds it."""
    return direction_from_rest(angle, value_after(stretch_at(pieces, time_s)[0], 0.0), mode)


@kernel
def _breaks_away(
    angle: float, longest_s: float, stretch: Stretch, mode: ModeConstants
) -> tuple[float, float]:
    """Time in s for which friction still holds a pendulum on shaking ground, and direction of its start (or
    0). The forces are tested 8 times between two knots, of which the shortest period has four.
    """
    for part in range(1, 9):
        low = longest_s * (part - 1) / 8
        high = longest_s * part / 8
        direction = direction_from_rest(angle, value_after(stretch, high), mode)
        if direction != 0.0:
            for _ in range(30):
                middle = 0.5 * (low + high)
                if direction_from_rest(angle, value_after(stretch, middle), mode) == direction:
                    high = middle
                else:
                    low = middle
            return high, direction
    return longest_s, 0.0


@kernel
def advance(
    state: NDArray[np.float64],
    stop_s: float,
    pieces: Pieces,
    mode: ModeConstants,
    rule: Collocation,
    rows: NDArray[np.float64],
    turns: NDArray[np.float64],
) -> tuple[int, int]:
    """Step until `stop_s` or until an array is full.

    `state` is (time, angle, rate, direction) and is changed in place. The steps are written to `rows`
    (m, COLUMNS), time and angle of the turning points to `turns` (k, 2); returns the numbers of both.
    A step never passes `stop_s`, nor a knot of `pieces`, which must extend to `stop_s`.
    """
    w0 = mode.w0_rad_per_s
    longest_s = LONGEST_STEP_RAD / w0
    shortest_s = SHORTEST_STEP_RAD / w0
    f = np.empty(STAGES)
    n_rows = 0
    n_turns = 0
    while n_rows < rows.shape[0] and n_turns < turns.shape[0] and state[TIME] < stop_s:
        angle = state[ANGLE]
        rate = state[RATE]
        direction = state[DIRECTION]
        row = rows[n_rows]
        row[:] = 0.0
        row[START] = state[TIME]
        row[POLYNOMIAL] = angle
        stretch, to_knot_s = stretch_at(pieces, state[TIME])
        left_s = min(stop_s - state[TIME], to_knot_s)
        if direction == 0.0:
            if to_knot_s < math.inf:
                left_s, state[DIRECTION] = _breaks_away(angle, left_s, stretch, mode)
            row[LENGTH] = left_s
            state[TIME] = stop_s if left_s == stop_s - state[TIME] else state[TIME] + left_s
            n_rows += 1
            continue
        # steps shrink geometrically towards phi = 0 and grow again after it, see the module's docstring
        inward = angle * direction < 0.0
        from_zero_s = math.atan2(w0 * abs(angle), abs(rate)) / w0
        h = min(longest_s, max(shortest_s, (0.62 if inward else 1.6) * from_zero_s))
        h = min(h, left_s)
        end_angle, end_rate = _stages(angle, rate, direction, h, stretch, mode, rule, f)
        turned = end_rate * direction <= 0.0
        crossed = inward and end_angle * angle <= 0.0
        if crossed:
            shorter = _length_to(ANGLE, angle, rate, direction, h, stretch, mode, rule, f)
            end_angle, end_rate = _stages(angle, rate, direction, shorter, stretch, mode, rule, f)
            # a crossing after a turning point within the step does not exist: friction changes sign before it
            if end_rate * direction > 0.0:
                h = shorter
                end_angle = 0.0
                turned = False
        if turned:
            h = _length_to(RATE, angle, rate, direction, h, stretch, mode, rule, f)
            end_angle, end_rate = _stages(angle, rate, direction, h, stretch, mode, rule, f)
            end_rate = 0.0
        row[LENGTH] = h
        row[POLYNOMIAL + 1] = h * rate
        # phi'' as a polynomial in theta = (t - start)/h is integrated twice: theta^k becomes
        # theta^(k+2)/((k+1)(k+2))
        for k in range(STAGES):
            total = 0.0
            for j in range(STAGES):
                total += rule.to_polynomial[k, j] * f[j]
            row[POLYNOMIAL + 2 + k] = h * h * total / ((k + 1) * (k + 2))
        n_rows += 1
        state[TIME] += h
        state[ANGLE] = end_angle
        state[RATE] = end_rate
        if turned:
            turns[n_turns, 0] = state[TIME]
            turns[n_turns, 1] = end_angle
            n_turns += 1
            state[DIRECTION] = direction_from_rest(end_angle, value_after(stretch, h), mode)
    return n_rows, n_turns


@kernel
def sample(
    rows: NDArray[np.float64],
    first_row: int,
    n_rows: int,
    times_s: NDArray[np.float64],
    first: int,
    angles: NDArray[np.float64],
    rates: NDArray[np.float64],
) -> tuple[int, int]:
    """Angles (rad) and rates (rad/s) at rising times, from `times_s[first]` on, as far as the rows reach.

    Returns the last row used and the index of the first time that is beyond the rows.
    """
    row = first_row
    for i in range(first, times_s.shape[0]):
        t = times_s[i]
        while row < n_rows and t > rows[row, START] + rows[row, LENGTH]:
            row += 1
        if row == n_rows:
            return row, i
        theta = (t - rows[row, START]) / rows[row, LENGTH] if rows[row, LENGTH] > 0.0 else 0.0
        angle = 0.0
        rate = 0.0
        # Horner's rule for the polynomial and its derivative together
        for k in range(COLUMNS - 1, POLYNOMIAL - 1, -1):
            rate = rate * theta + angle
            angle = angle * theta + rows[row, k]
        angles[i] = angle
        rates[i] = rate / rows[row, LENGTH] if rows[row, LENGTH] > 0.0 else 0.0
    return row, times_s.shape[0]
