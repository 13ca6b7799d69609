"""The files of a session are whole and believed only after reading; starts that fail, sessions that go on."""

import datetime
import json
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Self

import pytest

from acquisition.record import records_in_folder
from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.errors import ConfigurationError
from rig.archive.session_rows import session_rows
from rig.devices import Devices
from rig.measure import session
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.run import MeasurementRun, _check_path
from rig.measure.run_parts import RunOutcome, RunPlan
from rig.measure.session_file import RunState, SessionFile, read_session
from tests.disk_without_locks import NO_LOCKS, without_locks
from tests.rig.command_line import CONFIGS, QUICK, SAMPLES, SMALL, Done, rig, run, set_words

DEMO = CONFIGS / "demo.toml"
FILES = "[camera]\ndriver = 'files'\n[camera.files]\npath = '{}'\n"
FAILING = {
    "no file": FILES.format("nowhere.avi"),
    "no library": "[camera]\ndriver = 'pylon'\n",
    "no camera": "[camera]\ndriver = 'v4l2'\n[camera.v4l2]\ndevice = '/dev/video-none'\n",
}


def sample(name: str, folder: Path, change: Callable[[dict[str, Any]], object] = lambda _: None) -> Path:
    """A copy of a measured session, with its state changed, beside its calibrations."""
    shutil.copytree(SAMPLES / name, folder)
    shutil.copytree(SAMPLES / "calibrations", folder.parent / "calibrations")
    tree = json.loads((folder / "session.json").read_text())
    change(tree)
    (folder / "session.json").write_text(json.dumps(tree))
    return folder


def resumed(folder: Path, *words: str | Path) -> Done:
    return rig("run", "--resume", folder, *words, cwd=folder.parent)


def test_no_file_elsewhere_is_reached_through_a_symbolic_link(tmp_path: Path) -> None:
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.write_text("precious")
    folder.mkdir()
    (folder / ".session.lock").symlink_to(elsewhere)
    with pytest.raises(ConfigurationError, match=r"\.session\.lock: cannot be opened"):
        SessionFile.create(folder, DEMO, 1, {})
    (folder / ".session.lock").unlink()
    file = SessionFile.create(folder, DEMO, 1, {})
    (folder / "session.json").unlink()
    (folder / "session.json").symlink_to(elsewhere)
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.close()
    assert elsewhere.read_text() == "precious"
    assert not (folder / "session.json").is_symlink()


def test_a_session_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    SessionFile.create(tmp_path, DEMO, 1, {}).close()
    with pytest.raises(ConfigurationError, match="already holds a session; rig run --resume"):
        SessionFile.create(tmp_path, DEMO, 1, {})


@pytest.mark.parametrize("why", FAILING)
def test_a_failed_start_leaves_no_folder_and_one_that_was_there_as_it_was(why: str, tmp_path: Path) -> None:
    wrong, out, mine = tmp_path / "wrong.toml", tmp_path / "runs" / "first", tmp_path / "mine"
    wrong.write_text(FAILING[why])
    mine.mkdir()
    (mine / "notes.txt").touch()
    for folder in (out, mine):
        done = rig("run", wrong, "-o", folder, cwd=tmp_path)
        assert done.returncode in (1, 2)
        assert "Traceback" not in done.stderr
    assert not out.parent.exists()
    assert [path.name for path in mine.iterdir()] == ["notes.txt"]


def test_a_session_that_was_killed_before_its_record_began_is_in_nobodys_way(tmp_path: Path) -> None:
    with closing(SessionFile.create(tmp_path, DEMO, 1, {})) as file:
        file.note(1, "run-1.mcap", RunState.RECORDING)
    run(tmp_path, QUICK, session__max_duration_s="3")
    assert read_session(tmp_path).complete


@pytest.mark.slow
def test_resume_says_its_configuration_and_takes_another_and_what_is_set(tmp_path: Path) -> None:
    def two_by_another(tree: dict[str, Any]) -> None:
        tree["runs_wanted"] = 2
        tree["configuration"]["camera"]["driver"] = "pylon"

    out = sample("first", tmp_path / "out", two_by_another)
    failed = resumed(out)
    assert failed.returncode == 1
    assert "continues as begun, with " in failed.stderr
    assert "session.toml (--set changes it, --config takes another)" in failed.stderr
    done = resumed(out, "--config", DEMO, *set_words(QUICK))
    # for the frames that the first run has lost
    assert done.returncode == 1, done.stderr
    assert 'camera.driver = "simulated" (was "pylon")' in done.stderr
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
    done = resumed(out, "--set", "session.runs=x")
    assert (done.returncode, done.stderr) == (2, "rig: --set session.runs = 'x': should be a whole number\n")
    changed = {"session.runs": "3", "session.max_duration_s": "3", "session.sample": "mine"}
    done = resumed(out, *set_words(changed))
    assert "which states session.max_duration_s = 3.0 (was" in done.stderr
    assert "time limit of 3 s reached" in done.stderr
    assert read_session(out).configuration["session"]["sample"] == "mine"


