"""A reader sees what is flushed to a growing record, and knows when nothing more comes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.digest import is_being_written
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = """
import sys, time
from pathlib import Path
from acquisition.record.writer import RecordWriter
writer = RecordWriter(Path(sys.argv[1]), 0)
for index in range(3):
    writer.write_event(index, "kind", str(index))
    writer.flush()
print("flushed", flush=True)
sys.stdin.readline()
writer.write_event(3, "kind", "3")
writer.close()
"""


def test_everything_that_was_flushed_is_seen_once_it_was(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    pixels = np.arange(64, dtype=np.uint8).reshape(8, 8)
    with RecordWriter(path, 0, flush_interval_s=1e9) as writer, RecordReader(path) as reader:
        looks = reader.follow(0.001)
        next(looks)
        for number in range(5):
            writer.write_event(number, "kind", str(number))
            writer.write_window(number, number, pixels, 0, 0)
            assert not reader.update()
            writer.flush()
            next(looks)
            assert [event.time_ns for event in reader.events()] == list(range(number + 1))
            assert [window.sequence for window in reader.windows()] == list(range(number + 1))
            assert is_being_written(path)
        writer.close()
        for _ in looks:
            pass
        assert not reader.truncated
        assert not is_being_written(path)
        assert reader.counts["/event"] == 5
        assert reader.doubts() == []


def test_each_piece_is_given_once_and_the_same_of_a_record_that_grows(tmp_path: Path) -> None:
    path, image = tmp_path / "run.mcap", np.zeros((8, 8), dtype=np.uint8)
    given, pictures = [], []
    with RecordWriter(path, 0, flush_interval_s=1e9) as writer, RecordReader(path) as reader:
        for number in range(6):
            writer.write_event(number, "kind", str(number))
            writer.write_preview(Frame(image, number, number, number))
            writer.flush()
            reader.update()
            given += [reader.events(piece) for piece in reader.unread()]
            pictures += [one[:2] for one in reader.unread_pictures(2, number)]
        writer.close()
        reader.update()
        assert list(reader.unread()) == []
    with RecordReader(path) as reader:
        assert [reader.events(piece) for piece in reader.unread()] == given
        assert [one[:2] for one in reader.unread_pictures(2, 3)] == [(0, 0), (2, 2)]
        assert [one[:2] for one in reader.unread_pictures(2, 5)] == [(4, 4)]
    assert [event.time_ns for events in given for event in events] == list(range(6))
    assert pictures == [(0, 0), (2, 2), (4, 4)]


@pytest.mark.parametrize("killed", [False, True])
def test_it_ends_with_the_writer_however_that_ends(tmp_path: Path, killed: bool) -> None:
    path = tmp_path / "run.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "flushed\n"
        with RecordReader(path) as reader:
            looks = reader.follow(0.001)
            next(looks)
            assert len(reader.events()) == 3
            if killed:
                process.kill()
            else:
                process.communicate("go on\n")
            for _ in looks:
                pass
            assert len(reader.events()) == (3 if killed else 4)
            assert reader.truncated is killed
