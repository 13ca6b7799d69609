"""The axes of the trajectory follow its extent, in live runs, records and replays."""

from pathlib import Path

import numpy as np
import pytest

from rig.view.graticule import PLANE_REACH
from tests.rig.view.rrd_contents import column
from tests.rig.view.scene import drawing_into

PERIOD_S = 4.0


def reaches(rrd: Path) -> tuple[np.ndarray, np.ndarray]:
    """When the axes were drawn again, and how far they reached from then on."""
    times_s, scales = column(rrd, "/lissajous/equal/trajectory", "Transform3D:scale")
    return times_s, np.array([PLANE_REACH / scale[0][0] for scale in scales])


def draw(rrd: Path, block: int, amplitude: float, centre: float = 0.0, tau_s: float = 60.0) -> None:
    time_s = np.arange(0, 200, 0.02)
    y = centre + amplitude * np.exp(-time_s / tau_s) * np.cos(2 * np.pi * time_s / PERIOD_S)
    with drawing_into(rrd, amplitude=amplitude, period_s=PERIOD_S) as drawing:
        for first in range(0, len(time_s), block):
            part = slice(first, first + block)
            none = np.zeros(len(time_s[part]), dtype=np.int64)
            drawing.samples("", time_s[part], 0 * y[part], y[part], none)


@pytest.mark.parametrize("block", [8, 1024])
def test_they_step_down_with_the_amplitude_whatever_the_blocks(tmp_path: Path, block: int) -> None:
    rrd = tmp_path / "decay.rrd"
    draw(rrd, block, 120.0)
    times_s, reach = reaches(rrd)
    np.testing.assert_allclose(reach, [150.0, 100.0, 70.0, 50.0, 30.0, 20.0, 15.0, 10.0, 7.0][: len(reach)])
    assert len(reach) >= 8
    # each step comes when two periods stay within nine tenths of it: a half-cycle and a block later
    expected_s = 60.0 * np.log(120.0 / (0.9 * reach[1:]))
    late_s = times_s[1:] - expected_s
    assert np.all(late_s > -block * 0.02 - PERIOD_S)
    assert np.all(late_s < 2.5 * PERIOD_S + 2 * block * 0.02)


def test_they_hold_a_trajectory_that_rests_far_from_zero(tmp_path: Path) -> None:
    rrd = tmp_path / "rest.rrd"
    draw(rrd, 64, 20.0, centre=40.0)
    _, reach = reaches(rrd)
    # drawn for 20 arcsec at first; what swings from 20 to 60, and rests at 40, needs more
    np.testing.assert_allclose(reach, [30.0, 70.0, 50.0], rtol=1e-6)


def test_they_grow_with_a_release(tmp_path: Path) -> None:
    rrd = tmp_path / "release.rrd"
    time_s = np.arange(0, 40, 0.02)
    y = np.where(time_s < 20, 0.1, 100 * np.cos(2 * np.pi * (time_s - 20) / PERIOD_S))
    with drawing_into(rrd, amplitude=120.0, period_s=PERIOD_S) as drawing:
        for first in range(0, len(time_s), 50):
            part = slice(first, first + 50)
            none = np.zeros(len(y[part]), dtype=np.int64)
            drawing.samples("", time_s[part], 0 * y[part], y[part], none)
    times_s, reach = reaches(rrd)
    assert reach.min() < 1.0
    assert reach[-1] == pytest.approx(150.0)
    assert times_s[-1] == pytest.approx(20.0, abs=0.1)
