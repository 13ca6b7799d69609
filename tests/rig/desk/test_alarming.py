"""What happens to a session, its folder and the configuration is an alarm of the desk, without a page."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from acquisition.record.events import EventKind
from rig.control import STALE_S
from rig.desk.alarm_list import AlarmKey, AlarmState
from rig.desk.desk import Desk
from rig.devices import OrderSocket, SessionNews
from rig.measure.session_file import RunState, SessionFile
from rig.settings import load_configuration, stored_configuration
from tests.rig.desk.conftest import simulated_rig
from tests.waiting import until

ROOT = Path(__file__).resolve().parents[3]
HANGS = """
import ctypes, signal, sys
from pathlib import Path
from rig.devices import OrderSocket, SessionNews

signal.signal(signal.SIGTERM, signal.SIG_IGN)
with OrderSocket(Path(sys.argv[1]), SessionNews(), {}):
    print("begun", flush=True)
    sys.stdin.readline()
    # a call that keeps the interpreter: no thread runs any more
    ctypes.PyDLL(None).pause()
"""
"""A session that hears no SIGTERM, and hangs after a line on standard input."""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "runs" / "session").mkdir(parents=True)
    return simulated_rig(tmp_path)


@pytest.fixture
def desk(config: Path) -> Iterator[Desk]:
    found = Desk(config)
    found.follower.start()
    found.alarming.start()
    yield found
    found.close()


def wait_for(desk: Desk, key: AlarmKey, state: AlarmState | None = AlarmState.ACTIVE) -> str:
    """Until an alarm is in this state, None: not in the list; returns its cause."""
    deadline_s = time.monotonic() + 40.0
    while True:
        found = [row for row in desk.alarming.alarms.rows() if row.key is key]
        if [row.state for row in found] == ([] if state is None else [state]):
            return found[0].cause if found else ""
        assert time.monotonic() < deadline_s, desk.alarming.alarms.rows()
        time.sleep(0.02)


def test_a_new_session_leaves_what_was_before_unheard(config: Path) -> None:
    desk = Desk(config)
    follower = desk.follower
    gap = {"kind": EventKind.GAP, "level": EventKind.GAP.level, "text": "2 frames are missing"}
    follower.folder = config.parent / "runs" / "session"
    follower.new_events.append(gap)
    desk.alarming.start()
    try:
        assert wait_for(desk, AlarmKey.DISTURBED) == "gap: 2 frames are missing"
        follower.folder = None
        follower.end_alarms.append((AlarmKey.SESSION_DIED, "session: killed"))
        wait_for(desk, AlarmKey.SESSION_DIED)
        follower.folder = config.parent / "runs" / "session"
        until(lambda: not any(row.is_loud for row in desk.alarming.alarms.rows()))
    finally:
        desk.close()


@pytest.mark.slow
def test_a_session_that_hangs_is_an_alarm_and_stop_kills_it(desk: Desk, config: Path) -> None:
    words = [sys.executable, "-c", HANGS, str(config.parent / "runs" / "session")]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        until(lambda: desk.follower.news)
        process.stdin.write("\n")
        process.stdin.flush()
        wait_for(desk, AlarmKey.SESSION_FROZEN)
        assert "was killed, Resume" in desk.stop_session(max_wake_s=1.0)
        assert process.wait(30.0) == -signal.SIGKILL
    assert wait_for(desk, AlarmKey.SESSION_DIED).startswith("session: ")


def test_a_session_whose_news_are_late_is_not_frozen(desk: Desk, config: Path) -> None:
    """On a busy machine the threads that make the news come late; the session answers all the same."""
    told = SessionNews()
    held, go_on = threading.Event(), threading.Event()

    def extra() -> dict[str, object]:
        if held.is_set():
            go_on.wait(60.0)
        return {}

    with OrderSocket(config.parent / "runs" / "session", told, {}, extra):
        until(lambda: bool(desk.follower.news))
        held.set()
        until(lambda: time.monotonic() - desk.follower.news_s > 2.0 * STALE_S)
        assert AlarmKey.SESSION_FROZEN not in {row.key for row in desk.alarming.alarms.rows()}
        go_on.set()


def test_a_session_that_ends_as_it_should_is_no_alarm_and_one_that_has_failed_says_why(
    desk: Desk, config: Path
) -> None:
    folder, stored = config.parent / "runs" / "session", load_configuration(config)
    with OrderSocket(folder, SessionNews(), {}):
        until(lambda: desk.follower.running)
    until(lambda: not desk.follower.running and not desk.follower.end_alarms)
    # a busy machine may have held it up for a moment
    found = {row.key for row in desk.alarming.alarms.rows()}
    assert not found & {AlarmKey.SESSION_DIED, AlarmKey.SESSION_FAILED}
    with OrderSocket(folder, SessionNews(), {}):
        until(lambda: desk.follower.running)
        file = SessionFile.create(folder, config, 1, stored_configuration(stored))
        file.note(1, "run-1.mcap", RunState.FAILED, "no space left on device")
        file.close()
    assert wait_for(desk, AlarmKey.SESSION_FAILED) == "session: no space left on device"
