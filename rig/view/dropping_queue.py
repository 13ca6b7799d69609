"""A bounded, non-blocking queue to the viewer, which drops and counts the oldest messages."""

import threading
from collections import Counter, deque

from rig.rerun import Message, Picture, rows, size_bytes


class DroppingQueue:
    """Queue of messages to a viewer that may be slow or may have crashed.

    `put` never waits for the reader. Beyond `limit_bytes` the oldest message is dropped and counted.
    Pictures have a separate limit, `picture_places`, so that they never displace curves.
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
        """Append a message; drops the oldest ones if the queue is full, and this one after `close`."""
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
        """The oldest messages and the pictures; empty after the timeout."""
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
        """Count messages that were taken but not delivered."""
        with self._changed:
            for message in batch:
                self._count(message)

    def close(self) -> None:
        """Accept no more messages; those in the queue can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def drop_rest(self) -> None:
        """Drop and count all messages in the queue."""
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
        """Filling from 0 to 1, of bytes or of pictures, whichever is larger."""
        with self._changed:
            return max(self._bytes / self._limit_bytes, len(self._pictures) / self._picture_places)

    @property
    def dropped(self) -> dict[str, int]:
        """Number dropped so far by kind of message; samples and swings are counted individually."""
        with self._changed:
            return dict(self._dropped)

    def _count(self, message: Message) -> None:
        self._dropped[type(message).__name__.lower()] += rows(message)
