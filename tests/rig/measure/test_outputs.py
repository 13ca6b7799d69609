"""A terminal or pipe that is closed, or that nobody reads, holds up neither frames nor the end."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from rig.devices import FrameStream, SessionNews
from rig.interruption import _may_block
from rig.measure import measure_session, screen
from tests.rig.command_line import (
    CONFIGS,
    QUICK,
    SMALL,
    Session,
    configured,
    rig,
    set_words,
)

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and signals of POSIX")
WITHIN_S = 120.0


def waiting(out: int) -> int:
    return int.from_bytes(fcntl.ioctl(out, termios.FIONREAD, b"\0\0\0\0"), sys.byteorder)


@pytest.mark.slow
def test_a_second_signal_ends_a_session_whose_output_nobody_reads(tmp_path: Path) -> None:
    out, into = os.pipe()
    fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, 4096)  # type: ignore[attr-defined, unused-ignore]
    words = set_words({**QUICK, "session.max_duration_s": "1e6", "session.final_amplitude_arcsec": "0.001"})
    session = Session(tmp_path / "out")
    record = session.record
    command = [sys.executable, "-m", "rig", "run", CONFIGS / "demo.toml", "-o", session.folder, "--json"]
    process = subprocess.Popen([*command, *words], stdout=into, stdin=subprocess.DEVNULL)
    deadline_s = time.monotonic() + WITHIN_S
    try:
        # the pipe has no room for another line and stands still, and the record grows all the same
        held = grown = 0
        while held < 1500 or record.stat().st_size < grown + 100_000:
            if waiting(out) != held and record.exists():
                held, grown = waiting(out), record.stat().st_size
            assert process.poll() is None
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        while process.poll() is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.5)
            process.send_signal(signal.SIGTERM)
    finally:
        process.kill()
        process.wait()
        os.close(out)
        os.close(into)
    with RecordReader(session.record) as reader:
        end = end_of(reader.events())
    assert end is not None
    assert (end.kind, end.text) == (EventKind.ENDED_EARLY, "terminated")
    assert [entry["state"] for entry in session.entries] == ["stopped"]


def test_what_may_block_is_no_file(tmp_path: Path) -> None:
    out, into = os.pipe()
    with (tmp_path / "file").open("w") as file:
        assert [_may_block(fd) for fd in (into, file.fileno(), 10**6)] == [True, False, False]
    os.close(out)
    os.close(into)


@pytest.mark.slow
def test_an_unread_terminal_does_not_hold_a_preflight_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = {**SMALL, "session.output": f"'{tmp_path.as_posix()}'", "preflight.duration_s": "1"}
    over = threading.Event()
    usual_close, usual_print = FrameStream.close, screen.print_json_line

    def close(stream: FrameStream) -> None:
        usual_close(stream)
        over.set()

    def read_late(kind: str, values: Mapping[str, object]) -> None:
        assert over.wait(WITHIN_S)
        usual_print(kind, values)

    monkeypatch.setattr(FrameStream, "close", close)
    monkeypatch.setattr(screen, "print_json_line", read_late)
    done = rig("doctor", "--preflight", CONFIGS / "live.toml", "--json", *set_words(words))
    # on a busy machine frames may be lost
    assert done.returncode in (0, 1), done.stderr
    kinds = [json.loads(line)["kind"] for line in done.stdout.splitlines()]
    assert set(kinds[:-1]) == {"state"}
    assert kinds[-1] == "preflight"


@pytest.mark.parametrize(("printed_by", "json_lines"), [("say", False), ("print_json_line", True)])
def test_who_watches_is_told_on_when_the_terminal_was_closed_and_the_session_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, printed_by: str, json_lines: bool
) -> None:
    phases: list[str] = []
    usual = SessionNews.state

    def state(news: SessionNews, values: Mapping[str, Any], rows: Sequence[tuple[str, str]]) -> None:
        phases.append(values["phase"])
        usual(news, values, rows)

    def closed(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(SessionNews, "state", state)
    monkeypatch.setattr(screen, printed_by, closed)
    config, session = configured({**QUICK, "session.max_duration_s": "3"}), Session(tmp_path / "out")
    # a closed stdout is led to nowhere, which must not be that of the tests
    with (tmp_path / "stdout").open("w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        measure_session(config, CONFIGS / "demo.toml", session.folder, json_lines=json_lines)
    assert phases[-1] == "done"
    assert [entry["state"] for entry in session.entries] == ["complete"]
    assert len(session.runs) == 1
    assert (session.folder / "report.html").exists()
