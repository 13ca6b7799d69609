"""Frames that wait for the processor: bounded by their bytes, and said when many do."""

import numpy as np

from acquisition.frame import Frame
from acquisition.frame_queue import FrameQueue
from rig.devices.frame_stream import MOST_BYTES, Backlog, most_waiting


def frame(width_px: int, height_px: int, number: int = 0) -> Frame:
    return Frame(np.zeros((height_px, width_px), np.uint8), number, number * 1000, number * 1000)


def test_memory_bounds_what_waits_whatever_the_size_of_a_frame() -> None:
    for width_px, height_px in ((16, 16), (256, 256), (640, 480), (1280, 1024)):
        count = most_waiting(frame(width_px, height_px), "every")
        assert count * width_px * height_px <= MOST_BYTES
        assert count * (width_px * height_px + 2048) >= 0.9 * MOST_BYTES
    assert most_waiting(frame(20_000, 20_000), "every") == 8
    assert most_waiting(frame(256, 256), "every") / 2000.0 > 1.0  # s
    assert most_waiting(frame(256, 256), "wait") == 64


def test_a_backlog_is_said_once_and_so_is_its_end() -> None:
    queue = FrameQueue(100, "every")
    backlog = Backlog(100, 307_200)
    said = []
    for number in range(50):
        queue.put(frame(640, 480, number))
        said.append(backlog.see(len(queue)))
    while len(queue):
        queue.take(3, 0.0)
        said.append(backlog.see(len(queue)))
    begun, ended = [text for text in said if text]
    assert begun.startswith("13 frames wait for the processor, 4 of 31 MB")
    assert "lost and counted" in begun
    assert ended == "caught up; at most 50 frames waited, 15 MB"


def test_a_few_frames_that_wait_are_nothing_to_say() -> None:
    backlog = Backlog(870, 307_200)
    assert not any(backlog.see(waiting) for waiting in (1, 50, 100, 3, 0))
