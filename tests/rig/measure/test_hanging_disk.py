"""A disk that does not answer for a while: frames wait in memory, those beyond it are counted, it is said."""

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.frames.queue import BoundedQueue
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from rig.instrument import Block
from rig.measure import recorder as module
from rig.measure.recorder import RecordEntry, Recorder
from tests.acquisition.record.hanging_disk import Mounted, NoFuse, mounted
from tests.rig.acting import acting
from tests.rig.command_line import SMALL, run
from tests.waiting import until

FRAMES = 200
PIXELS = np.random.default_rng(1).poisson(30, (96, 96)).astype(np.uint8)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Mounted]:
    try:
        with mounted(tmp_path) as found:
            yield found
    except NoFuse as missing:
        pytest.skip(str(missing))


def entry_of(frame: Frame) -> RecordEntry:
    numbers, times = [frame.sequence], np.array([frame.time_ns])
    one = np.ones(1)
    spot = Spot(*[1.0] * 10, flags=0)
    block = Block([spot], Deflections(times, one, one, one, one, DeflectionUnit.RAD))
    return RecordEntry(numbers, times.tolist(), times.tolist(), block, [(frame.image, 0, 0)])


def frame(number: int) -> Frame:
    return Frame(PIXELS, number, number * 10_000_000, 0)


def test_frames_wait_in_memory_and_beyond_it_are_counted(
    disk: Mounted, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_WRITE_S", 0.01)
    path = disk.folder / "run.mcap"
    reach = entry_of(frame(0)).memory_bytes * FRAMES
    recorder = Recorder(RecordWriter(path, 0, flush_interval_s=0.01), reach)
    recorder.put(entry_of(frame(0)))
    until(lambda: recorder.entries.waiting_bytes == 0)
    disk.hang()
    recorder.put(entry_of(frame(1)))
    disk.wait_for_hanging()
    for number in range(2, FRAMES):
        recorder.put(entry_of(frame(number)))
    assert recorder.entries.waiting_bytes > reach // 2
    until(lambda: recorder.alarm)
    assert re.search(
        r"the disk has not answered for \d+ s; [12] of 2 MB of memory wait for it", recorder.alarm
    )
    # what comes now finds no room in front of the processing either
    frames = BoundedQueue[Frame](8, "drop")
    with acting(lambda: put_all(frames, recorder)):
        later = range(FRAMES, 2 * FRAMES)
        taken = [number for number in later if frames.put(frame(number))]
        assert frames.dropped == FRAMES - len(taken) > 0
        disk.go_on()
        frames.close()
    recorder.close()
    assert recorder.error is None
    assert recorder.alarm == ""
    assert max(recorder.take_pauses()) > 0.01
    with RecordReader(path) as reader:
        assert reader.spots()["sequence"].tolist() == [*range(FRAMES), *taken]
        assert [window.sequence for window in reader.windows()] == [*range(FRAMES), *taken]


def put_all(frames: BoundedQueue[Frame], recorder: Recorder) -> None:
    while not frames.drained:
        for each in frames.take(1, 1.0):
            recorder.put(entry_of(each))


@pytest.mark.slow
def test_a_session_says_that_its_disk_hung(disk: Mounted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WRITE_S", 0.05)
    original = RecordWriter.write_spots
    recording = threading.Event()

    def begun(*arguments: Any) -> None:
        # early in the run, however fast it is: most of its frames are written after this
        if not recording.is_set():
            disk.hang()
            recording.set()
        original(*arguments)

    def hang() -> None:
        until(recording.is_set)
        disk.wait_for_hanging()
        time.sleep(0.5)
        disk.go_on()

    monkeypatch.setattr(RecordWriter, "write_spots", begun)
    # a run faster than real time is over before it writes to the disk for the second time
    live = {**SMALL, "session.max_duration_s": "4", "simulation.real_time": "true"}
    with acting(hang):
        session = run(disk.folder / "out", live, preflight__when='"never"')
    with RecordReader(session.record) as reader:
        sequences = reader.spots()["sequence"].tolist()
    assert sequences == list(range(len(sequences)))
    assert len(sequences) >= 4 * 50
    said = [text for kind, text in session.events if kind == "slow disk"]
    assert said[0].startswith("did not answer for ")
