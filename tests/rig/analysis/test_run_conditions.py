"""The conditions of a run are judged from its record, and decide the exit status."""

import json
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.fit import Ground
from rig.analysis import Fit, RunResults
from rig.analysis.record_fit import run_conditions
from rig.analysis.run_values import Beam
from rig.settings import PreflightSettings
from tests.rig.command_line import CONFIGS, QUICK, rig, set_words


@pytest.mark.parametrize(
    ("frames", "lost", "dropped", "against"),
    [
        (1000, 10, 1, set()),
        (1000, 11, 1, {"lost spots"}),
        (1000, 0, 11, {"dropped frames"}),
        (0, 0, 0, set()),
    ],
)
def test_losses_are_held_against_the_limits_of_the_preflight(
    frames: int, lost: int, dropped: int, against: set[str], measured_series: Path
) -> None:
    with RecordReader(measured_series / "run-1.mcap") as reader:
        run = RunResults(record="run-1.mcap", frames=frames, dropped_frames=dropped)
        found = run_conditions(reader, run, lost, PreflightSettings())
    assert {verdict.name for verdict in found if not verdict.ok} == against
    assert {"light", "rest position", "ambient light"} <= {verdict.name for verdict in found}


def test_spots_at_full_scale_are_warned_of(measured_series: Path) -> None:
    with RecordReader(measured_series / "run-1.mcap") as reader:
        for saturated, warned in ((10, False), (11, True)):
            beam = Beam(model="upright", flags={"SATURATED": saturated})
            run = RunResults(record="run-1.mcap", frames=1000, beam=beam)
            found = run_conditions(reader, run, 0, PreflightSettings())
            (verdict,) = (verdict for verdict in found if verdict.name == "saturation")
            assert (verdict.ok, "exposure_us" in verdict.remedy) == (True, warned)


@pytest.mark.slow
def test_a_run_that_loses_spots_says_so_and_fails(tmp_path: Path) -> None:
    fading = {
        **QUICK,
        "session.max_duration_s": "30",
        "faults.laser_fades_at_s": "10",
        "faults.laser_fade_duration_s": "5",
    }
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *set_words(fading))
    assert done.returncode == 1
    assert "LOST SPOTS: " in done.stdout
    (run,) = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    assert [item["name"] for item in run["conditions"] if not item["ok"]] == ["lost spots"]
    again = rig("fit", tmp_path / "out" / "run-1.mcap", "-o", tmp_path / "again")
    assert "LOST SPOTS: " in again.stdout
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Conditions of the run" in report


def test_a_ground_that_leaves_too_little_to_fit_is_a_condition(measured_series: Path) -> None:
    with RecordReader(measured_series / "run-1.mcap") as reader:
        for left_out, ok in ((10, True), (30, False)):
            ground = Ground(left_out_half_cycles=left_out, widening={"b": 3.0, "c": 12.0})
            fits = {"exact": Fit(ground=ground)}
            run = RunResults(record="run-1.mcap", frames=1000, half_cycles=100, fits=fits)
            found = run_conditions(reader, run, 0, PreflightSettings())
            (verdict,) = (verdict for verdict in found if verdict.name == "ground")
            assert verdict.ok is ok
            assert "uncertainties × 12" in verdict.measured
