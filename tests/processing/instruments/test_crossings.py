"""Turning points outside the sensor are inferred from crossings and agree with the simulator's."""

import math
from dataclasses import replace

import numpy as np
import pytest

from processing.instruments.crossings import inferred_half_cycles, joined_half_cycles
from processing.instruments.damping_fit import damping
from processing.instruments.descriptions import DEGREE_RAD
from processing.instruments.turning import refined_turning_points
from processing.swing import HalfCycle, HalfCycleFlag, TurningPoints, half_cycles_of, turning_points
from tests.processing.instruments.simulated_instruments import (
    Samples,
    samples,
    simulation,
    true_time_s,
    truth_points,
)
from tests.processing.swing.truth import half_cycle


def seen(found: Samples, limit_deg: float, rest_rad: float = 0.0) -> np.ndarray:
    """What a sensor of this half width sees."""
    place = found.y_rad + rest_rad
    return np.where(np.abs(place) < limit_deg * DEGREE_RAD, place, np.nan)


def points(half_cycles: list[HalfCycle]) -> TurningPoints:
    return turning_points([replace(h, flags=0) for h in half_cycles])


@pytest.mark.parametrize(("kind", "limit_deg"), [("koenig", 2.0), ("persoz", 3.0)])
@pytest.mark.parametrize("rest_rad", [0.0, 0.002])
def test_amplitudes_off_the_sensor(kind: str, limit_deg: float, rest_rad: float) -> None:
    settings = simulation(kind)
    truth = truth_points(settings, 1.1 * limit_deg)
    found = samples(settings, 1.1 * limit_deg, seed=1, noise_rad=1e-5)
    half_cycles = inferred_half_cycles(found.times_ns, seen(found, limit_deg, rest_rad), found.u_rad)
    assert len(half_cycles) > 0.9 * len(truth.time_s)
    assert all(h.flags == HalfCycleFlag.INFERRED for h in half_cycles)
    time_s = np.array([h.turn_time_ns * 1e-9 for h in half_cycles])
    matched = [int(np.argmin(np.abs(truth.time_s - t))) for t in time_s]
    assert len({m - h.index for m, h in zip(matched, half_cycles, strict=True)}) == 1
    size = np.array([h.amplitude for h in half_cycles])
    pull = (size - np.abs(truth.angle_rad[matched])) / np.array([h.u_amplitude for h in half_cycles])
    # friction, rolling and the polynomial together stay below a third of the noise of one crossing
    assert abs(np.mean(pull)) < 0.4
    assert 0.7 < np.std(pull) < 1.2
    late = (time_s - truth.time_s[matched]) / np.array([h.u_turn_time_s for h in half_cycles])
    # how early the turning point comes depends on the friction: up to one uncertainty, for all alike
    assert np.max(np.abs(late)) < 4
    assert half_cycles[0].centre == pytest.approx(rest_rad, abs=2e-6)


@pytest.mark.slow
def test_damping_time_where_the_sensor_sees_only_the_end() -> None:
    """Six degrees are off the sensor, three on it: one count, one damping time."""
    settings = simulation("koenig")
    truth = truth_points(settings, 2.5)
    expected_s = true_time_s(truth, 3.0) - true_time_s(truth, 6.0)
    pulls = []
    for seed in range(2):
        found = samples(settings, 2.7, seed=seed, noise_rad=1e-5)
        place = seen(found, 4.0)
        half_cycles = half_cycles_of(found.times_ns, place, found.u_rad)
        here = (
            refined_turning_points(found.times_ns, place, found.u_rad, half_cycles)
            if len(half_cycles) > 1
            else []
        )
        joined = joined_half_cycles(here, inferred_half_cycles(found.times_ns, place, found.u_rad))
        assert {bool(h.flags) for h in joined} == {True, False}
        time_s = damping(points(joined), 6 * DEGREE_RAD, 3 * DEGREE_RAD).time_s
        pulls.append((time_s.value - expected_s) / time_s.standard_uncertainty)
    assert abs(np.mean(pulls)) < 4 / math.sqrt(len(pulls))


def test_nothing_is_inferred_where_all_was_seen() -> None:
    found = samples(simulation("koenig"), 4.0, seed=2, noise_rad=1e-5)
    assert inferred_half_cycles(found.times_ns, found.y_rad, found.u_rad) == []
    lost = np.full(len(found.y_rad), np.nan)
    assert inferred_half_cycles(found.times_ns, lost, found.u_rad) == []


def test_half_periods_without_any_sample_are_counted() -> None:
    """A camera that paused for five half periods: the count of swings goes on as if it had seen them."""
    settings = simulation("koenig")
    found = samples(settings, 2.2, seed=3, noise_rad=1e-5)
    truth = truth_points(settings, 2.2)
    paused_s = truth.time_s[[10, 15]]
    time_s = found.times_ns * 1e-9
    place = np.where((time_s > paused_s[0]) & (time_s < paused_s[1]), np.nan, seen(found, 2.0))
    half_cycles = inferred_half_cycles(found.times_ns, place, found.u_rad)
    nearest = [int(np.argmin(np.abs(truth.time_s - h.turn_time_ns * 1e-9))) for h in half_cycles]
    assert max(np.diff(nearest)) > 5
    np.testing.assert_array_equal(np.diff([h.index for h in half_cycles]), np.diff(nearest))


def test_one_inferred_half_cycle_replaces_its_own_and_leaves_gaps() -> None:
    recorded = [half_cycle(k, flags=int(HalfCycleFlag.GAP) if k == 4 else 0) for k in range(7)]
    joined = joined_half_cycles(
        recorded, [half_cycle(0, turn_time_ns=2_001_000_000, flags=int(HalfCycleFlag.INFERRED))]
    )
    assert [one.index for one in joined] == [0, 1, 2, 3, 5, 6]
    assert joined[1].flags == int(HalfCycleFlag.INFERRED)
