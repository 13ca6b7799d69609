"""Curves are broken where there is nothing for long, within a block of values and between two."""

from pathlib import Path

import numpy as np
import pytest

from processing.spot import SpotFlag
from tests.rig.view.rrd_contents import measured, scalars
from tests.rig.view.scene import drawing_into


def test_a_curve_does_not_cross_what_was_not_measured(tmp_path: Path) -> None:
    path = tmp_path / "gaps.rrd"
    time_s = np.concatenate([np.arange(0, 5, 0.02), np.arange(30, 35, 0.02)])
    flags = np.zeros(len(time_s), dtype=np.int64)
    with drawing_into(path, period_s=4.0) as drawing:
        for part in (slice(0, 400), slice(400, None)):
            drawing.samples("", time_s[part], np.sin(time_s[part]), np.cos(time_s[part]), flags[part])
        for at_s in (17.0, 21.0, 953.0, 957.0):
            drawing.balance("", at_s, {"period_ratio": (3.0, 0.1)})
    at, x = scalars(path, "/deflection/x")
    assert at[np.isnan(x)].tolist() == [0.5 * (time_s[249] + time_s[250])]
    assert np.isfinite(x).sum() == len(time_s)
    at, ratio, _ = measured(path, "/balance/period_ratio")
    assert at[np.isnan(ratio)] == pytest.approx([487.0])


def test_samples_are_thinned_whatever_the_model_of_the_beam(tmp_path: Path) -> None:
    """A flag that every spot of a run has would have every sample drawn."""
    path = tmp_path / "run.rrd"
    with drawing_into(path) as drawing:
        time_s = np.arange(500) / 500
        drawing.samples("", time_s, np.sin(time_s), np.cos(time_s), np.full(500, SpotFlag.LEARNED))
    assert len(scalars(path, "/deflection/x")[0]) == 100
