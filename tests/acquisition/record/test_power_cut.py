"""If the file system fails during a run, the flushed data are on the disk."""

import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from acquisition.record.check import check_record
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from acquisition.record.writer import RecordWriter
from processing.errors import RecordError
from processing.swing import HalfCycle
from tests.acquisition.record.samples import EPOCH_OFFSET_NS

IMAGE_BYTES = 32 * 1024 * 1024
EXT4_SHUTDOWN = 0x8004587D
WITHOUT_LOG_FLUSH = 2


def _run(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except OSError as error:
        return str(error)
    return "" if done.returncode == 0 else done.stderr.strip() or f"status {done.returncode}"


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Image file of a journalled ext4 and the folder that it is mounted at; needs the right to mount."""
    if sys.platform != "linux":
        pytest.skip("ext4's shutdown is of Linux")
    image, folder = tmp_path / "drive.img", tmp_path / "drive"
    folder.mkdir()
    with image.open("wb") as file:
        file.truncate(IMAGE_BYTES)
    for command in (["mkfs.ext4", "-q", str(image)], ["mount", "-o", "loop", str(image), str(folder)]):
        refused = _run(command)
        if refused:
            pytest.skip(f"no drive can be mounted here: {refused}")
    yield image, folder
    _run(["umount", str(folder)])


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
        writer.write_swing(HalfCycle(index, index, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1, 0))
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
        assert [swing.index for swing in reader.swings()] == list(range(60))
    found = recover(path, tmp_path / "whole.mcap")
    assert found.messages["/swing"] == 60
    assert not [f for f in check_record(tmp_path / "whole.mcap") if f.severity == "error"]
