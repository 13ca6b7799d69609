"""Bounded queue between two threads: of frames from a camera, or of entries that wait for the disk."""

import math
import threading
import time
from collections import deque
from typing import Generic, Literal, Protocol, TypeVar

Policy = Literal["wait", "drop"]


class HasSize(Protocol):
    """An item that may wait in a queue."""

    @property
    def memory_bytes(self) -> int:
        """Approximate memory that the item takes while it waits; never 0."""


Item = TypeVar("Item", bound=HasSize)

MAX_QUEUE_BYTES = 256 * 1024 * 1024
"""Largest memory of a queue: for late processing, 1.7 s of 500 frames/s of 640 x 480; for a slow disk, half a
minute of 800 frames/s with windows of 100 x 100 pixels.
"""
_WARN_FRACTION = 0.125
"""Filled fraction of a queue that causes a warning."""


class BoundedQueue(Generic[Item]):
    """A queue that hands out its items in blocks, in order, and counts those dropped.

    Policies for a full queue: ``wait`` blocks the thread that puts (simulated time, files, entries of a
    record: nothing is lost); ``drop`` rejects the newest item (measurement: losses form one contiguous gap).

    Parameters
    ----------
    max_items
        Number of items at which the queue is full.
    max_bytes
        Memory of the items at which the queue is full, too.
    min_items
        Number of items that the queue takes whatever their memory.
    """

    def __init__(
        self, max_items: float, policy: Policy, max_bytes: float = math.inf, *, min_items: int = 1
    ) -> None:
        self._items: deque[Item] = deque()
        self._max_items, self._min_items = max_items, min_items
        self._policy = policy
        self._changed = threading.Condition()
        self._closed = False
        self._peak = self._peak_bytes = 0
        self.max_bytes = max_bytes
        self.waiting_bytes = 0
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> bool:
        """Add an item; False where it was dropped, or the queue is closed."""
        size = item.memory_bytes
        with self._changed:
            while self._policy == "wait" and self._is_full(size) and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            if self._is_full(size):
                self.dropped += 1
                return False
            self._items.append(item)
            self.waiting_bytes += size
            self._changed.notify_all()
            return True

    def take(self, count: int, timeout_s: float) -> list[Item]:
        """Up to `count` items, as soon as there is any; an empty list after the timeout or when drained."""
        with self._changed:
            deadline_s = time.monotonic() + timeout_s
            while not self._items and not self._closed:
                left_s = deadline_s - time.monotonic()
                if left_s <= 0 or not self._changed.wait(left_s):
                    break
            block = [self._items.popleft() for _ in range(min(count, len(self._items)))]
            if block:
                self.waiting_bytes -= sum(item.memory_bytes for item in block)
                self._changed.notify_all()
            return block

    def close(self) -> None:
        """Accept no more items: a waiting `put` returns False, `take` hands out the remaining items."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def drained(self) -> bool:
        """Whether the queue is closed and empty."""
        with self._changed:
            return self._closed and not self._items

    def remark(self) -> str:
        """A message once when many frames begin to wait, and once when they no longer do; otherwise, and with
        the policy ``wait``, an empty text.
        """
        waiting, size = len(self._items), self.waiting_bytes
        if size > max(_WARN_FRACTION * self.max_bytes, self._peak_bytes) and self._policy != "wait":
            begins, self._peak, self._peak_bytes = not self._peak, waiting, size
            if begins:
                memory = f"{size / 1e6:.0f} of {self.max_bytes / 1e6:.0f} MB"
                return (
                    f"{waiting} frames wait to be processed, {memory}; once full, frames are lost and "
                    "counted: close other programs, or set a lower camera.frame_rate_hz or a smaller region"
                )
        elif self._peak and size <= 0.1 * _WARN_FRACTION * self.max_bytes:
            text = f"caught up; at most {self._peak} frames waited, {self._peak_bytes / 1e6:.0f} MB"
            self._peak = self._peak_bytes = 0
            return text
        return ""

    def _is_full(self, more_bytes: int) -> bool:
        count, size = len(self._items), self.waiting_bytes + more_bytes
        return count >= self._max_items or (count >= self._min_items and size > self.max_bytes)


_Value = TypeVar("_Value")


def take_all(waiting: deque[_Value]) -> list[_Value]:
    """Take all waiting items, oldest first; another thread may add items meanwhile."""
    return [waiting.popleft() for _ in range(len(waiting))]
