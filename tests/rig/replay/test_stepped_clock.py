"""A record whose camera's clock stepped, as earlier versions wrote them, is mended by its replay."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.cameras.simulated import SimulatedCamera
from acquisition.frame import Frame
from acquisition.record.reader import RecordReader
from rig.analysis.contact_verdicts import rig_quantities
from rig.analysis.run_clock import RunClock, clock_verdict, run_clock
from rig.instrument import recorded_configuration
from rig.measure import simulate_record
from rig.replay.replay import Replay
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SMALL

LIVE = ["simulation.real_time=true"]
STEP_NS = 130_000_000
AT_NS = 30_000_000_000
WORDS = {**SMALL, "session.max_duration_s": "60", "preflight.when": '"never"'}


def recorded(folder: Path, step_ns: int, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A minute on demand, with arrivals as of a real camera."""
    usual, rng, first_ns = SimulatedCamera.read, np.random.default_rng(1), [-1]

    def read(camera: SimulatedCamera, timeout_s: float) -> Frame | None:
        frame = usual(camera, timeout_s)
        if frame is None:
            return None
        if first_ns[0] < 0:
            first_ns[0] = frame.device_time_ns
        late_ns = round(1e6 + 2e5 * abs(rng.standard_normal()))
        shown_ns = frame.device_time_ns + step_ns * (frame.device_time_ns - first_ns[0] >= AT_NS)
        return frame._replace(device_time_ns=shown_ns, host_time_ns=10**13 + frame.device_time_ns + late_ns)

    folder.mkdir()
    record = folder / "run.mcap"
    config = load_configuration(CONFIGS / "demo.toml", [f"{key}={value}" for key, value in WORDS.items()])
    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "read", read)
        assert simulate_record(config, CONFIGS / "demo.toml", record) == 0
    return record


class Judged(NamedTuple):
    """The clock of a record, and the times of its turning points in a replay."""

    fitted: RunClock
    replayed: RunClock
    turns_s: NDArray[np.float64]
    remarks: tuple[str, ...]


def judged(record: Path) -> Judged:
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, LIVE)
        fitted, replayed = (run_clock(reader, config, replayed=mended) for mended in (False, True))
        assert fitted is not None
        assert replayed is not None
        replay = Replay(reader, config, retrack=False)
        while replay.advance(math.inf, 1000) is not None:
            pass
        swings = replay.finish().swings
    times_ns = np.array([swing.turn_time_ns for swing in swings])
    return Judged(fitted, replayed, (times_ns - times_ns[0]) * 1e-9, replay.clock_remarks)


def test_a_recorded_step_is_named_by_the_fit_and_taken_off_by_the_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = judged(recorded(tmp_path / "whole", 0, monkeypatch))
    stepped = judged(recorded(tmp_path / "stepped", STEP_NS, monkeypatch))
    assert (whole.fitted.steps, whole.fitted.left_in, whole.remarks) == (0, 0, ())
    assert clock_verdict(whole.fitted).ok
    assert (stepped.fitted.steps, stepped.fitted.left_in) == (0, 1)
    assert not clock_verdict(stepped.fitted).ok
    assert "rig replay takes it off" in clock_verdict(stepped.fitted).line
    assert (stepped.replayed.steps, stepped.replayed.left_in) == (1, 0)
    assert clock_verdict(stepped.replayed).ok
    assert stepped.replayed.largest_step_s == pytest.approx(STEP_NS * 1e-9, abs=5e-5)
    assert stepped.replayed.u_steps_s < 1e-4
    assert len(stepped.remarks) == 1
    assert "stepped by +0.13 s" in stepped.remarks[0]
    assert "at 30." in stepped.remarks[0]
    assert len(stepped.turns_s) == len(whole.turns_s) > 20
    np.testing.assert_allclose(stepped.turns_s, whole.turns_s, rtol=0, atol=1e-4)


def test_an_assumed_rate_is_as_uncertain_as_its_clocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = recorded(tmp_path / "run", 0, monkeypatch)
    with RecordReader(record) as reader:
        calibrated = [*LIVE, "timebase.camera_rate=1.0", "timebase.u_camera_rate=2e-6"]
        contradicted = [*LIVE, "timebase.camera_rate=1.001", "timebase.u_camera_rate=2e-6"]
        u_assumed, u_calibrated, u_contradicted = (
            clock.u_rate
            for words in (LIVE, calibrated, contradicted)
            if (clock := run_clock(reader, recorded_configuration(reader, words))) is not None
        )
        assert run_clock(reader, recorded_configuration(reader)) is None
        assert rig_quantities(recorded_configuration(reader, LIVE), u_clock=u_assumed).clock.u == u_assumed
    # of a computer that follows no time server
    assert u_assumed == pytest.approx(50e-6, rel=0.1)
    assert u_calibrated == pytest.approx(2e-6, rel=0.01)
    assert u_contradicted == pytest.approx(1e-3, rel=0.1)
