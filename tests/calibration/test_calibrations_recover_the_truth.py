"""Bias and coverage of every calibrated quantity; short version of the benchmark over 600 seeds."""

import numpy as np
import pytest

from tests.calibration.simulated_rig import deviations

SEEDS = 4


@pytest.mark.slow
def test_no_quantity_is_biased_and_every_uncertainty_is_the_scatter() -> None:
    rows = [deviations(5000 + seed) for seed in range(SEEDS)]
    for name in rows[0]:
        z = np.array([row[name] for row in rows])
        # of 15 quantities none beyond 3.5 standard deviations of a mean, and of a spread
        assert abs(np.mean(z)) < 3.5 / np.sqrt(SEEDS), name
        assert abs(np.sqrt(np.mean(np.square(z))) - 1) < 3.5 / np.sqrt(2 * (SEEDS - 1)), name
    # 60 intervals together: 0.6827 +- 4 standard deviations of the share
    inside = np.mean(np.abs([list(row.values()) for row in rows]) < 1)
    assert abs(inside - 0.6827) < 4 * np.sqrt(0.6827 * 0.3173 / (SEEDS * len(rows[0])))
