"""The step to the next turning point: its derivatives are those that differences find."""

import numpy as np
import pytest

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
    tabulate_state,
)
from processing.swing.waveform import BEND, DAMPING, DRY, NODES, RISE, SHAPES, STIFF, N, P

REFERENCE = 100.0
STATE = np.zeros(STATES)
STATE[[AMPLITUDE, TIME, RATE, CENTRE, DRIFT]] = 80.0, 0.02, 1.54, 3.0, 0.01
STATE[[FAST_COSINE, FAST_SINE, FAST_RATE, FAST_DAMPING]] = 0.4, -0.7, 7.7, 0.05
for term, value in (
    (DAMPING, 0.004),
    (DRY, 0.006),
    (RISE, 0.02),
    (P, 0.85),
    (STIFF, 0.03),
    (N, 0.3),
    (BEND, 0.01),
):
    STATE[SHAPE + term] = value
ELAPSED_S = 2.03


def stepped(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate_state(x, STATE, REFERENCE, np.arange(STATES), table, turn)
    return propagate(x, turn, ELAPSED_S)


@pytest.mark.parametrize("column", range(STATES))
def test_the_transition_is_the_derivative_of_the_step(column: int) -> None:
    """One sign of it that is wrong makes every covariance of the filter wrong, and no value."""
    _, transition = stepped(STATE)
    width = 1e-5 * max(abs(STATE[column]), 1e-2)
    ahead, behind = STATE.copy(), STATE.copy()
    ahead[column] += width
    behind[column] -= width
    found = (stepped(ahead)[0] - stepped(behind)[0]) / (2 * width)
    assert found == pytest.approx(transition[:, column], rel=1e-4, abs=1e-7)
