"""A full disk closes the record with its ending and the reason; one that fails keeps what was flushed; a slow
one does not delay the writer, and its late errors are reported.
"""

import errno
import itertools
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from acquisition.record import mcap_file, pixels_path
from acquisition.record.check import check_record, recover
from acquisition.record.events import end_of
from acquisition.record.mcap_file import McapFile, Reserve
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.errors import RecordError
from processing.swing import HalfCycle
from tests.acquisition.record.samples import EPOCH_OFFSET_NS, write_frames, write_sample

DISK_BYTES = 3 * 1024 * 1024
DRIVE_BYTES = 32 * 1024 * 1024
EXT4_SHUTDOWN = 0x8004587D
WITHOUT_LOG_FLUSH = 2
DEADLINE_S = 60.0


@pytest.fixture(params=["tmpfs", "ext4"])
def small_disk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MiB of its own; needs the right to mount."""
    folder, image = tmp_path / "disk", tmp_path / "disk.img"
    commands = [["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]]
    if request.param == "ext4":
        commands = ext4_commands(image, folder, DISK_BYTES, "-O", "^has_journal")
    yield from mounted_by(commands, folder)


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Image file of a journalled ext4 and the folder that it is mounted at; needs the right to mount."""
    if sys.platform != "linux":
        pytest.skip("ext4's shutdown is of Linux")
    folder, image = tmp_path / "drive", tmp_path / "drive.img"
    for _ in mounted_by(ext4_commands(image, folder, DRIVE_BYTES), folder):
        yield image, folder


def ext4_commands(image: Path, folder: Path, size: int, *options: str) -> list[list[str]]:
    """What makes an ext4 in a new image file, and mounts it."""
    with image.open("wb") as file:
        file.truncate(size)
    return [["mkfs.ext4", "-q", *options, str(image)], ["mount", "-o", "loop", str(image), str(folder)]]


def mounted_by(commands: list[list[str]], folder: Path) -> Iterator[Path]:
    folder.mkdir()
    for command in commands:
        if refused := _run(command):
            pytest.skip(f"nothing can be mounted here: {refused}")
    yield folder
    _run(["umount", str(folder)])


def _run(command: list[str]) -> str:
    """What went wrong, empty where nothing did."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except OSError as error:
        return str(error)
    return "" if done.returncode == 0 else done.stderr.strip() or f"status {done.returncode}"


def record_until_full(writer: RecordWriter) -> tuple[int, str]:
    """Frames handed over before the error, and what it says."""
    rng = np.random.default_rng(0)
    for first in range(0, 100_000, 8):
        try:
            pixels = rng.integers(0, 255, (8, 48, 48), dtype=np.uint8)
            write_frames(writer, range(first, first + 8), 1_000_000, rng, pixels)
            if first % 64 == 0:
                writer.flush()
        except RecordError as error:
            return first, str(error)
    raise AssertionError("the disk never filled up")


def test_the_record_is_closed_and_whole(small_disk: Path) -> None:
    path = small_disk / "run.mcap"
    writer = RecordWriter(path, EPOCH_OFFSET_NS, reserve_bytes=512 * 1024)
    frames, message = record_until_full(writer)
    assert "No space left on device" in message
    assert "closed and readable" in message
    assert "\n" not in message
    writer.close()
    writer.flush()
    with pytest.raises(RecordError, match="is closed"):
        writer.write_event(0, "late", "")
    assert sorted(small_disk.glob("*.mcap")) == [path, pixels_path(path)]
    with RecordReader(path) as reader:
        assert not reader.truncated
        assert len(reader.spots()) >= frames
        assert frames - 8 <= sum(1 for _ in reader.windows()) <= frames + 8
        assert [event.kind for event in reader.events()[-3:]] == ["record", "failed", "stop"]
        end = end_of(reader.events())
        assert end is not None
        assert (end.kind, end.text.rpartition(": ")[2]) == ("failed", "No space left on device")
        assert "No space left on device" in reader.events()[-1].text
    assert not [finding for finding in check_record(path) if finding.severity == "error"]
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None


def test_what_others_write_in_the_meantime_cannot_take_the_reserve(small_disk: Path) -> None:
    path = small_disk / "run.mcap"
    writer = RecordWriter(path, EPOCH_OFFSET_NS, reserve_bytes=512 * 1024)
    with (small_disk / "other").open("wb", buffering=0) as other:
        try:
            while True:
                other.write(os.urandom(4096))
        except OSError:
            pass
    _, message = record_until_full(writer)
    assert "closed and readable" in message
    with RecordReader(path) as reader:
        assert not reader.truncated


def test_no_room_for_the_reserve_is_said_at_the_opening(small_disk: Path) -> None:
    path = small_disk / "run.mcap"
    with pytest.raises(RecordError, match="cannot be created: No space left on device"):
        RecordWriter(path, 0, reserve_bytes=2 * DISK_BYTES)
    assert list(small_disk.glob("*.mcap")) == []


@pytest.mark.slow
def test_recovering_onto_a_full_disk_leaves_nothing_behind(small_disk: Path, tmp_path: Path) -> None:
    source, copy = tmp_path / "run.mcap", small_disk / "whole.mcap"
    write_sample(source, 1024, window_px=96)
    assert pixels_path(source).stat().st_size > DISK_BYTES
    with pytest.raises(RecordError, match="cannot be written: No space left on device"):
        recover(source, copy)
    assert list(small_disk.glob("*.mcap")) == []


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are of POSIX systems")
def test_a_limit_that_the_reserve_does_not_help_against(tmp_path: Path) -> None:
    """RLIMIT_FSIZE stops the file itself: what does not fit is counted, a bare end is written."""
    path = tmp_path / "run.mcap"
    program = f"""
