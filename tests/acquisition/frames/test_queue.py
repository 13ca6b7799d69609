"""The frame queue: its policies, order, losses, end of waiting at close; memory that bounds it."""

import threading

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.frames.queue import MAX_QUEUE_BYTES, Backlog, FrameQueue, queue_capacity


def frame(sequence: int) -> Frame:
    return Frame(np.zeros((2, 3), np.uint8), sequence, sequence * 1000, sequence * 1000)


def sequences(frames: list[Frame]) -> list[int]:
    return [f.sequence for f in frames]


def test_every_refuses_the_newest_and_counts() -> None:
    queue = FrameQueue(3, "every")
    taken = [queue.put(frame(i)) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert queue.dropped == 2
    assert sequences(queue.take(10, 0.0)) == [0, 1, 2]


def test_latest_throws_the_oldest_away() -> None:
    queue = FrameQueue(3, "latest")
    for i in range(5):
        queue.put(frame(i))
    assert queue.dropped == 2
    assert sequences(queue.take(10, 0.0)) == [2, 3, 4]


def test_wait_holds_the_camera_back_and_loses_nothing() -> None:
    queue = FrameQueue(4, "wait")

    def camera() -> None:
        for i in range(200):
            assert queue.put(frame(i))
        queue.close()

    thread = threading.Thread(target=camera)
    thread.start()
    seen: list[int] = []
    while not queue.drained:
        seen += sequences(queue.take(3, 0.5))
        assert len(queue) <= 4
    thread.join()
    assert seen == list(range(200))
    assert queue.dropped == 0


def test_close_releases_a_waiting_camera() -> None:
    queue = FrameQueue(1, "wait")
    queue.put(frame(0))
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(queue.put(frame(1))))
    thread.start()
    queue.close()
    thread.join(timeout=5)
    assert answers == [False]
    assert sequences(queue.take(5, 0.0)) == [0]
    assert queue.drained


@pytest.mark.parametrize("policy", ["wait", "every", "latest"])
def test_take_on_a_closed_empty_queue_returns_at_once(policy: str) -> None:
    queue = FrameQueue(2, policy)  # type: ignore[arg-type]
    queue.close()
    assert queue.take(5, 60.0) == []


def sized(width_px: int, height_px: int, number: int = 0) -> Frame:
    return Frame(np.zeros((height_px, width_px), np.uint8), number, number * 1000, number * 1000)


def test_memory_bounds_what_waits_whatever_the_size_of_a_frame() -> None:
    for width_px, height_px in ((16, 16), (256, 256), (640, 480), (1280, 1024)):
        count = queue_capacity(sized(width_px, height_px), "every")
        assert count * width_px * height_px <= MAX_QUEUE_BYTES
        assert count * (width_px * height_px + 2048) >= 0.9 * MAX_QUEUE_BYTES
    assert queue_capacity(sized(20_000, 20_000), "every") == 8
    assert queue_capacity(sized(256, 256), "every") / 2000.0 > 1.0  # s
    assert queue_capacity(sized(256, 256), "wait") == 64


def test_a_backlog_is_said_once_and_so_is_its_end() -> None:
    queue = FrameQueue(100, "every")
    backlog = Backlog(100, 307_200)
    said = []
    for number in range(50):
        queue.put(sized(640, 480, number))
        said.append(backlog.message_for(len(queue)))
    while len(queue):
        queue.take(3, 0.0)
        said.append(backlog.message_for(len(queue)))
    begun, ended = [text for text in said if text]
    assert begun.startswith("13 frames wait to be processed, 4 of 31 MB")
    assert "lost and counted" in begun
    assert ended == "caught up; at most 50 frames waited, 15 MB"


def test_a_few_frames_that_wait_are_nothing_to_say() -> None:
    backlog = Backlog(870, 307_200)
    assert not any(backlog.message_for(waiting) for waiting in (1, 50, 100, 3, 0))
