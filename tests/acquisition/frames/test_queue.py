"""The frame queue: its policies, order, losses, end of waiting at close; memory that bounds it."""

import math
import threading

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.frames.queue import MAX_QUEUE_BYTES, BoundedQueue, Policy


def frame(sequence: int) -> Frame:
    return Frame(np.zeros((2, 3), np.uint8), sequence, sequence * 1000, sequence * 1000)


def sequences(frames: list[Frame]) -> list[int]:
    return [f.sequence for f in frames]


def test_drop_refuses_the_newest_and_counts() -> None:
    queue = BoundedQueue[Frame](3, "drop")
    taken = [queue.put(frame(i)) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert queue.dropped == 2
    assert sequences(queue.take(10, 0.0)) == [0, 1, 2]


def test_wait_holds_the_camera_back_and_loses_nothing() -> None:
    queue = BoundedQueue[Frame](4, "wait")

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
    queue = BoundedQueue[Frame](1, "wait")
    queue.put(frame(0))
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(queue.put(frame(1))))
    thread.start()
    queue.close()
    thread.join(timeout=5)
    assert answers == [False]
    assert sequences(queue.take(5, 0.0)) == [0]
    assert queue.drained


@pytest.mark.parametrize("policy", ["wait", "drop"])
def test_take_on_a_closed_empty_queue_returns_at_once(policy: Policy) -> None:
    queue = BoundedQueue[Frame](2, policy)
    queue.close()
    assert queue.take(5, 60.0) == []


@pytest.mark.parametrize("size_px", [(256, 256), (640, 480), (1280, 1024), (20_000, 20_000)])
def test_memory_bounds_what_waits_whatever_the_size_of_a_frame(size_px: tuple[int, int]) -> None:
    queue = BoundedQueue[Frame](math.inf, "drop", MAX_QUEUE_BYTES, min_items=8)
    image = np.broadcast_to(np.zeros(1, np.uint8), size_px)
    count = 0
    while queue.put(Frame(image, count, count, count)):
        count += 1
    assert queue.dropped == 1
    if image.nbytes > MAX_QUEUE_BYTES:
        assert count == 8
    else:
        assert count * (image.nbytes + 2048) >= 0.9 * MAX_QUEUE_BYTES
        assert queue.waiting_bytes <= MAX_QUEUE_BYTES
    assert len(queue.take(count, 0.0)) == count
    assert queue.waiting_bytes == 0


def test_a_backlog_is_said_once_and_so_is_its_end() -> None:
    frame = Frame(np.zeros((480, 640), np.uint8), 0, 0, 0)
    queue = BoundedQueue[Frame](math.inf, "drop", 100 * frame.memory_bytes)
    said = []
    for number in range(50):
        queue.put(frame._replace(sequence=number))
        said.append(queue.remark())
    while len(queue):
        queue.take(3, 0.0)
        said.append(queue.remark())
    begun, ended = [text for text in said if text]
    assert begun.startswith("13 frames wait to be processed, 4 of 31 MB")
    assert "lost and counted" in begun
    assert ended == "caught up; at most 50 frames waited, 15 MB"


@pytest.mark.parametrize(("policy", "count"), [("drop", 12), ("wait", 50)])
def test_a_few_frames_that_wait_and_those_on_demand_are_nothing_to_say(policy: Policy, count: int) -> None:
    frame = Frame(np.zeros((480, 640), np.uint8), 0, 0, 0)
    queue = BoundedQueue[Frame](math.inf, policy, 100 * frame.memory_bytes)
    for number in range(count):
        queue.put(frame._replace(sequence=number))
        assert not queue.remark()
    while queue.take(3, 0.0):
        assert not queue.remark()
