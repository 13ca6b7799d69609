"""Calibration made from simulated records alone, then a measurement whose budget covers the truth."""

from pathlib import Path

import numpy as np
import pytest

from tests.rig.calibrated_measurement import measure


@pytest.mark.slow
def test_parameters_cover_the_truth_with_the_calibration_included(tmp_path: Path) -> None:
    deviations = []
    for seed in range(8):
        found = measure(seed, tmp_path / str(seed))
        deviations.append([(value - truth) / u for value, u, truth in found.values()])
    # of 56 normal deviations none beyond 4 standard uncertainties (probability 4e-3)
    assert np.abs(np.array(deviations)).max() < 4.0
