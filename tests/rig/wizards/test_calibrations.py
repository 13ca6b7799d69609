"""`rig calibrate` without a file asks step by step, and files what the same measurement in a file would."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from calibration import read_calibration
from processing.errors import ConfigurationError
from rig.calibrate import Filing, calibrate_lever
from rig.wizards import (
    KINDS,
    Draft,
    Question,
    answered,
    as_far_as_it_holds,
    calibration_wizard,
    filed,
    keep_draft,
    kept_draft,
    progress,
)
from tests.calibration.simulated_sensor import random_sensor, transfer_frames
from tests.rig.command_line import rig

ARCSEC_PX = 4.8481368e-6 * 2 * 1.0 / 4.8e-6
READINGS = [-60.0, -30.0, 0.0, 30.0, 60.0, 0.0]
LADDER = ["tilt", "", "4.8 um", "0.05", "1e-3"]
REST = """
[session]
output = "runs"
[camera]
driver = "simulated"
frame_rate_hz = 50
exposure_us = 100.0
[simulation]
max_duration_s = 4
[simulation.sensor]
width_px = 160
[simulation.release]
way = "by command"
[simulation.fast]
amplitude_arcsec = 0.0
"""


def typed(*answers: str) -> str:
    return "".join(f"{answer}\n" for answer in answers)


def steps() -> list[str]:
    answers = []
    for number, reading in enumerate(READINGS):
        y_px = 320.0 - reading * ARCSEC_PX + 0.005 * (-1) ** number
        answers += [f"{reading:g}", f"160.0 {y_px:.4f} 0.01"]
    return answers


def test_a_lever_from_lengths(tmp_path: Path) -> None:
    done = rig("calibrate", "lever", cwd=tmp_path, typed=typed("geometry", "1 m ± 1 mm", "4.8 um", ""))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "calibrations/lever-001.toml"
    assert "contribution, %" in done.stdout
    table = tomllib.loads((tmp_path / "calibrations/lever-geometry-001.toml").read_text("utf-8"))
    assert table == {"geometry": {"arm_m": 1.0, "u_arm_m": 0.001, "pixel_pitch_m": 4.8e-6}}
    found = read_calibration(tmp_path / "calibrations/lever-001.toml", "lever")
    assert found.values["arm_m"] == pytest.approx(1.0)
    assert [source.name for source in found.sources] == ["lever-geometry-001.toml"]
    assert not (tmp_path / "calibrations/lever-answers.json").exists()


def test_angles_are_asked_where_the_beam_is_not_square(tmp_path: Path) -> None:
    wizard = calibration_wizard("lever")
    draft = Draft()
    for text in ("geometry", "1", "4.8 um", "no", "10 deg ± 0.5 deg", "", "", "", "6.05 mm", "0", ""):
        draft = answered(wizard, draft, text)
    found = read_calibration(wizard.file(progress(wizard, draft).values, Filing(tmp_path)))
    budget = {line["name"]: line for line in found.details["budget"]}
    assert budget["incidence_along_rad"]["value"] == pytest.approx(np.radians(10.0))
    assert budget["incidence_along_rad"]["contribution"] > 0


def test_a_ladder_goes_on_after_a_break_and_gives_what_its_file_gives(tmp_path: Path) -> None:
    kept = tmp_path / "calibrations/lever-answers.json"
    broken_off = rig("calibrate", "lever", cwd=tmp_path, typed=typed(*LADDER, *steps()[:5]))
    assert broken_off.returncode == 2
    assert broken_off.stderr.splitlines()[-1].startswith("rig: the answers end at: The spot there")
    assert len(kept_draft(kept).answers) == len(LADDER) + 5
    done = rig("calibrate", "lever", cwd=tmp_path, typed=typed(*steps()[5:], "", ""))
    assert done.returncode == 0, done.stderr
    assert "continues after the 10 answers" in done.stderr
    assert not kept.exists()
    assert "residuals of the steps" in done.stdout
    ladder = tmp_path / "calibrations/lever-ladder-001.toml"
    again = read_calibration(calibrate_lever(ladder, Filing(tmp_path / "again")))
    found = read_calibration(tmp_path / "calibrations/lever-001.toml")
    assert found.values == again.values
    assert found.values["arm_m"] == pytest.approx(1.0, rel=1e-3)
    assert found.method == "ladder of 6 tilts"


@pytest.mark.parametrize(
    ("before", "wrong", "said"),
    [
        ([], "weight", "choose one of geometry, tilt, shift"),
        (["geometry"], "4.8 inch", "has the unit inch; m is meant, or mm, um or nm"),
        (["geometry"], "-1", "geometry.arm_m = -1.0: should be greater than 0 m"),
        (["geometry", "1"], "4.8", "geometry.pixel_pitch_m = 4.8: should be less than 0.001 m"),
        (["tilt"], "mm", "choose one of arcsec"),
        (["tilt", "", "4.8 um"], "-1", "should be 0 arcsec or more"),
        ([*LADDER, "-60"], "160 320", "there is no such record"),
        ([*LADDER, "-60"], "160 320 0", "should be greater than 0 px"),
        ([*LADDER, "-60"], "none.mcap", "there is no such record"),
        (LADDER, "", "an answer is needed here"),
    ],
)
def test_what_is_typed_wrongly_is_said_in_one_line(before: list[str], wrong: str, said: str) -> None:
    wizard = calibration_wizard("lever")
    draft = Draft()
    for text in before:
        draft = answered(wizard, draft, text)
    with pytest.raises(ConfigurationError) as caught:
        answered(wizard, draft, wrong)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_does_not_serve_is_asked_again_and_what_was_answered_is_kept(tmp_path: Path) -> None:
    one_sign = []
    for reading in (1, 2, 3, 4, 5):
        one_sign += [str(reading), f"160 {320 - reading * ARCSEC_PX:.3f} 0.01"]
    done = rig("calibrate", "lever", cwd=tmp_path, typed=typed(*LADDER, *one_sign, "", "1"))
    assert done.returncode == 1
    assert "one sign" in done.stderr.splitlines()[-1]
    kept = kept_draft(tmp_path / "calibrations/lever-answers.json")
    assert kept.answers[-1] == ("reading 6", "")


def test_the_sensor_from_stacks(tmp_path: Path) -> None:
    pairs, darks, exposures = transfer_frames(random_sensor(np.random.default_rng(8)), 3)
    np.save(tmp_path / "dark.npy", np.stack(darks))
    answers = ["dark.npy", ""]
    for number, (pair, exposure) in enumerate(zip(pairs, exposures, strict=True)):
        np.save(tmp_path / f"level-{number}.npy", np.stack(pair))
        answers += [f"{exposure}", f"level-{number}.npy"]
    bits = random_sensor(np.random.default_rng(8)).bit_depth
    answers[1] = str(2**bits - 1)
    done = rig("calibrate", "sensor", cwd=tmp_path, typed=typed(*answers, ""))
    assert done.returncode == 0, done.stderr
    assert "residuals of the levels" in done.stdout
    (tables,) = [
        table
        for table in filed(tmp_path / "calibrations/sensor-001.toml").tables
        if table.name == "residuals"
    ]
    off = np.array([float(row[3]) for row in tables.rows])
    assert np.sqrt(np.mean(off**2)) < 3.0


@pytest.fixture(scope="module")
def resting_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rest") / "rest.toml"
    path.write_text(REST, encoding="utf-8")
    return path


def test_with_a_configuration_it_records_what_it_asks_for(resting_rig: Path, tmp_path: Path) -> None:
    done = rig("calibrate", "pointing", "--config", resting_rig, cwd=tmp_path, typed=typed(""))
    assert done.returncode == 0, done.stderr
    record = tmp_path / "calibrations/records/pointing-001.mcap"
    assert record.exists()
    assert "Allan deviation of x" in done.stdout
    swinging = resting_rig.with_name("swing.toml")
    swinging.write_text(REST.replace('way = "by command"', "").replace("= 4", "= 12"), encoding="utf-8")
    refused = rig("calibrate", "pointing", "--config", swinging, cwd=tmp_path, typed=typed(""))
    assert refused.returncode == 1
    assert "pendulum swings" in refused.stderr.splitlines()[-1]
    assert record.with_name("pointing-002.mcap").exists(), "what was recorded is never lost"
    axes = rig("calibrate", "axes", cwd=tmp_path, typed=typed("calibrations/records", "+", ""))
    assert axes.returncode == 2
    assert "holds 2 records; name one of them" in axes.stderr


def test_axes_from_a_record_with_the_sides_that_were_stated(resting_rig: Path, tmp_path: Path) -> None:
    swings = resting_rig.with_name("swings.toml")
    text = REST.replace('way = "by command"', "").replace("= 4", "= 12").replace("= 0.0", "= 10.0")
    swings.write_text(text, encoding="utf-8")
    assert rig("simulate", swings, "-o", "both.mcap", cwd=tmp_path).returncode == 0
    done = rig("calibrate", "axes", cwd=tmp_path, typed=typed("both.mcap", "+", "2"))
    assert done.returncode == 0, done.stderr
    stated = rig(
        *("calibrate", "axes", "both.mcap", "--slow-began", "+", "--fast-began", "-", "-o", "by-option"),
        cwd=tmp_path,
    )
    assert stated.returncode == 0, stated.stderr
    found = [read_calibration(tmp_path / name / "axes-001.toml") for name in ("calibrations", "by-option")]
    assert found[0].values == found[1].values
    assert found[0].details["signs_known"]
    assert "direction of the slow mode" in done.stdout


@pytest.mark.parametrize(("factor", "moved"), [(1.0, False), (1.02, True)])
def test_a_lever_is_checked_against_known_tilts(tmp_path: Path, factor: float, moved: bool) -> None:
    rig("calibrate", "lever", cwd=tmp_path, typed=typed("geometry", "1 m ± 1 mm", "4.8 um", ""))
    lever = tmp_path / "calibrations/lever-001.toml"
    wizard, draft = calibration_wizard("check"), Draft()
    with pytest.raises(ConfigurationError, match=r"none\.toml: cannot read the calibration"):
        answered(wizard, draft, "none.toml")
    answers = [str(lever), *LADDER[1:]]
    for reading in READINGS:
        answers += [f"{reading:g}", f"160.0 {320.0 - factor * reading * ARCSEC_PX:.4f} 0.01"]
    done = rig("calibrate", "check", cwd=tmp_path, typed=typed(*answers, "", ""))
    assert done.returncode == 0, done.stderr
    made = filed(tmp_path / "calibrations/check-001.toml")
    assert made.calibration.details["moved"] is moved
    assert made.calibration.details["ratio"] == pytest.approx(factor, rel=2e-3)
    assert ("calibrate again" in done.stdout) is moved
    assert made.configuration.splitlines()[-1].startswith("checks = [")
    ladder = tmp_path / "calibrations/check-ladder-001.toml"
    again = rig("calibrate", "check", ladder, "--lever", lever, "-o", tmp_path / "again", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert read_calibration(tmp_path / "again/check-001.toml").details == made.calibration.details


def test_a_check_needs_both_its_files_or_asks_for_both(tmp_path: Path) -> None:
    (tmp_path / "a.toml").touch()
    for words, said in ((["a.toml"], "--lever"), (["--lever", "a.toml"], "leave the option out")):
        done = rig("calibrate", "check", *words, cwd=tmp_path)
        assert done.returncode == 2
        assert said in done.stderr


@pytest.mark.parametrize(("bits", "taken"), [("", None), ("32", 32), ("8", ""), ("32.5", ""), ("many", "")])
def test_the_width_of_a_counter(tmp_path: Path, bits: str, taken: object) -> None:
    (tmp_path / "a.mcap").touch()
    wizard = calibration_wizard("clock")
    draft = answered(wizard, Draft(), str(tmp_path / "a.mcap"))
    if taken == "":
        with pytest.raises(ConfigurationError):
            answered(wizard, draft, bits)
    else:
        assert progress(wizard, answered(wizard, draft, bits)).values["counter_bits"] == taken


def test_records_and_frames_by_their_own_commands(resting_rig: Path, tmp_path: Path) -> None:
    done = rig("camera", "record", resting_rig, "-o", "clamped.mcap", "--seconds", "2", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "clamped.mcap\n"), done.stderr
    assert rig("calibrate", "pointing", "clamped.mcap", cwd=tmp_path).returncode == 0
    done = rig("camera", "frames", resting_rig, "-o", "dark", "-n", "3", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "dark\n"), done.stderr
    assert sorted(path.name for path in (tmp_path / "dark").iterdir()) == ["000.png", "001.png", "002.png"]
    again = rig("camera", "frames", resting_rig, "-o", "dark", cwd=tmp_path)
    assert "exists already" in again.stderr
    assert "ends in .mcap" in rig("camera", "record", resting_rig, "-o", "a.txt", cwd=tmp_path).stderr


def test_answers_that_do_not_hold_any_more_are_asked_again(tmp_path: Path) -> None:
    record = tmp_path / "one.mcap"
    record.touch()
    wizard = calibration_wizard("axes")
    draft = answered(wizard, answered(wizard, Draft(), str(record)), "+")
    path = tmp_path / "folder/axes-answers.json"
    keep_draft(path, draft)
    assert kept_draft(path) == draft
    record.unlink()
    assert as_far_as_it_holds(wizard, kept_draft(path)) == Draft()
    path.write_text('{"a": 1', encoding="utf-8")
    with pytest.raises(ConfigurationError, match="holds no answers"):
        kept_draft(path)


def test_every_kind_has_a_wizard_whose_first_question_says_what_to_do() -> None:
    first = [progress(calibration_wizard(kind), Draft()).question for kind in KINDS]
    assert all(isinstance(question, Question) for question in first)
    assert {question.recording.kind for question in first if question and question.recording} == {
        "record",
        "frames",
    }
    with pytest.raises(ConfigurationError, match="there are lever, axes"):
        calibration_wizard("weight")


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are those of POSIX")
def test_at_a_terminal_a_wrong_measurement_is_mended(tmp_path: Path) -> None:
    from tests.rig.pseudo_terminal import Terminal

    terminal = Terminal("calibrate", "lever", cwd=tmp_path, on_screen=True)
    try:
        terminal.wait_for("How was it measured:")
        terminal.press("1\n")
        terminal.wait_for("Mirror to sensor")
        terminal.press("1 yard\n")
        terminal.wait_for("has the unit yard")
        terminal.press("1 m\n")
        terminal.wait_for("neighbouring pixels")
        terminal.press("4.8 um\n")
        terminal.wait_for("right angles")
        terminal.press("\n")
        terminal.wait_for("calibrations/lever-001.toml")
        terminal.end()
        assert terminal.process.returncode == 0
    finally:
        terminal.close()
