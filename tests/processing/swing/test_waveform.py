"""The tabulated half-swing agrees with an independent integration, its derivatives with differences."""

import math

import numpy as np
import pytest
import scipy

from processing.swing.waveform import (
    BEND,
    DAMPING,
    DRY,
    LOG_RATIO,
    NODES,
    NODES_AFTER,
    NODES_BEFORE,
    RISE,
    SHAPES,
    STEP,
    STIFF,
    N,
    P,
    locate,
    tabulate,
    zero_phases,
)

SHAPE = np.zeros(SHAPES + 1)
SHAPE[[DAMPING, DRY, RISE, P]] = 0.004, 0.006, 0.005, 0.85
SHAPE[[STIFF, N, BEND, LOG_RATIO]] = 0.003, 0.3, -0.002, -0.3
ALL = np.arange(SHAPES + 1)
NONE = ALL[:0]


def table_of(shape: np.ndarray, wanted: np.ndarray = NONE) -> tuple[np.ndarray, np.ndarray]:
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate(shape, wanted, table, turn)
    return table, turn


def acceleration(y: float, v: float, shape: np.ndarray) -> float:
    """After the turning point at +1: the velocity is negative, friction pushes upwards."""
    ratio = math.exp(shape[LOG_RATIO])
    u = abs(y) * ratio

    def box(q: float) -> float:
        return (u**q - 1.0) / q

    n = shape[N]
    stiffening = shape[STIFF] * box(n) + (shape[BEND] - n * shape[STIFF]) * (box(1.0 + n) - box(n))
    friction = (shape[DRY] + shape[RISE] * box(shape[P])) / ratio
    return -y - 2.0 * shape[DAMPING] * v + y * stiffening + friction


@pytest.mark.slow
def test_table_solves_the_equation_of_motion() -> None:
    table, turn = table_of(SHAPE)
    solution = scipy.integrate.solve_ivp(
        lambda _, state: [state[1], acceleration(state[0], state[1], SHAPE)],
        (0.0, (NODES_AFTER - 1) * STEP), [1.0, 0.0], dense_output=True, rtol=1e-11, atol=1e-13, max_step=0.05,
    )  # fmt: skip
    phase = np.arange(NODES_AFTER) * STEP
    # a fit at 250 px and 0.005 px noise must not see it: 0.5 mpx of 250 px is 2e-6
    assert np.abs(table[0, NODES_BEFORE:, 0] - solution.sol(phase)[0]).max() < 1e-6
    assert solution.sol(turn[0, 0])[1] == pytest.approx(0.0, abs=2e-6)
    assert -solution.sol(turn[0, 0])[0] == pytest.approx(turn[1, 0], abs=1e-6)


def test_before_the_turning_point_time_runs_backwards() -> None:
    """What follows a turning point, mirrored, is what comes before one with all losses turned around."""
    gaining = SHAPE.copy()
    gaining[[DAMPING, DRY, RISE]] *= -1.0
    before = table_of(SHAPE)[0][0, :NODES_BEFORE]
    after = table_of(gaining)[0][0, NODES_BEFORE : NODES_BEFORE + NODES_BEFORE]
    assert before[:, 0] == pytest.approx(after[:, 0], abs=1e-14)
    assert before[:, 1] == pytest.approx(-after[:, 1], abs=1e-14)


@pytest.mark.parametrize("term", ALL)
def test_derivatives(term: int) -> None:
    table, turn = table_of(SHAPE, ALL)
    up, down = SHAPE.copy(), SHAPE.copy()
    up[term] += 1e-4
    down[term] -= 1e-4
    (table_up, turn_up), (table_down, turn_down) = table_of(up), table_of(down)
    difference = (table_up[0] - table_down[0]) / 2e-4
    # a relative error e of a derivative costs a Gauss-Newton step e of its length: 1e-3 is plenty
    assert np.abs(table[1 + term] - difference).max() < 1e-3 * np.abs(difference).max()
    assert turn[:, 1 + term] == pytest.approx((turn_up[:, 0] - turn_down[:, 0]) / 2e-4, rel=5e-3, abs=1e-5)


def test_damping_alone_is_the_damped_sinusoid() -> None:
    shape, damping = np.zeros(SHAPES + 1), 0.05
    shape[DAMPING] = damping
    table, turn = table_of(shape)
    s, root = np.arange(NODES_AFTER) * STEP, math.sqrt(1 - damping**2)
    closed = np.exp(-damping * s) * (np.cos(root * s) + damping / root * np.sin(root * s))
    assert table[0, NODES_BEFORE:, 0] == pytest.approx(closed, abs=1e-6)
    assert turn[:, 0] == pytest.approx((math.pi / root, math.exp(-math.pi * damping / root)), abs=1e-6)


def test_zero_phases_of_the_undamped() -> None:
    table, turn = table_of(np.zeros(SHAPES + 1))
    assert zero_phases(table) == pytest.approx((-math.pi / 2.0, math.pi / 2.0), abs=1e-4)
    assert turn[:, 0] == pytest.approx((math.pi, 1.0))


@pytest.mark.parametrize(
    ("phase", "node"),
    [
        (0.0, NODES_BEFORE),
        (STEP * (NODES_AFTER - 1) - 1e-9, NODES_BEFORE + NODES_AFTER - 2),
        (STEP * (NODES_AFTER - 1), -1),
        (-1e-9, 0),
        (-STEP * (NODES_BEFORE - 1) + 1e-9, NODES_BEFORE - 2),
        (-STEP * (NODES_BEFORE - 1), -1),
        (math.nan, -1),
        (math.inf, -1),
        (-math.inf, -1),
        (1e300, -1),
        (-1e300, -1),
    ],
)
def test_a_phase_lies_between_two_nodes_or_outside_the_table(phase: float, node: int) -> None:
    found, place = locate(phase)
    assert found == node
    assert 0.0 <= place < 1.0
