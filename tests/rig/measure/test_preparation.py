"""Sessions with phases: no-go, release by hand, rejected starts, crash and resumption."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from tests.rig.command_line import CONFIGS, QUICK, events_of, rig, set_words

BY_HAND = {
    **QUICK,
    "start.way": '"by hand"',
    "simulation.release.at_s": "7.0",
    "simulation.release.way": '"push"',
    "simulation.fast.amplitude_arcsec": "0.3",
    "preflight.when": '"always"',
    "preflight.max_clock_jitter_us": "1e9",
    "preflight.duration_s": "1.0",
    "phases.rest_window_s": "2.0",
    "session.max_duration_s": "18",
}


def words(**changes: str) -> list[str]:
    return set_words({**BY_HAND, **{key.replace("__", "."): value for key, value in changes.items()}})


def state_of(folder: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads((folder / "session.json").read_text())
    return tree


def holds_spots(path: Path) -> bool:
    """Whether a record that is being written has a first chunk of spots, so that it can be recovered."""
    if not path.exists():
        return False
    try:
        with RecordReader(path) as reader:
            return len(reader.spots()) > 500
    except RecordError:  # its head is not written yet
        return False


def test_a_release_by_hand_is_caught_from_before_it_happens_and_json_lines_say_all(tmp_path: Path) -> None:
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", "--json", *words())
    # nothing else is on stdout
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"state", "event", "preflight", "results"} <= {line["kind"] for line in lines}
    states = [line for line in lines if line["kind"] == "state"]
    assert any(line["instruction"] == "release by hand now" for line in states)
    assert states[-1]["reason"].startswith("time limit")
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        spots = reader.spots()
        swings = [swing for swing in reader.swings() if swing.flags == 0]
        attachments = set(reader.attachments)
    # the camera's clock shows 1 s at simulated time 0
    release_s = 8.0
    assert "preflight.json" in attachments
    assert spots["sequence"][0] == 0
    assert release_s - 2.1 < spots["time_ns"][0] * 1e-9 < release_s - 1.0
    assert (spots["sequence"] == range(len(spots))).all()
    # pushed from rest, it turns first a quarter period after the push; the first or second is clean
    assert swings[0].turn_time_ns * 1e-9 < release_s + 4.2
    kinds = [kind for kind, _ in events_of(tmp_path / "out" / "run-1.mcap")]
    assert kinds.index("rest") < kinds.index("preflight") < kinds.index("release") < kinds.index("start")


def test_a_no_go_stops_before_anything_is_recorded_and_force_passes_over_it(tmp_path: Path) -> None:
    strict = words(
        preflight__max_rest_offset_arcsec="5",
        simulation__axes__rest_fast_arcsec="20",
        session__max_duration_s="4",
    )
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "no", *strict)
    assert done.returncode == 1
    assert "no-go (rest position" in done.stderr
    assert not (tmp_path / "no").exists()
    rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "yes", "--force", *strict)
    said = dict(events_of(tmp_path / "yes" / "run-1.mcap"))
    assert said["preflight"].startswith("no-go: rest position")
    (forced,) = map(json.loads, (tmp_path / "yes" / "audit.jsonl").read_text().splitlines())
    assert forced["what"] == "force"
    assert forced["why"].startswith("preflight said no-go: rest position")


def test_starts_that_are_not_accepted_are_kept_apart(tmp_path: Path) -> None:
    # of a pendulum that nobody brakes and that swings too far for ever, one attempt can be made
    too_far = words(simulation__release__amplitude_arcsec="80", start__attempts="1")
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *too_far)
    assert done.returncode == 1
    assert "RELEASE BY HAND NOW" in done.stderr
    assert "first amplitude 8" in done.stderr
    assert "no start of 1 was accepted" in done.stderr
    aside = tmp_path / "out" / "run-1-start-1.mcap"
    assert events_of(aside)[-1][0] == "rejected"
    assert events_of(aside)[-1][1].startswith("start not accepted: first amplitude 8")
    assert not (tmp_path / "out" / "run-1.mcap").exists()
    assert [entry["state"] for entry in state_of(tmp_path / "out")["entries"]] == ["rejected", "failed"]


@pytest.mark.parametrize(("most_s", "so_far"), [("8", "spread 12"), ("3", "3 of 4.5 s)")])
def test_waiting_for_rest_ends_at_its_limit_with_the_reason(tmp_path: Path, most_s: str, so_far: str) -> None:
    still_swings = words(
        simulation__release__at_s="0", phases__rest_window_s="4.5", phases__rest_max_s=most_s
    )
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *still_swings)
    assert done.returncode == 1
    assert f"rest: not reached within {most_s} s ({so_far}" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_a_series_that_was_killed_goes_on(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "rig", "run", str(CONFIGS / "demo.toml"), "-o", str(folder)]
    process = subprocess.Popen(
        # long enough to be flushed before its end
        [*command, "--runs", "2", *set_words({**QUICK, "session.max_duration_s": "120"})],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    cut = folder / "run-2.mcap"
    deadline = time.monotonic() + 200
    while True:
        assert process.poll() is None
        # it stands still while it is looked at, so that the run cannot end before it is killed
        os.killpg(process.pid, signal.SIGSTOP)
        if holds_spots(cut):
            break
        assert time.monotonic() < deadline
        os.killpg(process.pid, signal.SIGCONT)
        time.sleep(0.05)
    running = rig("run", "--resume", folder)
    assert running.returncode == 2
    assert "still running" in running.stderr
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = {name: (folder / name).read_bytes() for name in ("run-1.mcap", "run-2.mcap")}

    done = rig("run", "--resume", folder)
    assert done.returncode == 0, done.stderr
    for name, content in before.items():
        assert (folder / name).read_bytes() == content
    states = {entry["record"]: entry["state"] for entry in state_of(folder)["entries"]}
    assert states == {
        "run-1.mcap": "complete",
        "run-2.mcap": "interrupted",
        "run-3.mcap": "complete",
    }
    with RecordReader(folder / "run-2-recovered.mcap") as reader:
        assert not reader.truncated
        assert len(reader.spots()) > 500
    results = json.loads((folder / "results.json").read_text())
    assert [run["record"] for run in results["runs"]] == ["run-1.mcap", "run-3.mcap"]
    again = rig("run", "--resume", folder)
    assert again.returncode == 0
    assert "no run is missing" in again.stderr


def test_resume_wants_a_session(tmp_path: Path) -> None:
    done = rig("run", "--resume", tmp_path)
    assert done.returncode == 2
    assert "contains no session" in done.stderr
    (tmp_path / "demo.toml").touch()
    done = rig("run", "--resume", tmp_path / "demo.toml")
    assert done.returncode == 2
    assert "demo.toml: is a file; name the folder of a session" in done.stderr
