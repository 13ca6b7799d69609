"""The budget of a measurement with simulated calibrations covers the true values."""

from pathlib import Path

import numpy as np
import pytest

from tests.rig.prepare.calibrated_measurement import measure

SEEDS = 4


@pytest.mark.slow
def test_parameters_cover_the_truth_with_the_calibration_included(tmp_path: Path) -> None:
    """Four seeds at two frame rates, more than a second each; 400 and more are in the benchmark."""
    rows = []
    for seed in range(SEEDS):
        found = measure(9000 + seed, tmp_path / str(seed), rate_hz=(25.0, 60.0)[seed % 2])
        rows.append([(value - truth) / u for value, u, truth in found.values()])
    z = np.array(rows)
    # four standard deviations of the mean and of the root mean square of so many unit deviates
    assert np.abs(z.mean(axis=0)).max() < 4.0 / np.sqrt(SEEDS)
    assert np.abs(np.sqrt(np.mean(z**2, axis=0)) - 1.0).max() < 4.0 / np.sqrt(2.0 * SEEDS)
    assert np.abs(z).max() < 4.5
