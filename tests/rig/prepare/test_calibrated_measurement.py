"""The budget of a measurement with simulated calibrations covers the true values."""

from pathlib import Path

import pytest

from tests.rig.prepare.calibrated_measurement import measure


@pytest.mark.slow
def test_parameters_cover_the_truth_with_the_calibration_included(tmp_path: Path) -> None:
    """Of one rig; the row `coverage-calibrated` of the validation has a hundred."""
    for name, (value, u, truth) in measure(9000, tmp_path).items():
        assert abs(value - truth) < 4.0 * u, name
