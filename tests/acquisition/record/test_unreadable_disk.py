"""Parts of a record that its disk cannot give are lost, and nothing else is."""

import errno
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from acquisition.record import pixels_path
from acquisition.record.check import check_record, recover
from acquisition.record.chunk import read_bytes
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from tests.acquisition.record.hanging_disk import Mounted, NoFuse, mounted
from tests.acquisition.record.samples import write_sample

FRAMES = 256
BLOCK_BYTES = 4096


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Mounted]:
    base = tmp_path / "fuse"
    base.mkdir()
    try:
        with mounted(base) as found:
            yield found
    except NoFuse as why:
        pytest.skip(str(why))


def read(path: Path) -> tuple[np.ndarray, list[int], list[str]]:
    with RecordReader(path) as reader:
        sequences = reader.spots()["sequence"]
        windows = [window.sequence for window in reader.windows()]
        return sequences, windows, reader.doubts()


def test_an_unreadable_end_as_of_a_broken_chain_of_clusters(disk: Mounted, tmp_path: Path) -> None:
    """exFAT after a power cut: the file's size is on the disk, the place of its last clusters is not."""
    path, cut = disk.folder / "run.mcap", tmp_path / "cut.mcap"
    write_sample(path, FRAMES, flush_interval_s=0.0)
    cut.write_bytes(path.read_bytes())
    pixels = pixels_path(path)
    size = pixels.stat().st_size
    first = (2 * size // 3) // BLOCK_BYTES * BLOCK_BYTES
    pixels_path(cut).write_bytes(pixels.read_bytes()[:first])
    disk.spoil(first, size, pixels.name)
    spots, windows, doubts = read(path)
    _, expected_windows, _ = read(cut)
    assert 0 < len(expected_windows) < FRAMES
    assert len(spots) == FRAMES
    assert windows == expected_windows
    assert "was cut short" in doubts[0]
    copy = tmp_path / "copy.mcap"
    assert "or its disk cannot give all of it" in recover(path, copy)["lost"]
    assert not [finding for finding in check_record(copy) if finding.severity == "error"]
    assert read(copy)[1] == windows


def test_an_unreadable_block_in_the_middle(disk: Mounted) -> None:
    path = disk.folder / "run.mcap"
    write_sample(path, FRAMES, flush_interval_s=0.0)
    all_spots, all_windows, _ = read(path)
    before = path.stat().st_size // 2 // BLOCK_BYTES * BLOCK_BYTES
    disk.spoil(before, before + BLOCK_BYTES, path.name)
    spots, windows, doubts = read(path)
    assert len(all_spots) == FRAMES
    assert 0 < len(all_spots) + len(all_windows) - len(spots) - len(windows) <= 64
    assert "or its disk cannot give all of it" in " ".join(doubts)
    found = " ".join(finding.text for finding in check_record(path) if finding.severity == "error")
    assert "or its disk cannot give all of it" in found


def test_nothing_but_unreadable_bytes_is_no_record(disk: Mounted) -> None:
    path = disk.folder / "run.mcap"
    write_sample(path, 16)
    disk.spoil(0, path.stat().st_size, path.name)
    with pytest.raises(RecordError, match=r"run\.mcap: is empty, or cannot be read from its disk"):
        read(path)


class Failing(io.BytesIO):
    """A file whose first read fails."""

    number = errno.EIO

    def read(self, size: int | None = -1, /) -> bytes:
        raise OSError(self.number, "failed")


def test_a_disk_that_is_pulled_out_is_no_unreadable_block() -> None:
    """What was there is on the disk still: it would be taken for a damaged record."""
    file = Failing(bytes(8))
    assert read_bytes(file, 0, 8) == b""
    file.number = errno.ENODEV
    with pytest.raises(OSError, match="failed"):
        read_bytes(file, 0, 8)
