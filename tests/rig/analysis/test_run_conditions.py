"""The conditions of a run, with that of the beam, are judged from its record, and decide the exit status."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.record.reader import RecordReader
from processing.fit import Ground
from processing.spot import BeamUse, SpotFlag
from rig.analysis import Fit, RunResults
from rig.analysis.contact_verdicts import rig_quantities
from rig.analysis.record_fit import _beam, run_clock, run_conditions
from rig.analysis.results_file import read_results
from rig.analysis.run_values import Beam
from rig.instrument import recorded_configuration
from rig.measure import record_plainly
from rig.settings import PreflightSettings, load_configuration
from tests.rig.command_line import CONFIGS, QUICK, SMALL, rig, set_words


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


def test_spots_at_full_scale_and_ground_that_leaves_too_little_to_fit_are_conditions(
    measured_series: Path,
) -> None:
    with RecordReader(measured_series / "run-1.mcap") as reader:
        for saturated, left_out, within in ((10, 10, True), (11, 30, False)):
            beam = Beam(model="upright", flags={"SATURATED": saturated})
            ground = Ground(left_out_half_cycles=left_out, widening={"b": 3.0, "c": 12.0})
            fits = {"exact": Fit(ground=ground)}
            run = RunResults(record="run-1.mcap", frames=1000, half_cycles=100, fits=fits, beam=beam)
            found = {one.name: one for one in run_conditions(reader, run, 0, PreflightSettings())}
            assert found["saturation"].ok, "a warning"
            assert ("exposure_us" in found["saturation"].remedy) is not within
            assert found["ground"].ok is within
            assert "uncertainties × 12" in found["ground"].measured


MOST = PreflightSettings().max_poor_fit_fraction
POOR, LEARNED = SpotFlag.POOR_FIT, SpotFlag.LEARNED


def beam(*stretches: tuple[int, int], noise_is_known: bool = True) -> Beam:
    flags = np.repeat([flag for _, flag in stretches], [count for count, _ in stretches])
    use = BeamUse()
    use.take(np.arange(len(flags)), flags)
    return Beam.of(use, noise_is_known=noise_is_known)


def test_an_ordinary_run_with_a_learned_profile_is_no_warning() -> None:
    found = beam((147, POOR), (3000, LEARNED), (20, LEARNED | POOR), (1000, LEARNED))
    verdict = _beam(found, MOST)
    assert verdict.ok
    assert not verdict.remedy
    assert found.sentence == "Beam: learned profile since frame 147; spots with POOR_FIT 167."
    assert beam((147, POOR), (900, LEARNED)).sentence.endswith("POOR_FIT 147 (while it was learned).")


@pytest.mark.parametrize(
    ("stretches", "known", "cause"),
    [
        ([(900, 0), (100, POOR | SpotFlag.EDGE)], True, "edge of the sensor"),
        ([(900, 0), (100, POOR | SpotFlag.SATURATED)], True, "saturated"),
        ([(147, POOR), (900, LEARNED), (100, LEARNED | POOR)], True, "changes with position"),
        ([(1000, 0), (400, POOR), (900, LEARNED)], True, "changed during the run"),
        ([(200, POOR)], True, "too short"),
        ([(2000, POOR)], False, "assumed, not measured"),
        ([(2000, POOR)], True, "no constant profile"),
    ],
)
def test_bad_fits_are_a_warning_with_cause_and_remedy(
    stretches: list[tuple[int, int]], known: bool, cause: str
) -> None:
    verdict = _beam(beam(*stretches, noise_is_known=known), MOST)
    assert verdict.ok  # the numbers stand, with widened uncertainties
    assert cause in verdict.reason
    assert verdict.remedy


def test_a_measured_series_states_its_beam(measured_series: Path) -> None:
    for run in read_results(measured_series).runs:
        assert run.beam is not None
        assert (run.beam.model, run.beam.since_frame, run.beam.poor_fit_frames) == ("one Gaussian", 0, 0)
        assert run.beam.judged_frames == run.frames
        assert "beam" in [item.name for item in run.conditions]


LIVE = ["simulation.real_time=true"]
WORDS = {**SMALL, "session.max_duration_s": "60", "preflight.when": '"never"'}


def recorded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A minute on demand, with arrivals as of a real camera."""
    usual, rng = SimulatedCamera.read, np.random.default_rng(1)

    def read(camera: SimulatedCamera, timeout_s: float) -> Frame | None:
        frame = usual(camera, timeout_s)
        if frame is None:
            return None
        late_ns = round(1e6 + 2e5 * abs(rng.standard_normal()))
        return frame._replace(host_time_ns=10**13 + frame.device_time_ns + late_ns)

    folder.mkdir()
    record = folder / "run.mcap"
    config = load_configuration(CONFIGS / "demo.toml", [f"{key}={value}" for key, value in WORDS.items()])
    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "read", read)
        assert record_plainly(config, CONFIGS / "demo.toml", record) == 0
    return record


def test_an_assumed_rate_is_as_uncertain_as_its_clocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = recorded(tmp_path / "run", monkeypatch)
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


TRUE = {"b": 37.33e-4, "p": 0.944, "c": 10.51e-9, "period0_s": 4.071}
REFLECTION = {
    **SMALL,
    "session.max_duration_s": "300",
    "camera.frame_rate_hz": "8",
    "simulation.reference.relative": "0.03",
    # the spot swings along x 79.5, past y 400
    "simulation.reference.y_px": "400",
    "simulation.reference.x_px": "83.5",
}
WITHOUT_PIXELS = {
    **REFLECTION,
    "session.max_duration_s": "30",
    "record.windows": "false",
    "record.full_frame_interval_s": "2",
    "instrument.kind": '"tomlinson"',
}


def measured(folder: Path, words: dict[str, str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A run's results, and its condition of fixed light."""
    rig("run", CONFIGS / "demo.toml", "-o", folder, *set_words(words))
    run: dict[str, Any] = json.loads((folder / "results.json").read_text())["runs"][0]
    (found,) = [one for one in run["conditions"] if one["name"] == "fixed light"]
    return run, found


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_the_parameters_know_nothing_of_a_reflection_of_three_percent(tmp_path: Path) -> None:
    run, said = measured(tmp_path / "run", REFLECTION)
    exact = run["fits"]["exact"]
    for name, true in TRUE.items():
        assert abs(exact[name]["value"] - true) < 2.5 * exact[name]["standard_uncertainty"], name
    assert exact["c"]["standard_uncertainty"] < 0.07 * TRUE["c"]
    # as without the light: none is left out; the last half-cycle may miss the end of the record
    assert run["half_cycles"] >= 142
    assert said["ok"]
    assert "taken off" in said["measured"]
    assert "light that stays where it is, 3" in said["reason"]
    _, said = measured(tmp_path / "without", WITHOUT_PIXELS)
    assert not said["ok"]
    assert "not taken off, as the record has no pixels of the spot" in said["measured"]
    assert "block it" in said["remedy"]
