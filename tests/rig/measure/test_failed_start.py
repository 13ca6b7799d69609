"""A start that fails leaves nothing in the way, and a run that was cut short is never complete."""

import json
import shutil
import time
from contextlib import closing
from pathlib import Path

import pytest

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from rig.archive.session_rows import session_rows
from rig.measure import record_plainly
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.run import MeasurementRun
from rig.measure.session_file import RunState, SessionFile, read_session
from rig.settings import load_configuration, stored_configuration
from tests.rig.command_line import CONFIGS, QUICK, rig, set_words

SHORT = set_words(QUICK)
FILES = "[camera]\ndriver = 'files'\n[camera.files]\npath = '{}'\n"
FAILING = {
    "no file": FILES.format("nowhere.avi"),
    "no library": "[camera]\ndriver = 'pylon'\n",
    "no camera": "[camera]\ndriver = 'v4l2'\n[camera.v4l2]\ndevice = '/dev/video-none'\n",
}


@pytest.mark.parametrize("why", FAILING)
def test_a_failed_start_leaves_no_folder(why: str, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(FAILING[why])
    out = tmp_path / "runs" / "first"
    done = rig("run", wrong, "-o", out, cwd=tmp_path)
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert not out.parent.exists(), done.stderr


@pytest.mark.slow
def test_a_folder_that_was_there_stays_and_takes_the_corrected_call(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(FAILING["no file"])
    rig("run", wrong, "-o", out)
    assert [path.name for path in out.iterdir()] == ["notes.txt"]
    # one that was killed before its record began is in nobody's way either
    file = SessionFile.create(out, CONFIGS / "demo.toml", 1, {})
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.close()
    done = rig("run", CONFIGS / "demo.toml", "-o", out, *SHORT)
    assert done.returncode == 0, done.stderr
    assert read_session(out).complete


@pytest.mark.slow
def test_resume_says_its_configuration_and_takes_another_and_what_is_set(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert rig("run", CONFIGS / "demo.toml", "-o", out, *SHORT).returncode == 0
    tree = json.loads((out / "session.json").read_text())
    tree["runs_wanted"] = 2
    tree["configuration"]["camera"]["driver"] = "pylon"
    (out / "session.json").write_text(json.dumps(tree))
    failed = rig("run", "--resume", out)
    assert failed.returncode == 1
    assert (
        f"continues as begun, with {CONFIGS / 'demo.toml'} (--set changes it, --config takes another)"
        in failed.stderr
    )
    done = rig("run", "--resume", out, "--config", CONFIGS / "demo.toml", *SHORT)
    assert done.returncode == 0, done.stderr
    assert 'which states camera.driver = "simulated" (was "pylon")' in done.stderr
    assert len(read_session(out).complete) == 2
    # what is said while it is measured, its record, and what is said of its results have one number
    number = read_session(out).complete[-1].number
    assert (out / f"run-{number}.mcap").exists()
    for said in (f"run {number}: SIMULATED (", f"run {number}: 100 %  done"):
        assert said in done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines() if line.startswith("SIMULATED run")] == [
        "SIMULATED run 1",
        f"SIMULATED run {number}",
    ]
    # and what is set
    done = rig("run", "--resume", out, "--set", "session.runs=x")
    assert (done.returncode, done.stderr) == (2, "rig: --set session.runs = 'x': should be a whole number\n")
    changed = {"session.runs": "3", "session.max_duration_s": "3", "session.sample": "mine"}
    done = rig("run", "--resume", out, *set_words(changed))
    assert "which states session.max_duration_s = 3.0 (was" in done.stderr
    assert "time limit of 3 s reached" in done.stderr
    assert read_session(out).configuration["session"]["sample"] == "mine"


def test_another_configuration_is_for_resume(tmp_path: Path) -> None:
    done = rig("run", CONFIGS / "demo.toml", "--config", CONFIGS / "demo.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "--config goes with --resume DIR" in done.stderr


@pytest.mark.slow
def test_a_stump_is_complete_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = MeasurementRun._watch

    def failing(run: MeasurementRun, *words: object) -> object:
        monkeypatch.setattr(MeasurementRun, "_watch", usual)
        while run.status.now.frames < 1000:
            time.sleep(0.001)
        raise RuntimeError("a defect of the program")

    monkeypatch.setattr(MeasurementRun, "_watch", failing)
    out = tmp_path / "out"
    words = ("run", CONFIGS / "demo.toml", "-o", out, *set_words({**QUICK, "session.max_duration_s": "600"}))
    assert rig(*words).returncode != 0
    with RecordReader(out / "run-1.mcap") as reader:
        end = end_of(reader.events())
    assert end is not None
    assert (end.kind, end.text) == (EventKind.FAILED, "the program has failed")

    (row,) = session_rows(out)[0]
    assert (row["state"], row["flaw"]) == ("cut short", "failed: the program has failed")
    fitted = rig("fit", out / "run-1.mcap", "-o", tmp_path / "fit")
    assert "END: the program has failed (limit its own); an error ended it" in fitted.stdout
    assert rig("report", tmp_path / "fit" / "results.json", "-o", tmp_path / "page.html").returncode == 0
    assert "an error ended it" in (tmp_path / "page.html").read_text()

    tree = json.loads((out / "session.json").read_text())
    tree["configuration"]["session"]["max_duration_s"] = 24
    (out / "session.json").write_text(json.dumps(tree))
    done = rig("run", "--resume", out)
    assert done.returncode == 0, done.stderr
    assert [(entry.record, entry.state) for entry in read_session(out).entries] == [
        ("run-1.mcap", RunState.FAILED),
        ("run-2.mcap", RunState.COMPLETE),
    ]


@pytest.mark.slow
def test_results_that_are_missing_are_made_without_the_rig(tmp_path: Path) -> None:
    config = load_configuration(CONFIGS / "demo.toml", SHORT[1::2])
    assert record_plainly(config, CONFIGS / "demo.toml", tmp_path / "run-1.mcap") == 0
    stored = stored_configuration(config)
    stored["controller"] |= {"kind": "serial", "port": "/dev/none-is-here"}
    with closing(SessionFile.create(tmp_path, CONFIGS / "demo.toml", 1, stored)) as file:
        file.note(1, "run-1.mcap", RunState.COMPLETE)
    done = rig("run", "--resume", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "there are no results yet, they are made now" in done.stderr
    assert (tmp_path / "results.json").exists()


def test_a_folder_that_goes_before_the_record_begins_is_named_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    usual = PhasesBeforeRecord._check

    def removing(phases: PhasesBeforeRecord, resting: bool) -> None:
        shutil.rmtree(out)
        usual(phases, resting)

    monkeypatch.setattr(PhasesBeforeRecord, "_check", removing)
    done = rig("run", CONFIGS / "demo.toml", "-o", out, *SHORT, "--set", "preflight.when=always")
    assert done.returncode == 1
    assert f"{out}: No such file or directory; was it removed or renamed" in done.stderr
    assert "Traceback" not in done.stderr