def test_resume_wants_a_session_and_another_configuration_is_for_resume(tmp_path: Path) -> None:
    (tmp_path / "demo.toml").touch()
    for words, said in (
        (("--resume", tmp_path), "contains no session"),
        (("--resume", tmp_path / "demo.toml"), "demo.toml: is a file; name the folder of a session"),
        ((DEMO, "--config", DEMO), "--config goes with --resume DIR"),
    ):
        done = rig("run", *words, cwd=tmp_path)
        assert done.returncode == 2
        assert said in done.stderr


@pytest.mark.slow
def test_a_series_that_was_killed_goes_on(tmp_path: Path) -> None:
    folder = sample("series", tmp_path / "out")
    with closing(SessionFile.opened(folder)):
        running = resumed(folder)
    assert running.returncode == 2
    assert "still running" in running.stderr
    before = {name: (folder / name).read_bytes() for name in ("run-1.mcap", "run-2.mcap")}
    done = resumed(folder)
    assert "Traceback" not in done.stderr
    for name, content in before.items():
        assert (folder / name).read_bytes() == content
    assert {entry.record: entry.state for entry in read_session(folder).entries} == {
        "run-1.mcap": "complete",
        "run-2.mcap": "interrupted",
        "run-3.mcap": "complete",
    }
    with RecordReader(folder / "run-2-recovered.mcap") as reader:
        assert not reader.truncated
        assert len(reader.spots()) > 300
    # those that were there are of one run alone
    results = json.loads((folder / "results-2.json").read_text())
    assert [made["record"] for made in results["runs"]] == ["run-1.mcap", "run-3.mcap"]
    assert "no run is missing" in resumed(folder).stderr


