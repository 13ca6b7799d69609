"""Parts of a record that its disk cannot give are lost, and nothing else is."""

import errno
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from acquisition.record.check import check_record
from acquisition.record.disk_faults import _FaultyFile
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
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
    path = disk.folder / "run.mcap"
    write_sample(path, FRAMES, flush_interval_s=0.0)
    size = path.stat().st_size
    first = (2 * size // 3) // BLOCK_BYTES * BLOCK_BYTES
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:first])
    disk.spoil(first, size)
    spots, windows, doubts = read(path)
    expected_spots, expected_windows, _ = read(cut)
    assert 0 < len(expected_spots) < FRAMES
    np.testing.assert_array_equal(spots, expected_spots)
    assert windows == expected_windows
    assert f"{size - first} bytes cannot be read from its disk, they are taken as lost" in doubts
    copy = tmp_path / "copy.mcap"
    assert "cannot be read from its disk" in " ".join(recover(path, copy).damage)
    assert not [finding for finding in check_record(copy) if finding.severity == "error"]
    assert len(read(copy)[0]) == len(spots)


def test_an_unreadable_block_in_the_middle(disk: Mounted) -> None:
    path = disk.folder / "run.mcap"
    write_sample(path, FRAMES, flush_interval_s=0.0)
    all_spots, all_windows, _ = read(path)
    before = path.stat().st_size // 2 // BLOCK_BYTES * BLOCK_BYTES
    disk.spoil(before, before + BLOCK_BYTES)
    spots, windows, doubts = read(path)
    assert len(all_spots) == FRAMES
    assert 0 < len(all_spots) + len(all_windows) - len(spots) - len(windows) <= 64
    assert any("4096 bytes cannot be read" in doubt for doubt in doubts)
    found = [finding.text for finding in check_record(path) if finding.severity == "error"]
    assert "4096 bytes cannot be read from its disk, they are taken as lost" in found


def test_nothing_but_unreadable_bytes_is_no_record(disk: Mounted) -> None:
    path = disk.folder / "run.mcap"
    write_sample(path, 16)
    disk.spoil(0, path.stat().st_size)
    with pytest.raises(RecordError, match=r"run\.mcap: cannot be read from its disk"):
        read(path)


class Failing(io.FileIO):
    """A file of which the first reads fail, each with its error."""

    errors: ClassVar[list[int]]

    def readinto(self, buffer: Any, /) -> int | None:
        if self.errors:
            raise OSError(self.errors.pop(0), "failed")
        return super().readinto(buffer)


class FailingTolerated(_FaultyFile, Failing):
    pass


@pytest.mark.parametrize("errors", [[errno.ENODEV], [errno.EIO, errno.ENODEV]])
def test_a_disk_that_is_pulled_out_is_no_unreadable_block(tmp_path: Path, errors: list[int]) -> None:
    """What was there is on the disk still: zeros would be taken for a damaged record."""
    path = tmp_path / "run.mcap"
    path.write_bytes(bytes([7]) * 4 * BLOCK_BYTES)
    FailingTolerated.errors = list(errors)
    with FailingTolerated(path) as file:
        with pytest.raises(OSError, match="failed") as caught:
            file.readinto(bytearray(2 * BLOCK_BYTES))
        assert caught.value.errno == errno.ENODEV
        assert file.lost == {}
