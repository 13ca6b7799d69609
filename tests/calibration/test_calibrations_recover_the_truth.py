"""Bias and coverage of every calibrated quantity; short version of the benchmark over 200 seeds."""

import numpy as np
import pytest

from tests.calibration.simulated_rig import deviations

SEEDS = 25


@pytest.fixture(scope="module")
def table() -> dict[str, list[float]]:
    rows = [deviations(5000 + seed) for seed in range(SEEDS)]
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.mark.slow
def test_no_quantity_is_biased(table: dict[str, list[float]]) -> None:
    # the mean of 25 unit deviates has the standard deviation 0.2; of 15 quantities none beyond 3.5 of it
    for name, z in table.items():
        assert abs(np.mean(z)) < 3.5 / np.sqrt(SEEDS), name


def test_every_uncertainty_is_the_scatter(table: dict[str, list[float]]) -> None:
    # the spread of 25 deviates lies within 1 +- 3.5/sqrt(48)
    for name, z in table.items():
        assert abs(np.sqrt(np.mean(np.square(z))) - 1) < 3.5 / np.sqrt(2 * (SEEDS - 1)), name
    # 375 intervals together: 0.6827 +- 4 standard deviations of the share
    inside = np.mean(np.abs(np.array(list(table.values()))) < 1)
    assert abs(inside - 0.6827) < 4 * np.sqrt(0.6827 * 0.3173 / (SEEDS * len(table)))
