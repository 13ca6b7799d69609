"""A test that is killed leaves no process behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import until

ROOT = Path(__file__).resolve().parents[1]
HANGS = """
import subprocess, time
def test_that_hangs():
    # a session of its own, with a process of its own
    apart = subprocess.Popen(["sh", "-c", "sleep 600 & echo $!; wait"], stdout=subprocess.PIPE, text=True,
                             start_new_session=True)
    print(apart.pid, apart.stdout.readline().strip(), flush=True)
    time.sleep(600)
"""


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="guarded on Linux only")
def test_what_a_killed_test_has_started_ends_with_it(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text(encoding="utf-8"))
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    (tmp_path / "test_one.py").write_text(HANGS)
    command = [sys.executable, "-m", "pytest", "-q", "-s", "-n", "0"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    ) as program:
        assert program.stdout is not None
        try:
            while not (words := program.stdout.readline().split())[:1] or not words[0].isdigit():
                assert program.poll() is None
            left = [int(word) for word in words]
            assert all(map(alive, left))
        finally:
            program.kill()
    assert len(left) == 2
    until(lambda: not any(map(alive, left)))
