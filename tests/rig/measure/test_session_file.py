"""The files of a session are whole, belong to it, and are believed only after reading."""

import datetime
import json
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Self

import pytest

from acquisition.record import records_in_folder
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from rig.devices import Devices
from rig.measure import session
from rig.measure.run import _check_path
from rig.measure.run_parts import RunOutcome, RunPlan
from rig.measure.session_file import RunState, SessionFile, read_session
from tests.disk_without_locks import NO_LOCKS, without_locks
from tests.rig.command_line import CONFIGS, QUICK, SMALL, rig, set_words


def test_no_file_elsewhere_is_reached_through_a_symbolic_link(tmp_path: Path) -> None:
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.write_text("precious")
    folder.mkdir()
    (folder / ".session.lock").symlink_to(elsewhere)
    with pytest.raises(ConfigurationError, match=r"\.session\.lock: cannot be opened"):
        SessionFile.create(folder, CONFIGS / "demo.toml", 1, {})
    (folder / ".session.lock").unlink()
    file = SessionFile.create(folder, CONFIGS / "demo.toml", 1, {})
    (folder / "session.json").unlink()
    (folder / "session.json").symlink_to(elsewhere)
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.close()
    assert elsewhere.read_text() == "precious"
    assert not (folder / "session.json").is_symlink()


def test_a_session_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    SessionFile.create(tmp_path, CONFIGS / "demo.toml", 1, {}).close()
    with pytest.raises(ConfigurationError, match="already holds a session; rig run --resume"):
        SessionFile.create(tmp_path, CONFIGS / "demo.toml", 1, {})


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session whose program ended after the record was closed and before anything else was noted."""
    folder = tmp_path_factory.mktemp("ended") / "out"
    short = set_words(QUICK)
    assert rig("run", CONFIGS / "demo.toml", "-o", folder, *short).returncode == 0
    state = json.loads((folder / "session.json").read_text())
    state["entries"][-1]["state"] = "recording"
    (folder / "session.json").write_text(json.dumps(state))
    return folder


@pytest.mark.slow
def test_a_record_that_came_to_its_end_is_complete(ended: Path) -> None:
    whole = (ended / "results.json").read_text()
    # half a file, as an older version left it when the power failed
    (ended / "results.json").write_text(whole[: len(whole) // 2])
    before = (ended / "run-1.mcap").read_bytes()
    done = rig("run", "--resume", ended)
    assert done.returncode == 0, done.stderr
    assert "run-1.mcap is whole: time limit" in done.stderr
    assert "1 of 1 runs are complete" in done.stderr
    assert "rig init --example basement writes the same rig in an ordinary basement" in done.stderr
    assert [path.name for path in records_in_folder(ended)] == ["run-1.mcap"]
    assert (ended / "run-1.mcap").read_bytes() == before
    assert json.loads((ended / "results-2.json").read_text())["runs"][0]["record"] == "run-1.mcap"

    (ended / "report-2.html").unlink()
    again = rig("run", "--resume", ended)
    assert "no run is missing" in again.stderr
    assert (ended / "report-2.html").exists()


def test_a_disk_without_room_is_said_in_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.measure.run.free_bytes", lambda _: 50 * 2**20 - 1)
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out")
    assert done.returncode == 2 or done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "49 MiB of disk are free, 50 MiB are needed" in done.stderr
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr("rig.measure.run.free_bytes", lambda _: 50 * 2**20)
    _check_path(tmp_path / "run.mcap")


def test_a_record_whose_folder_is_removed_ends_the_run_and_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    from acquisition.record.writer import RecordWriter

    usual, frames = RecordWriter.write_spots, 0

    def write_spots(writer: RecordWriter, sequences: Sequence[int], *values: object) -> None:
        nonlocal frames
        if frames <= 2000 < frames + len(sequences):
            shutil.rmtree(tmp_path / "out")
        frames += len(sequences)
        usual(writer, sequences, *values)  # type: ignore[arg-type]

    monkeypatch.setattr(RecordWriter, "write_spots", write_spots)
    # many frames are few swings: a fit of those that come before the disk is looked at takes most of a minute
    # on a busy machine
    short = set_words({**SMALL, "session.max_duration_s": "600", "camera.frame_rate_hz": "1000"})
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *short)
    assert done.returncode == 1
    assert "was removed" in done.stderr
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        assert not reader.truncated
        # also those that came after it
        assert len(reader.spots()) == frames > 2000


@pytest.mark.slow
def test_ctrl_c_between_the_end_of_a_run_and_its_note_leaves_no_run_that_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = session.measure_run

    def interrupted(plan: RunPlan, devices: Devices) -> RunOutcome:
        usual(plan, devices)
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "measure_run", interrupted)
    short = set_words(QUICK)
    assert rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *short).returncode != 0
    (entry,) = read_session(tmp_path / "out").entries
    assert (entry.state, entry.reason) == (RunState.COMPLETE, "time limit of 24 s reached")
    done = rig("run", "--resume", tmp_path / "out")
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

    file = SessionFile.create(tmp_path, CONFIGS / "demo.toml", 1, {})
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.note(2, "run-2.mcap", RunState.RECORDING)
    monkeypatch.setattr(datetime, "datetime", SetBack)
    file.note(1, "run-1.mcap", RunState.COMPLETE)
    file.close()
    with closing(SessionFile.opened(tmp_path)) as later:
        later.note(2, "run-2.mcap", RunState.INTERRUPTED)
    for entry in later.state.entries:
        assert entry.begun_utc <= entry.ended_utc


def test_a_disk_without_locks_is_not_called_a_running_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)
    said = rf"\.session\.lock: cannot be locked: {NO_LOCKS}; .*another disk"
    with pytest.raises(ConfigurationError, match=said):
        SessionFile.create(tmp_path, CONFIGS / "demo.toml", 1, {})
