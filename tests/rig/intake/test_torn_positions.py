"""Tears in a trajectory are found, and none in swings with noise."""

import numpy as np
import pytest

from rig.intake.film import broken_positions


def swing(
    seed: int, noise_px: float, per_period: float = 50.0, count: int = 1500
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    k = np.arange(count)
    time_s = (k + 0.2 * rng.uniform(-1.0, 1.0, count)) / 30.0
    x = 60.0 * np.exp(-k / 500.0) * np.sin(2.0 * np.pi * 30.0 * time_s / per_period)
    return time_s, np.column_stack([x, 0.1 * x]) + noise_px * rng.standard_normal((count, 2))


@pytest.mark.slow
@pytest.mark.parametrize("noise_px", [0.0, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("per_period", [12.0, 50.0, 300.0])
def test_swings_have_none(noise_px: float, per_period: float) -> None:
    for seed in range(2):
        assert broken_positions(*swing(seed, noise_px, per_period)) == []


def test_a_single_tear_and_a_stretch_are_found_once_each_where_they_begin() -> None:
    time_s, places = swing(1, 0.02)
    places[700, 0] += 0.8
    places[1200:1214, 1] -= 1.2
    found = broken_positions(time_s, places)
    assert [min((700, 1200, 1214), key=lambda one: abs(one - at)) for at in found] == [700, 1200, 1214]
    assert all(min(abs(at - one) for one in (700, 1200, 1214)) <= 3 for at in found)


def test_lost_positions_and_short_films_tear_nothing() -> None:
    time_s, places = swing(2, 0.02)
    places[300:310] = np.nan
    assert broken_positions(time_s, places) == []
    assert broken_positions(time_s, np.full_like(places, np.nan)) == []
    assert broken_positions(time_s[:8], places[:8]) == []
