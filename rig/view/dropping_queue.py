"""The queue before the viewer: bounded, never blocking, dropping the oldest and counting it."""

import threading
from collections import Counter, deque

from rig.rerun import Message, Picture, rows, size_bytes


class DroppingQueue:
    """Messages on their way to a viewer that may be slow, hung or dead.

    `put` never waits for the reader. Beyond `limit_bytes` the oldest message goes and is counted.
    Pictures have `picture_places` places of their own, so that they never push a curve out.
    """

    def __init__(self, limit_bytes: int = 64 << 20, picture_places: int = 4) -> None:
        self._limit_bytes = limit_bytes
        self._picture_places = picture_places
        self._messages: deque[tuple[Message, int]] = deque()
        self._pictures: deque[Picture] = deque()
        self._bytes = 0
        self._dropped: Counter[str] = Counter()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, message: Message) -> None:
        """Append a message; drop the oldest while there are too many. After `close` it is dropped."""
        with self._changed:
            if self._closed:
                self._count(message)
                return
            if isinstance(message, Picture):
                self._pictures.append(message)
                if len(self._pictures) > self._picture_places:
                    self._count(self._pictures.popleft())
            else:
                size = size_bytes(message)
                self._messages.append((message, size))
                self._bytes += size
                while self._bytes > self._limit_bytes and len(self._messages) > 1:
                    old, old_size = self._messages.popleft()
                    self._bytes -= old_size
                    self._count(old)
            self._changed.notify()

    def take(self, timeout_s: float, at_most_bytes: int) -> list[Message]:
        """The oldest messages and the pictures; empty where none came within the time."""
        with self._changed:
            if not self._messages and not self._pictures and not self._closed:
                self._changed.wait(timeout_s)
            batch: list[Message] = []
            taken = 0
            while self._messages and (not batch or taken < at_most_bytes):
                message, size = self._messages.popleft()
                batch.append(message)
                taken += size
            self._bytes -= taken
            batch.extend(self._pictures)
            self._pictures.clear()
            return batch

    def count_lost(self, batch: list[Message]) -> None:
        """Count messages that were taken and did not arrive."""
        with self._changed:
            for message in batch:
                self._count(message)

    def close(self) -> None:
        """Take no more; what is inside can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def drop_rest(self) -> None:
        """Count everything that is still inside as dropped."""
        while batch := self.take(0.0, self._limit_bytes):
            self.count_lost(batch)

    @property
    def closed(self) -> bool:
        return self._closed

    @property
    def empty(self) -> bool:
        with self._changed:
            return not self._messages and not self._pictures

    @property
    def filling(self) -> float:
        """How full it is, 0 to 1, of bytes or of pictures, whichever is more."""
        with self._changed:
            return max(self._bytes / self._limit_bytes, len(self._pictures) / self._picture_places)

    @property
    def dropped(self) -> dict[str, int]:
        """What was dropped so far, by kind of message, samples and swings counted one by one."""
        with self._changed:
            return dict(self._dropped)

    def _count(self, message: Message) -> None:
        self._dropped[type(message).__name__.lower()] += rows(message)
