"""After kill -9 at any time the file can be opened, and at most the last second is missing."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.check import check_record
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover

pytestmark = pytest.mark.realtime

PROGRAM = "tests.acquisition.record.until_killed"
ROOT = Path(__file__).resolve().parents[3]
LAST_SECONDS_S = 1.0
START_S = 20.0


def record_and_kill(path: Path, after_s: float) -> tuple[float, list[tuple[float, int]]]:
    """When it was killed (host clock), and what it had handed to the writer until then."""
    process = subprocess.Popen(
        [sys.executable, "-m", PROGRAM, str(path)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "begun\n"
        time.sleep(after_s)
    finally:
        killed_s = time.monotonic()
        process.send_signal(signal.SIGKILL)
        text, _ = process.communicate(timeout=START_S)
    complete = text[: text.rfind("\n") + 1].splitlines()
    return killed_s, [(float(when), int(frame)) for when, frame in (line.split() for line in complete)]


def assert_at_most_the_last_second_is_lost(path: Path, after_s: float) -> None:
    killed_s, handed_over = record_and_kill(path, after_s)
    due = [frame for when_s, frame in handed_over if when_s < killed_s - LAST_SECONDS_S]
    copy = path.with_name("whole-" + path.name)
    with RecordReader(path) as reader:
        assert reader.truncated
        spots = reader.spots()
        windows = [window.sequence for window in reader.windows()]
        assert spots["sequence"].tolist() == list(range(len(spots)))
        assert windows == list(range(len(windows)))
        if due:
            assert spots["sequence"][-1] >= due[-1]
            assert windows[-1] >= due[-1]
        assert reader.metadata["session"] == {"operator": "test"}
    found = recover(path, copy)
    assert found.messages.get("/spot", 0) == len(spots)
    assert not [finding for finding in check_record(copy) if finding.severity == "error"]
    assert sorted(path.parent.iterdir()) == sorted([path, copy]), "nothing else is left behind"
    path.unlink()
    copy.unlink()


def kill_at(folder: Path, moments_s: np.ndarray) -> None:
    """A few recordings at a time: they sleep most of it."""
    paths = [folder / str(number) / "run.mcap" for number in range(len(moments_s))]
    for path in paths:
        path.parent.mkdir()
    with ThreadPoolExecutor(6) as together:
        list(together.map(assert_at_most_the_last_second_is_lost, paths, moments_s.tolist()))


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is of POSIX systems")
def test_killed_at_ten_moments(tmp_path: Path) -> None:
    kill_at(tmp_path, np.random.default_rng(1).uniform(0.0, 3.0, 10))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is of POSIX systems")
def test_killed_at_thirty_moments(tmp_path: Path) -> None:
    kill_at(tmp_path, np.random.default_rng(2).uniform(0.0, 3.0, 30))
