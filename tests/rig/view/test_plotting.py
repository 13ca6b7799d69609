"""What is drawn into Rerun: breaks of curves, axes, lanes by kinds of events; the view of `rig balance`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import rerun as rr

from acquisition.camera import Frame
from acquisition.record.events import Event, EventKind
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.instrument import Block, complete, make_camera
from rig.settings import load_configuration
from rig.view import BalanceView, layout
from rig.view.graticule import PLANE_REACH
from rig.view.plotting import _STATE_COLOURS, _STATES_AFTER_EVENT, RunLanes
from tests.rig.view.replay_record import CONFIG
from tests.rig.view.rrd_contents import column, measured, scalars
from tests.rig.view.scene import plotting_into


def test_a_curve_does_not_cross_what_was_not_measured(tmp_path: Path) -> None:
    path = tmp_path / "gaps.rrd"
    time_s = np.concatenate([np.arange(0, 5, 0.02), np.arange(30, 35, 0.02)])
    flags = np.zeros(len(time_s), dtype=np.int64)
    with plotting_into(path, period_s=4.0) as plot:
        for part in (slice(0, 400), slice(400, None)):
            plot.samples(time_s[part], np.sin(time_s[part]), np.cos(time_s[part]), flags[part])
        for at_s in (17.0, 21.0, 953.0, 957.0):
            plot.balance(at_s, {"period_ratio": (3.0, 0.1)})
    at, x = scalars(path, "/deflection/x")
    assert at[np.isnan(x)].tolist() == [0.5 * (time_s[249] + time_s[250])]
    assert np.isfinite(x).sum() == len(time_s)
    at, ratio, _ = measured(path, "/balance/period_ratio")
    assert at[np.isnan(ratio)] == pytest.approx([487.0])


@pytest.mark.parametrize(("unit", "size"), [("arcsec", ARCSEC_RAD), ("px", 1.0)])
def test_the_fast_mode_is_drawn_about_the_rest_position(tmp_path: Path, unit: str, size: float) -> None:
    """A balance states the rest position in rad or px, a sample is in arcsec or px."""
    path, time_s = tmp_path / "rest.rrd", np.arange(0, 8, 0.05)
    fast = 0.5 * np.cos(9 * time_s)
    at_rest = {"line_angle_rad": (0.0, 1e-4), "rest_x": (30 * size, size), "rest_y": (-7 * size, size)}
    with plotting_into(path, unit=unit) as plot:
        y = 20 * np.cos(1.5 * time_s) - 7
        plot.samples(time_s, 30 + fast, y, np.zeros(len(time_s), dtype=np.int64))
        plot.balance(4.0, at_rest)
    at, drawn = scalars(path, layout.FAST)
    assert at == pytest.approx(time_s)
    assert drawn == pytest.approx(fast, abs=1e-6)


def test_samples_are_thinned_whatever_the_model_of_the_beam(tmp_path: Path) -> None:
    """A flag that every spot of a run has would have every sample drawn."""
    path = tmp_path / "run.rrd"
    with plotting_into(path) as plot:
        time_s = np.arange(500) / 500
        plot.samples(time_s, np.sin(time_s), np.cos(time_s), np.full(500, SpotFlag.LEARNED))
    assert len(scalars(path, "/deflection/x")[0]) == 100


PERIOD_S = 4.0


def reaches(rrd: Path) -> tuple[np.ndarray, np.ndarray]:
    """When the axes were drawn again, and how far they reached from then on."""
    times_s, scales = column(rrd, "/lissajous/equal/trajectory", "Transform3D:scale")
    return times_s, np.array([PLANE_REACH / scale[0][0] for scale in scales])


def decay(amplitude: float) -> np.ndarray:
    time_s = np.arange(0, 200, 0.02)
    return amplitude * np.exp(-time_s / 60.0) * np.cos(2 * np.pi * time_s / PERIOD_S)


def draw(rrd: Path, block: int, amplitude: float, y: np.ndarray) -> None:
    time_s = 0.02 * np.arange(len(y))
    with plotting_into(rrd, amplitude=amplitude, period_s=PERIOD_S) as plot:
        for first in range(0, len(time_s), block):
            part = slice(first, first + block)
            none = np.zeros(len(time_s[part]), dtype=np.int64)
            plot.samples(time_s[part], 0 * y[part], y[part], none)


@pytest.mark.parametrize("block", [8, 1024])
def test_axes_step_down_with_the_amplitude_whatever_the_blocks(tmp_path: Path, block: int) -> None:
    rrd = tmp_path / "decay.rrd"
    draw(rrd, block, 120.0, decay(120.0))
    times_s, reach = reaches(rrd)
    np.testing.assert_allclose(reach, [150.0, 100.0, 70.0, 50.0, 30.0, 20.0, 15.0, 10.0, 7.0][: len(reach)])
    assert len(reach) >= 8
    # each step comes when two periods stay within nine tenths of it: a half-cycle and a block later
    expected_s = 60.0 * np.log(120.0 / (0.9 * reach[1:]))
    late_s = times_s[1:] - expected_s
    assert np.all(late_s > -block * 0.02 - PERIOD_S)
    assert np.all(late_s < 2.5 * PERIOD_S + 2 * block * 0.02)


def test_axes_hold_a_trajectory_that_rests_far_from_zero_and_grow_with_a_release(tmp_path: Path) -> None:
    draw(tmp_path / "rest.rrd", 64, 20.0, 40.0 + decay(20.0))
    # drawn for 20 arcsec at first; what swings from 20 to 60, and rests at 40, needs more
    np.testing.assert_allclose(reaches(tmp_path / "rest.rrd")[1], [30.0, 70.0, 50.0], rtol=1e-6)
    time_s = np.arange(0, 40, 0.02)
    y = np.where(time_s < 20, 0.1, 100 * np.cos(2 * np.pi * (time_s - 20) / PERIOD_S))
    draw(tmp_path / "release.rrd", 50, 120.0, y)
    times_s, reach = reaches(tmp_path / "release.rrd")
    assert reach.min() < 1.0
    assert reach[-1] == pytest.approx(150.0)
    assert times_s[-1] == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "lanes"),
    [
        (EventKind.START, {"run", "spot", "frames"}),
        (EventKind.LASER_DARK, {"laser"}),
        ("", set()),
        ("unknown", set()),
        # a line that reads like an event
        (Event(0, EventKind.STOP, "time limit").line, set()),
    ],
)
def test_a_lane_changes_with_the_kind_of_an_event(kind: str, lanes: set[str]) -> None:
    stream = Mock()
    RunLanes(stream).plot(kind)
    changed = {call.args[0] for call in stream.log.call_args_list if isinstance(call.args[1], rr.StateChange)}
    assert changed == {f"/{lane}" for lane in lanes}


@contextmanager
def balance_view(rrd: Path) -> Iterator[Callable[..., None]]:
    """A view of `rig balance` that draws into a file, and a block of one frame for it."""
    config, first = complete(load_configuration(CONFIG)), Frame(np.zeros((64, 64), np.uint8), 0, 5 * 10**9, 0)
    camera = make_camera(config)
    seen = Deflections(np.array([first.time_ns]), *np.full((4, 1), 1e-5), DeflectionUnit.RAD)
    with BalanceView(config, rrd, lambda _: "", lambda _: None) as view:
        view.begin(first, camera.open())
        spots = [Spot(9.0, 9.0, *[0.1] * 8, 0)]
        yield lambda *turns: view.block([first], Block(spots, seen, [*turns], []))
    camera.close()


def test_the_record_of_a_balance_does_not_grow_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with balance_view(tmp_path / "balance.rrd") as draw_block:
        monkeypatch.setattr("rig.view.balance_view._MAX_BYTES", 0)
        for _ in range(3):
            draw_block()
    assert " ".join(capsys.readouterr().err.split()).count("the view ends: its record has") == 1


def test_a_turning_point_before_the_first_frame_is_shown(tmp_path: Path) -> None:
    """It is fitted, and the fit may place it there."""
    turn = HalfCycle(1, 5 * 10**9 - 3_000_000, 1e-6, 4e-4, 1e-8, 2.0, 1e-4, 0.0, 1, 0)
    with balance_view(tmp_path / "balance.rrd") as draw_block:
        draw_block(turn)
    times_s, amplitudes, _ = measured(tmp_path / "balance.rrd", "/amplitude")
    assert times_s == pytest.approx([-0.003])
    assert amplitudes == pytest.approx([turn.amplitude / ARCSEC_RAD])


def test_every_state_of_a_lane_has_its_colour() -> None:
    states = {state for lanes in _STATES_AFTER_EVENT.values() for state in lanes.values()}
    assert states <= _STATE_COLOURS.keys()
