"""The budget of a measurement with simulated calibrations covers the true values."""

from pathlib import Path

import numpy as np
import pytest

from tests.rig.calibrate.calibrated_measurement import measure

SEEDS = 20


@pytest.mark.slow
def test_parameters_cover_the_truth_with_the_calibration_included(tmp_path: Path) -> None:
    """20 seeds at two frame rates, more than a second each; 400 and more are in the benchmark."""
    rows = []
    for seed in range(SEEDS):
        found = measure(9000 + seed, tmp_path / str(seed), rate_hz=(25.0, 60.0)[seed % 2])
        rows.append([(value - truth) / u for value, u, truth in found.values()])
    z = np.array(rows)
    # 3.5 standard deviations of the mean, the root mean square and the share of 20 unit deviates
    assert np.abs(z.mean(axis=0)).max() < 3.5 / np.sqrt(SEEDS)
    assert np.abs(np.sqrt(np.mean(z**2, axis=0)) - 1.0).max() < 3.5 / np.sqrt(2.0 * SEEDS)
    inside = np.mean(np.abs(z) < 1.0, axis=0)
    assert np.abs(inside - 0.6827).max() < 3.5 * np.sqrt(0.6827 * 0.3173 / SEEDS)
    assert np.abs(z).max() < 4.5
