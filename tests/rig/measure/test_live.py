"""Live runs in real time from their start to their end, with the display on a terminal, and with faults.

What runs on demand is processed as fast as it goes; only here do watchers, forecasts and late frames meet a
clock. Processor time is what counts on a busy machine: the sensors are small, and the runs wait for frames.
"""

import json
import os
from pathlib import Path

import pytest

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from tests.rig.command_line import CONFIGS, rig_process, set_words
from tests.rig.pseudo_terminal import Terminal

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.timeout(300),
    pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal is POSIX's"),
]

LIVE = {
    "simulation.real_time": "true",
    "simulation.sensor.width_px": "96",
    "simulation.sensor.height_px": "160",
    "simulation.optics.arm_m": "0.5",
    "camera.frame_rate_hz": "25",
    "start.way": '"at once"',
    "preflight.when": '"never"',
    "view.file": "false",
}
BASEMENT = {
    "session.initial_amplitude_arcsec": "7",
    "simulation.release.amplitude_arcsec": "7",
    # friction and air of a pendulum that is done in a minute
    "simulation.contact.b": "0.05",
    "session.max_duration_s": "100",
}


def state_of(folder: Path) -> tuple[str, str]:
    entry = json.loads((folder / "session.json").read_text())["entries"][-1]
    return entry["state"], entry["reason"]


def at_a_terminal(config: str, folder: Path, values: dict[str, str]) -> str:
    """Run at a pseudo-terminal whose screen is read; what it said at last."""
    terminal = Terminal("run", CONFIGS / config, "-o", folder, *set_words(values), on_screen=True)
    try:
        while terminal.process.poll() is None:
            terminal._read(0.5)
        terminal.end()
        return terminal.screen
    finally:
        terminal.close()


def test_a_run_in_the_basement_from_7_arcsec_comes_to_its_end_on_a_terminal(tmp_path: Path) -> None:
    screen = at_a_terminal("basement.toml", tmp_path / "out", LIVE | BASEMENT)
    assert "Traceback" not in screen
    state, reason = state_of(tmp_path / "out")
    assert (state, reason) == ("complete", "final amplitude reached")
    (run,) = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    assert run["fits"], run["problem"]


@pytest.mark.parametrize("rate_hz", [10, 200])
def test_runs_of_other_rates_lose_nothing_and_end(rate_hz: int, tmp_path: Path) -> None:
    values = {**LIVE, "camera.frame_rate_hz": str(rate_hz), "session.max_duration_s": "20"}
    done = rig_process("run", CONFIGS / "basement.toml", "-o", tmp_path / "out", *set_words(values))
    assert "Traceback" not in done.stderr
    assert state_of(tmp_path / "out") == ("complete", "time limit of 20 s reached")
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        sequences = reader.spots()["sequence"]
    assert sequences[-1] == pytest.approx(20 * rate_hz, abs=2)
    assert len(sequences) == sequences[-1] + 1


def test_faults_are_survived_or_named(tmp_path: Path) -> None:
    faults = {
        "faults.camera_unplugged_at_s": "4",
        "faults.camera_replugged_at_s": "7",
        "faults.laser_fades_at_s": "10",
        "faults.laser_fade_duration_s": "1",
        "faults.draught_at_s": "14",
        "session.max_duration_s": "20",
    }
    screen = at_a_terminal("basement.toml", tmp_path / "out", LIVE | faults)
    assert "Traceback" not in screen
    assert state_of(tmp_path / "out") == ("complete", "time limit of 20 s reached")
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        events = reader.events()
        losses = reader.losses()
    kinds = [event.kind for event in events]
    assert {EventKind.CAMERA_LOST, EventKind.CAMERA_BACK, EventKind.SPOT_LOST, EventKind.SPOT_FOUND} <= {
        *kinds
    }
    assert losses is not None
    assert losses.while_unplugged > 50
    end = end_of(events)
    assert end is not None
    assert end.kind == EventKind.STOP
