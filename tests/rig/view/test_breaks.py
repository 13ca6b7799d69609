"""Curves are broken where there is nothing for long, within a block of values and between two."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from processing.spot import SpotFlag
from rig.rerun.drawing import Drawing
from rig.rerun.messages import BalanceNumbers, Samples, Setup
from rig.view.viewer import Viewer
from tests.rig.view.rrd_contents import measured, scalars

SETUP = Setup(
    title="gaps",
    recording_id="gaps",
    rrd_path=None,
    layout="measuring",
    runs=("",),
    period_s=4.0,
    amplitude=100.0,
    unit="arcsec",
    port=0,
    memory_limit="1MB",
    viewer_url="",
)


def test_a_curve_does_not_cross_what_was_not_measured(tmp_path: Path) -> None:
    path = tmp_path / "gaps.rrd"
    stream = rr.RecordingStream("gaps", recording_id="gaps")
    stream.save(path)
    drawing = Drawing(stream, SETUP, gather_s=1e9, gather_rows=10**9, picture_interval_s=1.0)
    time_s = np.concatenate([np.arange(0, 5, 0.02), np.arange(30, 35, 0.02)])
    flags = np.zeros(len(time_s), dtype=np.int64)
    for part in (slice(0, 400), slice(400, None)):
        drawing.draw(Samples("", time_s[part], np.sin(time_s[part]), np.cos(time_s[part]), flags[part]))
    for at_s in (17.0, 21.0, 953.0, 957.0):
        drawing.draw(BalanceNumbers("", at_s, {"period_ratio": (3.0, 0.1)}, ""))
    drawing.send(now=True)
    stream.disconnect()
    at, x = scalars(path, "/deflection/x")
    assert at[np.isnan(x)].tolist() == [0.5 * (time_s[249] + time_s[250])]
    assert np.isfinite(x).sum() == len(time_s)
    at, ratio, _ = measured(path, "/balance/period_ratio")
    assert at[np.isnan(ratio)] == pytest.approx([487.0])


def test_samples_are_thinned_whatever_the_model_of_the_beam(tmp_path: Path) -> None:
    """A flag that every spot of a run has would have every sample drawn."""
    path = tmp_path / "run.rrd"
    with Viewer(path) as viewer:
        time_s = np.arange(500) / 500
        viewer.samples(time_s, np.sin(time_s), np.cos(time_s), np.full(500, SpotFlag.LEARNED))
    assert len(scalars(path, "/deflection/x")[0]) == 100
