"""A record whose camera's clock stepped, as earlier versions wrote them, is mended by its replay."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.cameras.simulated import SimulatedCamera
from acquisition.frame import Frame
from rig.analysis import AnalysedRun, analyse_record
from rig.measure import simulate_record
from rig.replay.record_replay import analyse_replayed
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


def of_clock(run: AnalysedRun) -> tuple[int, int, bool]:
    clock = run.results.clock
    assert clock is not None
    verdict = next(one for one in run.results.conditions if one.name == "camera's clock")
    return clock.steps, clock.left_in, verdict.ok


def test_a_recorded_step_is_named_by_the_fit_and_taken_off_by_the_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = recorded(tmp_path / "whole", 0, monkeypatch)
    stepped = recorded(tmp_path / "stepped", STEP_NS, monkeypatch)
    assert of_clock(analyse_record(whole, LIVE)) == (0, 0, True)
    assert of_clock(analyse_record(stepped, LIVE)) == (0, 1, False)

    expected = analyse_replayed(whole, retrack=False, overrides=LIVE)
    mended = analyse_replayed(stepped, retrack=False, overrides=LIVE)
    assert of_clock(mended) == (1, 0, True)
    assert mended.results.clock is not None
    assert mended.results.clock.largest_step_s == pytest.approx(STEP_NS * 1e-9, abs=5e-5)
    assert mended.results.clock.u_steps_s < 1e-4
    assert len(mended.points) == len(expected.points) > 20
    np.testing.assert_allclose(mended.points.time_s, expected.points.time_s, rtol=0, atol=1e-4)
    # an assumed rate is a line of the budget
    lines = mended.results.budget["period0_s"].sources if "period0_s" in mended.results.budget else ()
    assert not lines or any("clock" in line.source for line in lines)
