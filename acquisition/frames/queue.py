"""Bounded queue of frames between the camera's thread and that of processing."""

import threading
import time
from collections import deque
from typing import Literal

from acquisition.camera import Frame

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
        """Frames lost by this queue."""
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


MAX_QUEUE_BYTES = 256 * 1024 * 1024
"""Memory for waiting frames: 1.7 s of 640 x 480 px at 500 frames/s, in bytes."""
_OWN_BYTES = 1024
"""Memory of a frame beyond its pixels."""
_MIN_FRAMES = 8
_MAX_FRAMES_ON_DEMAND = 64
_WARN_FRACTION = 0.125
"""Filled part that causes a warning."""


def queue_capacity(frame: Frame, policy: Policy) -> int:
    """Capacity of the queue in frames: `MAX_QUEUE_BYTES` of them, a few at least.

    With the policy "wait" none are lost: there a short queue keeps frames in the CPU's cache.
    """
    most = max(_MIN_FRAMES, MAX_QUEUE_BYTES // (frame.image.nbytes + _OWN_BYTES))
    return min(_MAX_FRAMES_ON_DEMAND, most) if policy == "wait" else most


class Backlog:
    """Notices when many frames wait, and when they no longer do.

    Parameters
    ----------
    capacity
        Number of frames for which there is memory.
    frame_bytes
        Size of one of them.
    """

    def __init__(self, capacity: int, frame_bytes: int) -> None:
        self._capacity = capacity
        self._frame_mb = frame_bytes / 1e6
        self._peak = 0

    def message_for(self, waiting: int) -> str:
        """Message when so many waiting frames are first many, or few again; otherwise an empty text."""
        if waiting > max(_WARN_FRACTION * self._capacity, self._peak):
            begins, self._peak = not self._peak, waiting
            if begins:
                memory_mb = self._capacity * self._frame_mb
                return (
                    f"{waiting} frames wait to be processed, {waiting * self._frame_mb:.0f} of "
                    f"{memory_mb:.0f} MB; once full, frames are lost and counted: close other programs, or "
                    "set a lower camera.frame_rate_hz or a smaller region"
                )
        elif self._peak and waiting <= 0.1 * _WARN_FRACTION * self._capacity:
            most, self._peak = self._peak, 0
            return f"caught up; at most {most} frames waited, {most * self._frame_mb:.0f} MB"
        return ""
