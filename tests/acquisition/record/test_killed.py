"""After kill -9 at any time the file can be opened, and at most the last second is missing."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from acquisition.record import pixels_path
from acquisition.record.check import check_record, recover
from acquisition.record.reader import RecordReader
from tests.waiting import until

PROGRAM = "tests.acquisition.record.until_killed"
ROOT = Path(__file__).resolve().parents[3]
LOST_S = 0.9
"""What may be missing, counted from the last block that the writer began: it was killed a block's 20 ms later
unless the machine let it wait."""


class Writers:
    """Processes that record until they are killed, forked from one that has imported everything."""

    def __init__(self) -> None:
        self._starter = subprocess.Popen(
            [sys.executable, "-m", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            cwd=ROOT,
        )
        self._one_at_a_time = threading.Lock()

    def record_and_kill(self, path: Path, after_s: float) -> list[tuple[float, int]]:
        """What it had handed to the writer until then: when that began (host clock), last frame."""
        report = path.parent.with_suffix(".report")
        process = self._start(path, report)
        try:
            until(lambda: report.exists() and report.read_text().startswith("begun\n"))
            time.sleep(after_s)
        finally:
            os.kill(process, signal.SIGKILL)
        until(lambda: not is_alive(process))
        text = report.read_text()
        complete = text[: text.rfind("\n") + 1].splitlines()[1:]
        return [(float(when), int(frame)) for when, frame in (line.split() for line in complete)]

    def close(self) -> None:
        self._starter.communicate()

    def _start(self, path: Path, report: Path) -> int:
        assert self._starter.stdin is not None
        assert self._starter.stdout is not None
        with self._one_at_a_time:
            print(path, report, file=self._starter.stdin)
            return int(self._starter.stdout.readline())


@pytest.fixture(scope="module")
def writers() -> Iterator[Writers]:
    writers = Writers()
    yield writers
    writers.close()


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def assert_at_most_the_last_second_is_lost(writers: Writers, path: Path, after_s: float) -> None:
    handed_over = writers.record_and_kill(path, after_s)
    due = [frame for begun_s, frame in handed_over if begun_s < handed_over[-1][0] - LOST_S]
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
    recover(path, copy)
    with RecordReader(copy) as reader:
        assert len(reader.spots()) == len(spots)
    assert not [finding for finding in check_record(copy) if finding.severity == "error"]
    left = {path, copy, pixels_path(path), pixels_path(copy)}
    assert set(path.parent.iterdir()) <= left, "nothing else is left behind"
    for file in path.parent.iterdir():
        file.unlink()


def kill_at(writers: Writers, folder: Path, moments_s: np.ndarray) -> None:
    """A few recordings at a time: they sleep most of it."""
    paths = [folder / str(number) / "run.mcap" for number in range(len(moments_s))]
    for path in paths:
        path.parent.mkdir()
    with ThreadPoolExecutor(6) as together:
        list(
            together.map(partial(assert_at_most_the_last_second_is_lost, writers), paths, moments_s.tolist())
        )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is of POSIX systems")
def test_killed_at_thirty_moments(writers: Writers, tmp_path: Path) -> None:
    kill_at(writers, tmp_path, np.random.default_rng(2).uniform(0.0, 3.0, 30))
