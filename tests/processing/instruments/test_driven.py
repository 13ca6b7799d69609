"""Pendulums of degrees on a ground that moves: scatter of what is reported against what is stated."""

from collections.abc import Callable

import numpy as np
import pytest

from processing.estimate import Estimate
from processing.instruments.damping_fit import damping, drive_step, with_drive
from processing.instruments.descriptions import DEGREE_RAD
from processing.instruments.friction_law import herbert_hardness
from processing.swing import TurningPoints

PERIOD_S, RATE, HALVES = 1.4, 0.01, 160
U_RAD = 2e-6


def driven(step_rad: float, seed: int) -> TurningPoints:
    """A linearly damped oscillator that is kicked once in every half-swing, integrated as such."""
    rng = np.random.default_rng([seed, 3])
    omega, dt = 2 * np.pi / PERIOD_S, 0.5 * PERIOD_S
    state = 7 * DEGREE_RAD + 0j  # x + i x'/omega, in the frame that turns
    turns = [state]
    for _ in range(HALVES):
        state = state * np.exp(-RATE) + step_rad * complex(*rng.standard_normal(2))
        turns.append(state)
    seen = np.array(turns)
    u_time_s = U_RAD / np.abs(seen) / omega
    return TurningPoints(
        np.arange(HALVES + 1),
        dt * np.arange(HALVES + 1) - np.angle(seen) / omega + u_time_s * rng.standard_normal(HALVES + 1),
        u_time_s,
        np.abs(seen) + U_RAD * rng.standard_normal(HALVES + 1),
        np.full(HALVES + 1, U_RAD),
    )


def test_the_drive_is_seen_where_there_is_one() -> None:
    found = [drive_step(driven(4e-6, seed)) for seed in range(30)]
    assert np.median(found) == pytest.approx(4e-6, rel=0.1)
    # the differences overlap: one u of their mean counts as two, and noise as a drive in one decay of sixteen
    assert 0.005 < np.mean([drive_step(driven(0.0, seed)) > 0 for seed in range(100)]) < 0.13


def damping_time(points: TurningPoints) -> Estimate:
    return with_drive(lambda at: damping(at, 6 * DEGREE_RAD, 3 * DEGREE_RAD), points).time_s


def ten_swings(points: TurningPoints) -> Estimate:
    return with_drive(herbert_hardness, points).ten_swings_s


@pytest.mark.parametrize("reduce", [damping_time, ten_swings])
def test_results_scatter_as_stated(reduce: Callable[[TurningPoints], Estimate]) -> None:
    found = [reduce(driven(2e-5, seed)) for seed in range(60)]
    value = np.array([one.value for one in found])
    u = np.array([one.standard_uncertainty for one in found])
    # 60 values know a standard deviation to 9 %
    assert np.std(value) / np.median(u) == pytest.approx(1.0, abs=0.25)


def test_at_rest_nothing_changes() -> None:
    points = driven(0.0, 1)
    assert damping_time(points) == damping(points, 6 * DEGREE_RAD, 3 * DEGREE_RAD).time_s
