"""Slips on the command line and in files are refused in one line, before anything is done."""

import json
import shutil
from pathlib import Path

import pytest

from tests.rig.command_line import CONFIGS, SAMPLES, rig
from tests.rig.long_record import make_long_record

DEMO = CONFIGS / "demo.toml"
DECAY, SERIES = SAMPLES / "decay.csv", SAMPLES / "series"
SENSOR = "sensor={gain_e_per_dn=1, read_noise_e=1, full_scale_dn=1023}"


def said(*words: str | Path, cwd: Path, status: int = 2) -> str:
    """What a command that refuses says; nothing else, but on a slow machine how far a replay has come."""
    done = rig(*words, cwd=cwd)
    assert (done.returncode, done.stdout) == (status, "")
    lines = done.stderr.splitlines(keepends=True)
    refusal = "".join(line for line in lines if not line.startswith("replaying "))
    assert refusal.startswith("rig: ")
    return refusal


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", DEMO, "-o", ""), "an argument after -o is empty"),
        (("run", DEMO, "--output="), "an argument is empty"),
        (("camera", "snap", DEMO, "-o", "a.jpg"), "a.jpg: name a file that ends in .png"),
        (("camera", "snap", DEMO, "-o", "none/a.png"), "none/a.png: there is no folder none"),
        (("camera", "show", DEMO, "--set", SENSOR), "sensor.full_scale_dn = 1023: the camera"),
        (("plan", DEMO, "--last", "400"), "--last 400: should be below the first amplitude, 300 arcsec"),
        (("plan", DEMO, "--contact", "no.json"), "no.json: no such file"),
        (("run", DEMO, "--view", "tv"), "--view tv: 'tv' is not one of 'window', 'web'"),
        (
            ("calibrate", "lever", "no.toml"),
            "no.toml: no such file; docs/calibrate.md shows such a list",
        ),
        (
            ("calibrate", "check", DEMO, "--lever", "no.toml"),
            "no.toml: no such file; rig calibrate lever makes one",
        ),
        (
            ("compare", "--archive", "a.duckdb", "--model", "no.toml"),
            "no.toml: no such file; docs/many-runs.md shows",
        ),
        (("run", "no.toml"), "no.toml: no such file; rig init writes"),
        (("replay", "no.mcap"), "no.mcap: no such record; give the path of a record, which rig run makes"),
        (
            ("view", "no/x.mcap"),
            "no/x.mcap: no such record; there is no folder no; give the path of a record",
        ),
        (("run",), "Missing argument"),
        (("rnu",), "Did you mean"),
        (("run", DEMO, "--set", "session.rnus=3"), "did you mean runs?"),
        (("fit", "no.csv"), "no such file"),
        (("run",), "--help shows what is needed, for example rig run configs/demo.toml -o runs/first"),
        (("camera", "show"), "for example rig camera show mine.toml"),
        (("camera", "frames", DEMO), "for example rig camera frames mine.toml -o level-1"),
        (("run", DEMO, "-o", "a.xlsx"), "a.xlsx: is the name of a file, and a folder is written"),
        (("view", "run-1.mcap", "--layout", "balance"), "'analysing'; did you mean balancing?\n"),
        (("view", "run-1.mcap", "--layout=measure"), "'analysing'; did you mean measuring?\n"),
        (("view", "run-1.mcap", "--layout=x"), "'measuring', 'analysing'\n"),
        (
            ("run", "run-1.mcap"),
            "is a record, not a configuration file; rig init writes one; rig record",
        ),
        (
            ("camera", "align", "run-1.mcap"),
            "run-1.mcap: is a record, not a configuration file",
        ),
        (("doctor", "my", "rig.toml"), "my: no such file or folder; put a name with spaces in quotes"),
        (("run", "--resume", ".", "--runs", "2"), "--resume takes its configuration from DIR"),
        (("fit", "a.mcap", "a.mcap"), "a.mcap: named twice; a run counts once"),
        (("balance", DEMO, "--rrd", "none/a.rrd"), "none/a.rrd: there is no folder none"),
        (("balance", DEMO, "--rrd", "."), ".: is a folder; name a file in it"),
        (("run", DEMO, "--runs", "2", "--set", "session.runs=3"), "session.runs is stated twice"),
        (("doctor", DEMO, "--set", "session=3"), "session = 3: should be a table with keys of its own"),
        (("calibrate", "lever", "run-1.mcap"), "run-1.mcap: is a record, not a list of measured"),
        (("fit", DEMO), f"{DEMO}: is not a table; name a record"),
        (
            ("doctor", DEMO, "--set", "max_duration_s=3"),
            "unknown key; did you mean session.max_duration_s or",
        ),
        (
            ("doctor", DEMO, "--set", "exposure=50"),
            "--set exposure: unknown key; did you mean camera.exposure_us?",
        ),
        (
            ("run", "exposure=50"),
            "exposure=50: no such file; a key of the configuration is changed by --set exposure=50",
        ),
        (("record", "info", "."), ".: holds no record (run-1.mcap, ...)"),
        (("doctor", DEMO, "rig.toml"), "extra argument (rig.toml); put a name with spaces in quotes"),
        (("compare", ".", "."), ".: holds no results.json; rig run makes one"),
        (("report", "secnd"), "secnd: no such file or folder"),
        (("replay", "none/a.mcap"), "none/a.mcap: no such record; there is no folder none"),
        (("fit", DEMO.with_name("demo")), "no such file or folder"),
        (("run", DEMO.with_name("dmeo.toml")), f"no such file; {DEMO.parent} has "),
        (
            ("fit", "table.csv", "--set", "fit.drag=true"),
            "--set fit.drag=true: has no effect without --config",
        ),
        (("fit", "run-1.mcap", "--unit", "arcsec"), "--unit: has no effect on records"),
        (("fit", "run-1.mcap", "--time-unit", "ms"), "--time-unit: has no effect on records"),
    ],
)
def test_a_slip_is_refused(tmp_path: Path, words: tuple[str | Path, ...], message: str) -> None:
    given = {tmp_path / word for word in words if word in ("table.csv", "run-1.mcap", "a.mcap")}
    for path in given:
        path.touch()
    assert message in said(*words, cwd=tmp_path)
    assert set(tmp_path.iterdir()) == given


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("runs = 1,5\n", "a decimal point is meant: 1.5"),
        ("sample = steel\n", "put text in quotes"),
        ("runs = 1\nruns = 2\n", "this is stated twice"),
        ("sample = 'caf\xe9'\n", "bytes that are not UTF-8 text"),
    ],
)
def test_what_toml_does_not_say_is_said(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mine.toml").write_bytes(f"[session]\n{text}".encode("latin-1"))
    for command in (
        ("doctor", "mine.toml"),
        ("calibrate", "lever", "mine.toml"),
    ):
        assert message in said(*command, cwd=tmp_path)


def test_a_dotted_key_below_its_section_and_a_missing_base_are_said(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(f'extends = "{DEMO}"\n[camera]\ncamera.exposure_us = 100\n')
    assert "camera.camera.exposure_us: unknown key; below [camera] it is exposure_us, without" in said(
        "doctor", "mine.toml", cwd=tmp_path
    )
    (tmp_path / "mine.toml").write_text('extends = "demo.toml"\n')
    assert said("doctor", "mine.toml", cwd=tmp_path) == (
        f"rig: mine.toml: extends = 'demo.toml': no such file in {tmp_path}, the folder of this one\n"
    )


def test_every_fault_of_a_calibrations_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "frames.toml").write_text("darks = 3\n")
    assert "is a configuration of the rig; a list of measured values is needed here" in said(
        "calibrate", "lever", DEMO, cwd=tmp_path
    )
    (tmp_path / "g.toml").write_text("[geometry]\narm_m = 1.0\npixel_pitch_m = 4.8e-6\n")
    rig("calibrate", "lever", "g.toml", cwd=tmp_path)
    assert said("calibrate", "lever", "calibrations/lever-001.toml", cwd=tmp_path) == (
        "rig: calibrations/lever-001.toml: is a calibration that rig calibrate made; the list of values "
        "measured for it is needed here, docs/calibrate.md shows one\n"
    )
    assert said("calibrate", "sensor", "frames.toml", cwd=tmp_path) == (
        "rig: frames.toml: darks = 3: should be the name of a file, in quotes; level: is missing; "
        "state a value; docs/calibrate.md shows such a file\n"
    )
    (tmp_path / "frames.toml").write_text("darks = 'd'\n[[level]]\nframes = 'a'\n[[level]]\nframe = 'b'\n")
    answer = said("calibrate", "sensor", "frames.toml", cwd=tmp_path)
    assert "level 2: frame: unknown key; did you mean frames?; level 2: frames: is missing" in answer
    (tmp_path / "ladder.toml").write_text("u_reference_relative = 5\n")
    assert "u_reference_relative = 5: should be less than 1" in said(
        "calibrate", "lever", "ladder.toml", cwd=tmp_path
    )
    (tmp_path / "ladder.toml").write_text("pixel_pitch_m = 4.8e-6\n[[step]]\nreference = 1\nu_px = 0.01\n")
    assert said("calibrate", "lever", "ladder.toml", cwd=tmp_path, status=1) == (
        "rig: ladder.toml: the ladder has 1 of the 5 steps that are needed at least\n"
    )


def test_files_of_calibrations_are_refused_in_our_words(tmp_path: Path) -> None:
    (tmp_path / "frames.toml").write_text('darks = "none"\n[[level]]\nframes = "none"\n')
    assert said("calibrate", "sensor", "frames.toml", cwd=tmp_path) == (
        "rig: frames.toml: darks = 'none', level 1: frames = 'none': no such record, folder or file of "
        f"frames in {tmp_path}, where this list lies\n"
    )
    calibrations = Path(__file__).resolve().parents[1] / "data" / "samples" / "calibrations"
    good = next(calibrations.glob("lever*.toml")).read_text()
    (tmp_path / "lever.toml").write_text(good.replace("schema_version = 1", "schema_version = 99"))
    answer = said("doctor", DEMO, "--set", "calibration.lever=lever.toml", cwd=tmp_path)
    assert "lever.toml: is of schema 99; this version reads schema 1" in answer
    for wrong, message in (
        ("made_at = 'soon'", "made_at = 'soon': should be a time with its offset from UTC"),
        ('kind = "leaver"', "kind = 'leaver': should be 'lever', 'axes'"),
        ("methud = 1", "methud: unknown key"),
        ("sources = 3", "sources = 3: should be a list"),
    ):
        key = wrong.partition(" ")[0]
        kept = [line for line in good.partition("\n[")[0].splitlines() if not line.startswith(f"{key} =")]
        (tmp_path / "lever.toml").write_text("\n".join([*kept, wrong, ""]))
        answer = said("doctor", DEMO, "--set", "calibration.lever=lever.toml", cwd=tmp_path)
        assert f"lever.toml: is not a calibration file ({message}" in answer
        assert "rig calibrate makes one" in answer


@pytest.mark.slow
def test_a_changed_key_that_nothing_uses_is_refused(tmp_path: Path) -> None:
    record = SERIES / "run-1.mcap"
    noise = ("--set", "sensor.read_noise_e=40")
    assert "what the tracker takes needs --retrack" in said("replay", record, *noise, cwd=tmp_path)
    assert "--set camera.exposure_us: has no effect here" in said(
        "replay", record, "--retrack", "--set", "camera.exposure_us=5", cwd=tmp_path
    )
    assert "--set lever.arm_m: has no effect here" in said(
        "fit", record, "--set", "lever.arm_m=2", "-o", "fit", cwd=tmp_path
    )
    assert not (tmp_path / "fit" / "results.json").exists()
    table = ("fit", DECAY, "--unit", "arcsec", "-o", tmp_path / "fit", "--config")
    assert "--set session.runs: has no effect here; a table holds" in said(
        *table, "session.toml", "--set", "session.runs=3", cwd=DECAY.parent
    )
    assert f"calibration.lever = 'lever.toml': no such file in {tmp_path}, where the command" in said(
        *table, DEMO, "--set", "calibration.lever=lever.toml", cwd=tmp_path
    )
    assert not (tmp_path / "fit" / "results.json").exists()
    assert "--set sesion: unknown key; did you mean session?" in said(
        "replay", record, "--set", "sesion.runs=1", cwd=tmp_path
    )


@pytest.mark.slow
def test_a_key_that_is_used_is_never_refused(tmp_path: Path) -> None:
    """The doubt of a shutter's rows is of the fit, its rows themselves of the recorded times."""
    record = SERIES / "run-1.mcap"
    doubt, rows = ("--set", "shutter.u_row_time_s=1e-5"), ("--set", "shutter.row_time_s=1e-5")
    for folder, words in (("plain", ()), ("doubtful", doubt)):
        assert rig("fit", record, *words, "-o", folder, cwd=tmp_path).returncode == 0
    (before, after) = (
        json.loads((tmp_path / folder / "results.json").read_text())["runs"][0]["budget"]
        for folder in ("plain", "doubtful")
    )
    assert before != after
    assert "--set shutter.row_time_s: has no effect here" in said("fit", record, *rows, cwd=tmp_path)


def test_folders_work_wherever_records_do(measured_series: Path, tmp_path: Path) -> None:
    shown = rig("record", "info", measured_series, cwd=tmp_path).stdout
    assert shown.count(".mcap: ") == shown.count(", whole\n") == 4
    assert rig("record", "check", measured_series, cwd=tmp_path).stdout.count(" is sound\n") == 2
    for command in (("replay",), ("record", "recover"), ("plan",)):
        several = said(*command, measured_series, cwd=tmp_path)
        assert "holds 2 records; name one of them: run-1.mcap, run-2.mcap" in several
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "run-1.mcap").symlink_to(measured_series / "run-1.mcap")
    assert "nothing to recover" in rig("record", "recover", "one", cwd=tmp_path).stdout
    assert "is not a results file" in said("report", "one/run-1.mcap", cwd=tmp_path, status=1)


