"""Faults of the simulated rig: the session continues, or ends with the correct reason."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from acquisition.frames.losses import FrameLosses
from acquisition.record.reader import RecordReader
from acquisition.record.topics import RecordedPhase
from processing.swing import HalfCycleFlag
from tests.rig.command_line import CONFIGS, QUICK, WITHOUT_FIGURES, Done, events_of, rig, set_words


def run_with(folder: Path, **faults: str) -> Done:
    values = {key.replace("__", "."): value for key, value in faults.items()}
    words = set_words({**QUICK, "session.max_duration_s": "36", **values})
    return rig("run", CONFIGS / "demo.toml", "-o", folder, *words)


@pytest.mark.slow
def test_a_camera_that_comes_back_and_a_laser_that_fades_cost_the_frames_between(tmp_path: Path) -> None:
    unplugged = {"faults__camera_unplugged_at_s": "8", "faults__camera_replugged_at_s": "11"}
    fades = {"faults__laser_fades_at_s": "22", "faults__laser_fade_duration_s": "3"}
    done = run_with(tmp_path / "out", **unplugged, **fades, session__max_duration_s="42")
    assert done.returncode == 1, done.stderr
    assert "DROPPED FRAMES: 150 of" in done.stdout
    assert "LOST SPOTS: " in done.stdout
    kinds = [kind for kind, _ in events_of(tmp_path / "out" / "run-1.mcap")]
    assert kinds.index("camera lost") < kinds.index("camera back") < kinds.index("stop")
    (gap,) = [text for kind, text in events_of(tmp_path / "out" / "run-1.mcap") if kind == "gap"]
    assert gap.startswith("frames missing before frame ")
    assert gap.endswith(": 150")
    assert kinds.index("spot lost") < len(kinds) - 1 - kinds[::-1].index("spot found")
    run = json.loads((tmp_path / "out" / "results.json").read_text())["runs"][0]
    assert run["half_cycles"] >= 11
    assert run["losses"]["while_unplugged"] == run["dropped_frames"] == 150
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        losses, sequences = reader.losses(), reader.spots()["sequence"]
    assert losses == FrameLosses(while_unplugged=int(sequences[-1]) + 1 - len(sequences))
    info = rig("record", "info", tmp_path / "out" / "run-1.mcap").stdout
    assert f"{run['dropped_frames']} while unplugged" in info


@pytest.mark.parametrize(
    ("from_s", "lasts_s", "said"),
    [
        ("0", "90", "run 1: SPOT LOST SINCE 0:{}: laser on? beam on the sensor? rig camera align "),
        ("4", "90", "run 1: SPOT LOST SINCE 0:{}: laser on? beam on the sensor? rig camera align "),
        # too dim to be found for half of that time, less than the 5 s after which it is said
        ("4", "9", ""),
    ],
    ids=["never seen", "lost", "back soon"],
)
def test_a_spot_that_stays_away_is_asked_for(tmp_path: Path, from_s: str, lasts_s: str, said: str) -> None:
    fades = {"faults__laser_fades_at_s": from_s, "faults__laser_fade_duration_s": lasts_s}
    # long enough for the display, which looks ten times a second, to see it
    slow = {"camera__frame_rate_hz": "20", "session__max_duration_s": "100"}
    done = run_with(tmp_path / "out", **slow, **fades)
    lines = [line for line in done.stderr.splitlines() if "SPOT LOST" in line]
    assert len(lines) == bool(said)
    # the display may miss a moment, the record does not
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        assert any("spot lost" in one.instruction for one in reader.values(RecordedPhase)) == bool(said)
    if said:
        since = re.escape(said).replace(r"\{\}", r"\d\d\.\d")
        assert re.fullmatch(f"{since}{re.escape(str(CONFIGS / 'demo.toml'))}", lines[0])


@pytest.mark.slow
def test_disturbances_flag_half_cycles_and_the_run_goes_on(tmp_path: Path) -> None:
    disturbed_s = {"vibration_burst_at_s": 18, "draught_at_s": 48}
    faults = {f"faults__{name}": str(at_s) for name, at_s in disturbed_s.items()}
    done = run_with(tmp_path / "out", session__max_duration_s="66", **faults)
    assert "Traceback" not in done.stderr
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        swings = reader.swings()
    disturbed = HalfCycleFlag.VIBRATION | HalfCycleFlag.START
    flagged = [swing for swing in swings if swing.flags & disturbed and swing.index > 2]
    after_s = [[swing.turn_time_ns * 1e-9 - 1.0 - at_s for swing in flagged] for at_s in disturbed_s.values()]
    near = [[-6 < one < 12 for one in of_one] for of_one in after_s]
    assert all(map(any, near))
    assert all(map(any, zip(*near, strict=True)))


def test_a_stalled_camera_ends_the_run_with_that_reason_and_the_record_is_whole(tmp_path: Path) -> None:
    done = run_with(
        tmp_path / "out", faults__frames_stalled_at_s="10", faults__frames_stalled_duration_s="60"
    )
    assert done.returncode == 1
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        assert not reader.truncated
        assert len(reader.spots()) == 500
    assert "the camera has stalled" in events_of(tmp_path / "out" / "run-1.mcap")[-1][1]
    assert json.loads((tmp_path / "out" / "session.json").read_text())["entries"][0]["state"] == "failed"


@pytest.mark.slow
def test_a_full_disk_ends_the_run_with_that_reason_and_the_record_is_whole(tmp_path: Path) -> None:
    # a limit on the size of files stands for the disk's end; whole frames fill it soon
    script = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4_500_000, 4_500_000))" + WITHOUT_FIGURES
    )
    folder = tmp_path / "out"
    endless = {"session.max_duration_s": "1e5", "session.final_amplitude_arcsec": "0.01"}
    words = set_words({**QUICK, **endless, "record.full_frame_interval_s": "0.05"})
    done = subprocess.run(
        [sys.executable, "-c", script, "run", CONFIGS / "demo.toml", "-o", folder, "--json", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 1
    assert "cannot be written" in done.stderr
    # whoever watches is told at once: devices are closed and the run is fitted before it has ended
    told = [line for line in map(json.loads, done.stdout.splitlines()) if line.get("event") == "failed"]
    assert ["cannot be written" in line["text"] for line in told] == [True]
    with RecordReader(folder / "run-1.mcap") as reader:
        assert not reader.truncated
        assert len(reader.spots()) > 500
