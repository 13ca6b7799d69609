"""Faults of the simulated rig: the session continues, or ends with the correct reason."""

import json
import os
import re
from pathlib import Path

import pytest

from acquisition.frames.losses import FrameLosses
from acquisition.record.reader import RecordReader
from acquisition.record.topics import RecordedPhase
from processing.swing import HalfCycleFlag
from tests.rig.command_line import CONFIGS, QUICK, rig, run


@pytest.mark.slow
def test_what_comes_back_costs_the_frames_between_and_disturbances_flag_half_cycles(tmp_path: Path) -> None:
    disturbed_s = {"vibration_burst_at_s": 36, "draught_at_s": 58}
    session = run(
        tmp_path / "out",
        QUICK,
        session__max_duration_s="74",
        faults__camera_unplugged_at_s="8",
        faults__camera_replugged_at_s="11",
        faults__laser_fades_at_s="20",
        faults__laser_fade_duration_s="3",
        **{f"faults__{name}": str(at_s) for name, at_s in disturbed_s.items()},
    )
    assert session.done.returncode == 1, session.said
    assert "DROPPED FRAMES: 150 of" in session.done.stdout
    assert "LOST SPOTS: " in session.done.stdout
    kinds = [kind for kind, _ in session.events]
    assert kinds.index("camera lost") < kinds.index("camera back") < kinds.index("stop")
    (gap,) = [text for kind, text in session.events if kind == "gap"]
    assert re.fullmatch(r"frames missing before frame \d+: 150", gap)
    assert kinds.index("spot lost") < len(kinds) - 1 - kinds[::-1].index("spot found")
    (fitted,) = session.runs
    assert fitted["half_cycles"] >= 11
    assert fitted["losses"]["while_unplugged"] == fitted["dropped_frames"] == 150
    with RecordReader(session.record) as reader:
        losses, sequences, half_cycles = reader.losses(), reader.spots()["sequence"], reader.half_cycles()
    assert losses == FrameLosses(while_unplugged=int(sequences[-1]) + 1 - len(sequences))
    assert "150 while unplugged" in rig("record", "info", session.record).stdout
    disturbed = HalfCycleFlag.VIBRATION | HalfCycleFlag.START
    # what was lost before flags half-cycles, too
    flagged_s = [h.turn_time_ns * 1e-9 - 1.0 for h in half_cycles if h.flags & disturbed]
    late_s = [at_s for at_s in flagged_s if at_s > 30.0]
    near = [[-6 < at_s - of_s < 12 for at_s in late_s] for of_s in disturbed_s.values()]
    assert all(map(any, near))
    assert all(map(any, zip(*near, strict=True)))


@pytest.mark.parametrize(
    ("from_s", "lasts_s", "is_asked_for"),
    # the last is too dim to be found for half of that time, less than the 5 s after which it is said
    [("0", "90", True), ("4", "90", True), ("4", "9", False)],
    ids=["never seen", "lost", "back soon"],
)
def test_a_spot_that_stays_away_is_asked_for(
    tmp_path: Path, from_s: str, lasts_s: str, is_asked_for: bool
) -> None:
    session = run(
        tmp_path / "out",
        QUICK,
        # long enough for the display, which looks ten times a second, to see it
        camera__frame_rate_hz="20",
        session__max_duration_s="100",
        faults__laser_fades_at_s=from_s,
        faults__laser_fade_duration_s=lasts_s,
    )
    lines = [line for line in session.said.splitlines() if "SPOT LOST" in line]
    # the display may miss a moment, the record does not
    with RecordReader(session.record) as reader:
        assert any("spot lost" in one.instruction for one in reader.values(RecordedPhase)) == is_asked_for
    assert len(lines) == is_asked_for
    said = r"run 1: SPOT LOST SINCE 0:\d\d\.\d: laser on\? beam on the sensor\? rig camera align "
    assert all(re.fullmatch(said + re.escape(str(CONFIGS / "demo.toml")), line) for line in lines)


def test_a_stalled_camera_ends_the_run_with_that_reason_and_the_record_is_whole(tmp_path: Path) -> None:
    session = run(
        tmp_path / "out", QUICK, faults__frames_stalled_at_s="10", faults__frames_stalled_duration_s="60"
    )
    assert session.done.returncode == 1
    with RecordReader(session.record) as reader:
        assert len(reader.spots()) == 500
    assert "the camera has stalled" in session.events[-1][1]
    assert session.entries[0]["state"] == "failed"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a limit on the size of files stands for the disk's end")
def test_a_full_disk_ends_the_run_with_that_reason_and_the_record_is_whole(tmp_path: Path) -> None:
    import resource

    _, hard = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    endless = {"session.max_duration_s": "1e5", "session.final_amplitude_arcsec": "0.01"}
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_500_000, hard))
    try:
        # whole frames fill it soon
        full = run(tmp_path / "out", {**QUICK, **endless}, "--json", record__full_frame_interval_s="0.05")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert full.done.returncode == 1
    assert "cannot be written" in full.said
    # whoever watches is told at once: devices are closed and the run is fitted before it has ended
    lines = map(json.loads, full.done.stdout.splitlines())
    assert ["cannot be written" in line["text"] for line in lines if line.get("event") == "failed"] == [True]
    with RecordReader(full.record) as reader:
        assert not reader.truncated
        assert len(reader.spots()) > 500
