"""A test that is killed leaves no process behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import until

ROOT = Path(__file__).resolve().parents[1]
KILLED = """
import os, subprocess, sys, time
from tests.orphans import leave_no_orphans
from tests.rig.desk.board_process import BoardProcess
{guard}
board = BoardProcess()
# a session of its own, with a process of its own
apart = subprocess.Popen(["sh", "-c", "sleep 600 & echo $!; wait"], stdout=subprocess.PIPE, text=True,
                         start_new_session=True)
print(board._process.pid, apart.pid, apart.stdout.readline().strip(), flush=True)
time.sleep(600)
"""
PYTEST = """
import subprocess, time
def test_that_hangs():
    print(subprocess.Popen(["sleep", "600"], start_new_session=True).pid, flush=True)
    time.sleep(600)
"""

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="guarded on Linux only")


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def killed_once_it_said(command: list[str], cwd: Path) -> list[int]:
    """The processes that a program has named, which is killed then."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=cwd, env=environment) as program:
        assert program.stdout is not None
        try:
            while not (words := program.stdout.readline().split())[:1] or not words[0].isdigit():
                assert program.poll() is None
            left = [int(word) for word in words]
            assert all(map(alive, left))
        finally:
            program.kill()
    return left


def test_what_a_killed_process_has_started_ends_with_it() -> None:
    """The board of the desk's tests, and a process in a session of its own with one of its own."""
    words = KILLED.format(guard="leave_no_orphans()")
    left = killed_once_it_said([sys.executable, "-c", words], ROOT)
    assert len(left) == 3
    until(lambda: not any(map(alive, left)))


def test_every_test_is_guarded(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text(encoding="utf-8"))
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    (tmp_path / "test_one.py").write_text(PYTEST)
    (process,) = killed_once_it_said([sys.executable, "-m", "pytest", "-q", "-s", "-n", "0"], tmp_path)
    until(lambda: not alive(process))
