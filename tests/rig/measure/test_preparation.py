"""Sessions with phases: no-go, release by hand, rejected starts."""

import json
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from tests.rig.command_line import QUICK, run

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


def test_a_release_by_hand_is_caught_from_before_it_happens_and_json_lines_say_all(tmp_path: Path) -> None:
    session = run(tmp_path / "out", BY_HAND, "--json")
    # nothing else is on stdout
    lines = [json.loads(line) for line in session.done.stdout.splitlines()]
    assert {"state", "event", "preflight", "results"} <= {line["kind"] for line in lines}
    states = [line for line in lines if line["kind"] == "state"]
    assert any(line["instruction"] == "release by hand now" for line in states)
    assert states[-1]["reason"].startswith("time limit")
    with RecordReader(session.record) as reader:
        spots = reader.spots()
        half_cycles = [h for h in reader.half_cycles() if h.flags == 0]
        assert "preflight.json" in reader.attachments
    # the camera's clock shows 1 s at simulated time 0
    release_s = 8.0
    assert release_s - 2.1 < spots["time_ns"][0] * 1e-9 < release_s - 1.0
    assert (spots["sequence"] == range(len(spots))).all()
    # pushed from rest, it turns first a quarter period after the push; the first or second is clean
    assert half_cycles[0].turn_time_ns * 1e-9 < release_s + 4.2
    kinds = [kind for kind, _ in session.events]
    assert kinds.index("rest") < kinds.index("preflight") < kinds.index("release") < kinds.index("start")


def test_a_no_go_stops_before_anything_is_recorded_and_force_passes_over_it(tmp_path: Path) -> None:
    strict = {
        **BY_HAND,
        "preflight.max_rest_offset_arcsec": "5",
        "simulation.axes.rest_fast_arcsec": "20",
        "session.max_duration_s": "4",
    }
    session = run(tmp_path / "no", strict)
    assert session.done.returncode == 1
    assert "no-go (rest position" in session.said
    assert not session.folder.exists()
    forced = run(tmp_path / "yes", strict, "--force")
    assert dict(forced.events)["preflight"].startswith("no-go: rest position")
    (entry,) = forced.audit
    assert entry["what"] == "force"
    assert entry["why"].startswith("preflight said no-go: rest position")


def test_starts_that_are_not_accepted_are_kept_apart(tmp_path: Path) -> None:
    # of a pendulum that nobody brakes and that swings too far for ever, one attempt can be made
    session = run(tmp_path / "out", BY_HAND, simulation__release__amplitude_arcsec="80", start__attempts="1")
    assert session.done.returncode == 1
    for text in ("RELEASE BY HAND NOW", "first amplitude 8", "no start of 1 was accepted"):
        assert text in session.said
    with RecordReader(session.folder / "run-1-start-1.mcap") as reader:
        last = reader.events()[-1]
    assert last.kind == "rejected"
    assert last.text.startswith("start not accepted: first amplitude 8")
    assert not session.record.exists()
    assert [entry["state"] for entry in session.entries] == ["rejected", "failed"]


@pytest.mark.parametrize(("most_s", "so_far"), [("8", "spread 12"), ("3", "3 of 4.5 s)")])
def test_waiting_for_rest_ends_at_its_limit_with_the_reason(tmp_path: Path, most_s: str, so_far: str) -> None:
    half_cycles = {**BY_HAND, "simulation.release.at_s": "0", "phases.rest_window_s": "4.5"}
    session = run(tmp_path / "out", half_cycles, phases__rest_max_s=most_s)
    assert session.done.returncode == 1
    assert f"rest: not reached within {most_s} s ({so_far}" in session.said
