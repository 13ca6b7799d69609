"""Bounded queue of frames between the camera's thread and the one that processes."""

import threading
import time
from collections import deque
from typing import Literal

from acquisition.frame import Frame

Policy = Literal["wait", "every", "latest"]


class FrameQueue:
    """Passes frames on in blocks, in order, and counts those dropped.

    Policies for a full queue: ``wait`` blocks the camera (simulated time, files: nothing is lost); ``every``
    rejects the newest frame (measurement: losses form one contiguous gap); ``latest`` drops the oldest frame
    (alignment: the display shows the present).
    """

    def __init__(self, capacity: int, policy: Policy) -> None:
        self._frames: deque[Frame] = deque()
        self._capacity = capacity
        self._policy = policy
        self._changed = threading.Condition()
        self._closed = False
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Frames that were lost here."""
        return self._dropped

    def __len__(self) -> int:
        return len(self._frames)

    def put(self, frame: Frame) -> bool:
        """Add a frame; False where it (or an older one) was dropped, or the queue is closed."""
        with self._changed:
            while self._policy == "wait" and len(self._frames) >= self._capacity and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            full = len(self._frames) >= self._capacity
            if full:
                self._dropped += 1
                if self._policy == "every":
                    return False
                self._frames.popleft()
            self._frames.append(frame)
            self._changed.notify_all()
            return not full

    def take(self, at_most: int, timeout_s: float) -> list[Frame]:
        """Up to `at_most` frames, as soon as there is one; empty after the timeout or when drained."""
        with self._changed:
            deadline_s = time.monotonic() + timeout_s
            while not self._frames and not self._closed:
                left_s = deadline_s - time.monotonic()
                if left_s <= 0 or not self._changed.wait(left_s):
                    break
            block = [self._frames.popleft() for _ in range(min(at_most, len(self._frames)))]
            if block:
                self._changed.notify_all()
            return block

    def close(self) -> None:
        """No more frames: a waiting `put` returns False, `take` hands out what is left."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def drained(self) -> bool:
        """Closed and empty."""
        with self._changed:
            return self._closed and not self._frames
