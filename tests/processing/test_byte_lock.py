"""A byte of a file is one process's at a time, and nobody's once that has ended."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from processing import kernel_compiler
from processing.kernel_compiler import byte_locked

pytest.importorskip("fcntl", reason="the locks are those of POSIX")
HOLDER = """
import sys
from pathlib import Path
from processing.kernel_compiler import byte_locked
with byte_locked(Path(sys.argv[1]), 7, lambda: None):
    print("held", flush=True)
    input()
"""


def holder(path: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_it_is_waited_for_until_the_other_process_is_killed(tmp_path: Path) -> None:
    other = holder(tmp_path / "lock")
    waits: list[int] = []

    def kill() -> None:
        waits.append(1)
        threading.Timer(0.3, other.kill).start()

    with other, byte_locked(tmp_path / "lock", 7, kill):
        assert other.wait(30.0) != 0
    assert waits == [1]


def test_another_byte_is_free(tmp_path: Path) -> None:
    other = holder(tmp_path / "lock")
    waits: list[int] = []
    with byte_locked(tmp_path / "lock", 8, lambda: waits.append(1)):
        assert other.poll() is None
    assert waits == []
    other.communicate("\n", 30.0)


def test_a_process_that_hangs_is_not_waited_for_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_compiler, "LONGEST_S", 0.2)
    other = holder(tmp_path / "lock")
    with byte_locked(tmp_path / "lock", 7, lambda: None):
        assert other.poll() is None
    other.communicate("\n", 30.0)


def test_without_a_place_for_the_lock_it_is_done_without(tmp_path: Path) -> None:
    with byte_locked(tmp_path / "none" / "lock", 7, lambda: None):
        assert not (tmp_path / "none").exists()
