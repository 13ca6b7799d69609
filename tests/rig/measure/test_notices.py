"""Who is not there is told by a command, which may hang or fail."""

import json
import sys
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from rig.measure import notices
from rig.measure.notices import Notices
from rig.settings import SessionSettings
from tests.rig.command_line import SMALL, run


def program(folder: Path, then: str) -> tuple[str, str]:
    """A command that appends its arguments to the file `told`."""
    path, told = folder / "tell.py", str(folder / "told")
    keep = "file.write(json.dumps(sys.argv[1:]) + '\\n')"
    path.write_text(f"import json, sys, time\nwith open({told!r}, 'a') as file: {keep}\n{then}\n")
    return sys.executable, str(path)


def test_too_few_swings_are_told_as_the_cause_of_a_failure_and_the_record_is_kept(tmp_path: Path) -> None:
    session = run(
        tmp_path / "out",
        SMALL,
        session__notify_command=json.dumps(program(tmp_path, "")),
        session__max_duration_s="4",
    )
    assert session.done.returncode == 1
    ((kind, text, folder),) = map(json.loads, (tmp_path / "told").read_text().splitlines())
    assert (kind, folder) == ("failure", str(session.folder))
    # the cause, and not only that there is one
    assert "run-1.mcap: " in text
    assert "needs at least 10" in session.done.stdout
    with RecordReader(session.record) as reader:
        assert len(reader.spots()) >= 200


def test_a_command_that_hangs_delays_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(notices, "_MAX_CALL_S", 1.0)
    monkeypatch.setattr(notices, "_MAX_LAST_WAIT_S", 0.1)
    told = Notices(SessionSettings(notify_command=program(tmp_path, "time.sleep(600)")), tmp_path)
    told.tell("alarm", "the laser is dark")
    told.wait()
    # it has not answered, and this thread has come as far as here
    (call,) = told.calls
    assert not call.done()
    call.result(60.0)
    said = capsys.readouterr().err
    assert "did not answer within 0.1 s: it is unknown whether the message arrived" in said
    assert "was ended after 1 s" in said


def test_a_command_that_fails_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ((str(tmp_path / "no-such-program"),), program(tmp_path, "sys.exit(3)")):
        told = Notices(SessionSettings(notify_command=command), tmp_path)
        told.tell("end", "every run was measured")
        told.wait()
    said = capsys.readouterr().err
    assert "no-such-program" in said
    assert "ended with 3" in said


def test_a_program_that_is_not_there_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    session = run(tmp_path / "out", {}, session__notify_command='["no-such-program", "--urgent"]')
    assert session.done.returncode == 2
    assert "session.notify_command: no program 'no-such-program' is found" in session.said
    assert not session.folder.exists()
