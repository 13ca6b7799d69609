"""The frame queue and its policies every, latest and wait: order, losses, end of waiting at close."""

import threading

import numpy as np
import pytest

from acquisition.frame import Frame
from acquisition.frame_queue import FrameQueue


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