import resource
from pathlib import Path
from acquisition.record.writer import RecordWriter
from processing.errors import RecordError
from tests.acquisition.record.test_failing_disk import record_until_full
writer = RecordWriter(Path({str(path)!r}), {EPOCH_OFFSET_NS}, reserve_bytes=65536)
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
print(*record_until_full(writer))
writer.close()
"""
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=root
    )
    frames, _, message = done.stdout.partition(" ")
    assert "File too large; the record is closed and readable; the last" in message
    assert path.stat().st_size <= 1_000_000
    with RecordReader(path) as reader:
        assert not reader.truncated
        lost = int(message.split("the last ")[1].split()[0])
        assert int(frames) - lost <= len(reader.spots()) <= int(frames) + 8
    assert not [finding for finding in check_record(path) if finding.severity == "error"]


def test_a_piece_written_in_parts_is_whole(tmp_path: Path) -> None:
    """Raw files may take less than they are given."""
    path = tmp_path / "run.mcap"
    file = McapFile(path, {}, 4096)
    taken: list[int] = []
    raw = file.disk._file

    class Slow:
        def __getattr__(self, name: str) -> object:
            return getattr(raw, name)

        def write(self, data: memoryview) -> int:
            taken.append(len(data))
            return raw.write(data[:7]) or 0

    file.disk._file = Slow()  # type: ignore[assignment]
    file.add_metadata({"session": {"a": "b" * 100}}, 0)
    file.finish()
    assert len(taken) > 20
    with path.open("rb") as whole:
        (metadata,) = make_reader(whole, validate_crcs=True).iter_metadata()
    assert metadata.metadata == {"a": "b" * 100}


def test_the_reserve_is_nameless_and_given_back_once(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path, 3_000_000)
    if os.name == "posix":
        assert list(tmp_path.iterdir()) == []
    assert reserve.size == 3_000_000
    reserve.hold(1_000_000)
    assert reserve.size == 3_000_000
    reserve.hold(4_000_000)
    assert reserve.size == 4_000_000
    assert reserve.release()
    assert not reserve.release()
    reserve.hold(1)
    assert reserve.size == 0


def cut_power(folder: Path) -> None:
    """From now on every access fails with EIO; what was not forced to the disk is gone."""
    import fcntl

    number = os.open(folder, os.O_RDONLY)
    try:
        fcntl.ioctl(number, EXT4_SHUTDOWN, struct.pack("I", WITHOUT_LOG_FLUSH))
    except OSError as error:
        pytest.skip(f"this kernel cannot shut ext4 down: {error}")
    finally:
        os.close(number)


def test_what_was_flushed_survives(drive: tuple[Path, Path], tmp_path: Path) -> None:
    image, folder = drive
    path = folder / "run.mcap"
    writer = RecordWriter(path, EPOCH_OFFSET_NS, flush_interval_s=1e9)
    for index in range(100):
        writer.write_half_cycle(HalfCycle(index, index, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1, 0))
        if index == 59:
            writer.flush()
    cut_power(folder)
    with pytest.raises(
        RecordError, match="Input/output error; rig record recover makes a complete file of it"
    ):
        writer.flush()
    writer.close()
    assert _run(["umount", str(folder)]) == ""
    assert _run(["mount", "-o", "loop", str(image), str(folder)]) == ""
    with RecordReader(path) as reader:
        assert reader.truncated
        assert [h.index for h in reader.half_cycles()] == list(range(60))
    recover(path, tmp_path / "whole.mcap")
    with RecordReader(tmp_path / "whole.mcap") as reader:
        assert reader.counts["/swing"] == 60
    assert not [f for f in check_record(tmp_path / "whole.mcap") if f.severity == "error"]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def impatient(path: Path, **more: int) -> RecordWriter:
    """A writer that flushes after every event: its clock moves on by a second at every look."""
    return RecordWriter(path, 0, clock=itertools.count().__next__, **more)


def write_until_it_fails(writer: RecordWriter) -> None:
    """An error of the disk is found in a thread, and raised by a flush after it."""
    end_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < end_s:
        writer.write_event(0, "b", "")
        time.sleep(0.001)


def kinds(path: Path) -> list[str]:
    with RecordReader(path) as reader:
        return [event.kind for event in reader.events()]


def test_writing_does_not_wait_for_the_disk(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = impatient(path)
    real = mcap_file.sync_file
    entered, go_on = threading.Event(), threading.Event()
    forced: list[int] = []

    def slow(number: int) -> None:
        entered.set()
        assert go_on.wait(DEADLINE_S)
        real(number)
        forced.append(number)

    monkeypatch.setattr(mcap_file, "sync_file", slow)
    writer.write_event(0, "a", "")
    assert entered.wait(DEADLINE_S)
    for _ in range(20):
        writer.write_event(0, "b", "")
    assert forced == []
    # a kill loses none of it: it is in the file, though not yet on the disk
    assert kinds(path) == ["a", *["b"] * 20]
    go_on.set()
    writer.close()
    assert kinds(path) == ["a", *["b"] * 20]
    # the one under way, and two of closing, which force what came meanwhile
    assert len(forced) == 3


def test_what_fails_behind_ones_back_is_said_by_the_next_flush(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = impatient(path)

    def gone(number: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(mcap_file, "sync_file", gone)
    with pytest.raises(RecordError, match=r"run\.mcap: could not be closed properly: Input/output error"):
        write_until_it_fails(writer)
    with pytest.raises(RecordError, match="is closed"):
        writer.write_event(0, "c", "")
    writer.close()


def test_a_failure_is_not_lost_when_the_record_is_closed_before_the_next_flush(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordWriter(path, 0, flush_interval_s=1e9)
    real = mcap_file.sync_file
    failures = [OSError(errno.EIO, "Input/output error")]

    def once(number: int) -> None:
        if failures:
            raise failures.pop()
        real(number)

    monkeypatch.setattr(mcap_file, "sync_file", once)
    writer.write_event(0, "a", "")
    writer.flush(wait=False)
    with pytest.raises(RecordError, match="cannot be written: Input/output error; the record is closed"):
        writer.close()
    assert kinds(path) == ["a", "record", "failed", "stop"]


def test_a_disk_that_is_full_behind_ones_back(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = impatient(path, reserve_bytes=4096)

    def full(self: Reserve, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Reserve, "hold", full)
    monkeypatch.setattr(mcap_file, "_SPARE_BYTES", 10**6)
    with pytest.raises(RecordError, match=r"No space left on device; the record is closed and readable$"):
        write_until_it_fails(writer)
    *written, record, failed, stop = kinds(path)
    assert (set(written), record, failed, stop) == ({"b"}, "record", "failed", "stop")
    assert not [finding for finding in check_record(path) if finding.severity == "error"]


def test_a_record_that_is_removed_while_it_is_written_is_said_and_saved(path: Path) -> None:
    writer = RecordWriter(path, 0)
    writer.write_event(0, "a", "")
    path.unlink()
    with pytest.raises(RecordError, match="removed or renamed while it was written"):
        writer.flush()
    writer.close()
    assert kinds(path)[0] == "a"