@pytest.mark.slow
def test_a_record_that_came_to_its_end_is_complete(tmp_path: Path) -> None:
    """The program ended after the record was closed and before anything else was noted."""
    ended = sample("first", tmp_path / "out", lambda tree: tree["entries"][-1].update(state="recording"))
    whole = (ended / "results.json").read_text()
    # half a file, as an older version left it when the power failed
    (ended / "results.json").write_text(whole[: len(whole) // 2])
    before = (ended / "run-1.mcap").read_bytes()
    done = resumed(ended)
    assert "run-1.mcap is whole: time limit" in done.stderr
    assert "1 of 1 runs are complete" in done.stderr
    assert "rig init --example basement writes the same rig in an ordinary basement" in done.stderr
    assert [path.name for path in records_in_folder(ended)] == ["run-1.mcap"]
    assert (ended / "run-1.mcap").read_bytes() == before
    assert json.loads((ended / "results-2.json").read_text())["runs"][0]["record"] == "run-1.mcap"
    reports = list(ended.glob("report*.html"))
    reports[0].unlink()
    assert "no run is missing" in resumed(ended).stderr
    assert list(ended.glob("report*.html")) == reports


@pytest.mark.slow
def test_results_that_are_missing_are_made_without_the_rig(tmp_path: Path) -> None:
    def elsewhere(tree: dict[str, Any]) -> None:
        tree["configuration"]["controller"] |= {"kind": "serial", "port": "/dev/none-is-here"}

    folder = sample("first", tmp_path / "out", elsewhere)
    (folder / "results.json").unlink()
    assert "there are no results yet, they are made now" in resumed(folder).stderr
    assert (folder / "results.json").exists()


@pytest.mark.slow
def test_a_stump_is_complete_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = MeasurementRun._watch

    def failing(measuring: MeasurementRun, *words: object) -> object:
        monkeypatch.setattr(MeasurementRun, "_watch", usual)
        while measuring.status.now.frames < 700:
            time.sleep(0.001)
        raise RuntimeError("a defect of the program")

    monkeypatch.setattr(MeasurementRun, "_watch", failing)
    stump = run(tmp_path / "out", QUICK, session__max_duration_s="600")
    assert stump.done.returncode != 0
    with RecordReader(stump.record) as reader:
        end = end_of(reader.events())
    assert end is not None
    assert (end.kind, end.text) == (EventKind.FAILED, "the program has failed")
    (row,) = session_rows(stump.folder)[0]
    assert (row["state"], row["flaw"]) == ("cut short", "failed: the program has failed")
    fitted = rig("fit", stump.record, "-o", tmp_path / "fit")
    assert "END: the program has failed (limit its own); an error ended it" in fitted.stdout
    assert rig("report", tmp_path / "fit" / "results.json", "-o", tmp_path / "page.html").returncode == 0
    assert "an error ended it" in (tmp_path / "page.html").read_text()
    assert resumed(stump.folder, "--set", "session.max_duration_s=3").returncode == 1
    assert [(entry.record, entry.state) for entry in read_session(stump.folder).entries] == [
        ("run-1.mcap", RunState.FAILED),
        ("run-2.mcap", RunState.COMPLETE),
    ]


def test_a_folder_that_goes_before_the_record_begins_is_named_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    usual = PhasesBeforeRecord._check

    def removing(phases: PhasesBeforeRecord, resting: bool) -> None:
        shutil.rmtree(out)
        usual(phases, resting)

    monkeypatch.setattr(PhasesBeforeRecord, "_check", removing)
    gone = run(out, QUICK, preflight__when="always")
    assert gone.done.returncode == 1
    assert f"{out}: No such file or directory; was it removed or renamed" in gone.said
    assert "Traceback" not in gone.said


def test_a_disk_without_room_is_said_in_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.measure.run.free_bytes", lambda _: 50 * 2**20 - 1)
    full = run(tmp_path / "out", {})
    assert full.done.returncode in (1, 2)
    assert full.said.count("\n") == 1
    assert "49 MiB of disk are free, 50 MiB are needed" in full.said
    assert not full.folder.exists()
    monkeypatch.setattr("rig.measure.run.free_bytes", lambda _: 50 * 2**20)
    _check_path(tmp_path / "run.mcap")


def test_a_record_whose_folder_is_removed_ends_the_run_and_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, frames = RecordWriter.write_spots, 0

    def write_spots(writer: RecordWriter, sequences: Sequence[int], *values: object) -> None:
        nonlocal frames
        if frames <= 1000 < frames + len(sequences):
            shutil.rmtree(tmp_path / "out")
        frames += len(sequences)
        usual(writer, sequences, *values)  # type: ignore[arg-type]

    monkeypatch.setattr(RecordWriter, "write_spots", write_spots)
    # many frames are few swings: a fit of those that come before the disk is looked at takes most of a minute
    # on a busy machine
    saved = run(tmp_path / "out", SMALL, session__max_duration_s="600", camera__frame_rate_hz="1000")
    assert saved.done.returncode == 1
    assert "was removed" in saved.said
    with RecordReader(saved.record) as reader:
        assert not reader.truncated
        # also those that came after it
        assert len(reader.spots()) == frames > 1000


@pytest.mark.slow
def test_ctrl_c_between_the_end_of_a_run_and_its_note_leaves_no_run_that_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = session.measure_run

    def interrupted(plan: RunPlan, devices: Devices) -> RunOutcome:
        usual(plan, devices)
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "measure_run", interrupted)
    assert run(tmp_path / "out", QUICK).done.returncode != 0
    (entry,) = read_session(tmp_path / "out").entries
    assert (entry.state, entry.reason) == (RunState.COMPLETE, "time limit of 24 s reached")
    done = resumed(tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "no run is missing" in done.stderr
    assert (tmp_path / "out" / "results.json").exists()


def test_a_clock_that_was_set_back_ends_no_run_before_it_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class SetBack(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> Self:
            return super().now(tz) - datetime.timedelta(hours=1)

    file = SessionFile.create(tmp_path, DEMO, 1, {})
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.note(2, "run-2.mcap", RunState.RECORDING)
    monkeypatch.setattr(datetime, "datetime", SetBack)
    file.note(1, "run-1.mcap", RunState.COMPLETE)
    file.close()
    with closing(SessionFile.opened(tmp_path)) as later:
        later.note(2, "run-2.mcap", RunState.INTERRUPTED)
    for entry in later.state.entries:
        assert entry.begun_utc <= entry.ended_utc
    later.forget("run-1.mcap")
    assert [entry.record for entry in read_session(tmp_path).entries] == ["run-2.mcap"]


def test_a_disk_without_locks_is_not_called_a_running_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)
    said = rf"\.session\.lock: cannot be locked: {NO_LOCKS}; .*another disk"
    with pytest.raises(ConfigurationError, match=said):
        SessionFile.create(tmp_path, DEMO, 1, {})