@pytest.mark.parametrize(
    ("sample", "begins"),
    [
        (
            "first",
            ["amplitude    118.00 to 61.04 arcsec", "half-cycles  15, 1 of", "result       b = 0.0300 ±"],
        ),
        (
            "uncalibrated",
            ["amplitude    100.00 to 68.39 px", "half-cycles  20, 0 of", "result       not fitted"],
        ),
        (
            "alone",
            ["amplitude    118.00 to 61.04 arcsec", "half-cycles  15, 1 of", "result       none yet; rig f"],
        ),
    ],
)
def test_info_begins_with_the_decay_and_its_result(tmp_path: Path, sample: str, begins: list[str]) -> None:
    folder = DECAY.parent / ("first" if sample == "alone" else sample)
    if sample == "alone":
        shutil.copy(folder / "run-1.mcap", tmp_path)
        folder = tmp_path
    lines = rig("record", "info", folder).stdout.splitlines()
    assert lines[0].endswith(", whole")
    assert [line[: len(begin)] for line, begin in zip(lines[1:4], begins, strict=True)] == begins


@pytest.mark.parametrize("group", [(), ("camera",), ("calibrate",)])
def test_a_group_alone_prints_its_help_and_every_command_has_a_whole_sentence(
    group: tuple[str, ...], tmp_path: Path
) -> None:
    alone = rig(*group, cwd=tmp_path)
    assert (alone.returncode, alone.stdout) == (2, "")
    heading = "\nCommands:\n" if group else "\nMeasure:\n"
    assert heading in alone.stderr
    assert alone.stderr == rig(*group, "--help", cwd=tmp_path).stdout
    assert not [line for line in alone.stderr.splitlines()[1:] if line.endswith("...")]
    commands = alone.stderr.partition(heading)[2].split("\n")
    assert "Example" in rig(*group, commands[0].split()[0], "--help", cwd=tmp_path).stdout


def test_a_copied_record_is_no_second_run(tmp_path: Path) -> None:
    record = make_long_record(tmp_path / "run-1.mcap", 100)
    shutil.copy(record, tmp_path / "run-2.mcap")
    for words in (("fit", record, "run-2.mcap"), ("fit", ".")):
        message = said(*words, "-o", "fit", cwd=tmp_path)
        assert "run-2.mcap: holds the run of" in message
        assert "run-1.mcap (same hash), which counts once in a series" in message
        assert not (tmp_path / "fit").exists()


def test_a_missing_configuration_is_not_offered_what_is_none(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "mine.toml").touch()
    assert "; . has mine.toml; rig init" in said("run", "nothere.toml", cwd=tmp_path)


@pytest.mark.parametrize("command", [("run",), ("view",), ("fit",), ("archive", "add")])
def test_help_names_one_of_several_values(tmp_path: Path, command: tuple[str, ...]) -> None:
    text = rig(*command, "--help", cwd=tmp_path).stdout
    assert "<path>" in text
    assert "list[" not in text
