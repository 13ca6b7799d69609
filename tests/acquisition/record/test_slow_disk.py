"""A slow disk does not delay the writer; its errors are reported, also later ones."""

import errno
import threading
import time
from pathlib import Path

import pytest

from acquisition.record import mcap_file
from acquisition.record.check import check_record
from acquisition.record.mcap_file import Reserve
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.errors import RecordError

DEADLINE_S = 60.0


class Clock:
    """Stands still until it is moved on."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def written_after_a_second(writer: RecordWriter, clock: Clock, kind: str) -> None:
    """An event, whose writing flushes once."""
    clock.now_s += 1.0
    writer.write_event(round(clock.now_s), kind, "")


def write_until_it_fails(writer: RecordWriter, clock: Clock) -> None:
    """An error of the disk is found in a thread, and raised by a flush after it."""
    end_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < end_s:
        written_after_a_second(writer, clock, "b")
        time.sleep(0.001)


def kinds(path: Path) -> list[str]:
    with RecordReader(path) as reader:
        return [event.kind for event in reader.events()]


def test_writing_does_not_wait_for_the_disk(
    path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordWriter(path, 0, clock=clock)
    real = mcap_file.sync_file
    entered, go_on = threading.Event(), threading.Event()
    forced: list[int] = []

    def slow(number: int) -> None:
        entered.set()
        assert go_on.wait(DEADLINE_S)
        real(number)
        forced.append(number)

    monkeypatch.setattr(mcap_file, "sync_file", slow)
    written_after_a_second(writer, clock, "a")
    assert entered.wait(DEADLINE_S)
    for _ in range(20):
        written_after_a_second(writer, clock, "b")
    assert forced == []
    # a kill loses none of it: it is in the file, though not yet on the disk
    assert kinds(path) == ["a", *["b"] * 20]
    go_on.set()
    writer.close()
    assert kinds(path) == ["a", *["b"] * 20]
    # the one under way, and two of closing, which force what came meanwhile
    assert len(forced) == 3


def test_what_fails_behind_ones_back_is_said_by_the_next_flush(
    path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordWriter(path, 0, clock=clock)

    def gone(number: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(mcap_file, "sync_file", gone)
    written_after_a_second(writer, clock, "a")
    with pytest.raises(RecordError, match=r"run\.mcap: could not be closed properly: Input/output error"):
        write_until_it_fails(writer, clock)
    with pytest.raises(RecordError, match="is closed"):
        written_after_a_second(writer, clock, "c")
    writer.close()


def test_a_failure_is_not_lost_when_the_record_is_closed_before_the_next_flush(
    path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordWriter(path, 0, clock=clock)
    real = mcap_file.sync_file
    failures = [OSError(errno.EIO, "Input/output error")]

    def once(number: int) -> None:
        if failures:
            raise failures.pop()
        real(number)

    monkeypatch.setattr(mcap_file, "sync_file", once)
    written_after_a_second(writer, clock, "a")
    with pytest.raises(RecordError, match="cannot be written: Input/output error; the record is closed"):
        writer.close()
    assert kinds(path) == ["a", "record", "failed", "stop"]


def test_a_disk_that_is_full_behind_ones_back(
    path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordWriter(path, 0, clock=clock, reserve_bytes=4096)

    def full(self: Reserve, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Reserve, "hold", full)
    monkeypatch.setattr(mcap_file, "_SPARE_BYTES", 10**6)
    writer.write_event(0, "a", "")
    with pytest.raises(RecordError, match=r"No space left on device; the record is closed and readable$"):
        write_until_it_fails(writer, clock)
    first, *between, record, failed, stop = kinds(path)
    assert (first, set(between), record, failed, stop) == ("a", {"b"}, "record", "failed", "stop")
    assert not [finding for finding in check_record(path) if finding.severity == "error"]


def test_a_record_that_is_removed_while_it_is_written_is_said_and_saved(path: Path) -> None:
    writer = RecordWriter(path, 0)
    writer.write_event(0, "a", "")
    path.unlink()
    with pytest.raises(RecordError, match="removed or renamed while it was written"):
        writer.flush()
    writer.close()
    assert kinds(path)[0] == "a"
