"""Delivers messages from a queue that drops to a worker process, and replaces the worker if it fails."""

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.rerun import Finish, Message, Picture, Setup, Trouble, rows, size_bytes
from rig.view.worker_process import WorkerProcess


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
        self._dropped = 0
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
    def dropped(self) -> int:
        """Number dropped so far; samples and swings are counted individually."""
        return self._dropped

    def _count(self, message: Message) -> None:
        self._dropped += rows(message)


logger = logging.getLogger(__name__)

BATCH_BYTES = 4 << 20
SMALL_BYTES, GATHER_S = 64 << 10, 0.05
"""After a smaller batch the next one is gathered for so long: frames come one by one, and each would be
packed, sent and answered by itself, for which all threads of the measurement wait in turn."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
LONG_LIFE_S = 60.0
START_LIMIT_S = 60.0


class Feed:
    """Feeds one stream (a file or a live view) to a worker.

    Parameters
    ----------
    setup
        First message to the worker. A replacement gets it with a new file name.
    queue_bytes, hang_limit_s
        See `rig.view.viewer.Viewer`.
    note
        Called with messages to the user, in threads of the feed.
    on_ready
        Called when a worker has opened its stream, with the address of a live one; returns the
        viewer's address for commands, which the next worker needs.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        queue_bytes: int,
        hang_limit_s: float,
        note: Callable[[str, Trouble], None],
        on_ready: Callable[[str], str] = lambda url: "",
    ) -> None:
        self.queue = DroppingQueue(queue_bytes)
        self.sent = 0
        self.restarts = 0
        self.url = ""
        self._setup = setup
        self._hang_limit_s = hang_limit_s
        self._note = note
        self._on_ready = on_ready
        self._worker: WorkerProcess | None = None
        self._ready = False
        self._hurry = threading.Event()
        self._abandoned = False
        self._thread = threading.Thread(target=self._feed_workers, name="view", daemon=True)

    def start(self) -> None:
        """Start the first worker; returns before it runs."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """True if a worker is running and has opened its stream."""
        worker = self._worker
        return self._ready and worker is not None and worker.running

    @property
    def worker_pid(self) -> int | None:
        """Process number of the present worker."""
        return self._worker.pid if self._worker is not None else None

    def close(self) -> None:
        """Accept no more messages; let the worker complete its stream and end."""
        self.queue.close()
        self._hurry.set()

    def wait(self, deadline_s: float) -> None:
        """Wait for the worker's end until `time.monotonic()` is `deadline_s`, then kill it."""
        if self._thread.is_alive():
            self._thread.join(max(0.0, deadline_s - time.monotonic()))
        if self._thread.is_alive():
            self._abandoned = True
            if self._worker is not None:
                self._worker.kill()
            self._thread.join(5.0)
        self.queue.drop_rest()

    def _feed_workers(self) -> None:
        pause_s = FIRST_PAUSE_S
        setup = self._setup
        while not self._abandoned:
            closing = self.queue.closed
            started_s = time.monotonic()
            try:
                worker = self._worker = WorkerProcess(setup, self._on_report)
            except OSError as error:
                self._note(f"the viewer's worker cannot be started: {error}", Trouble.NONE)
                return
            complete = self._feed(worker)
            self._ready = False
            worker.kill()
            if complete or closing or self._abandoned:
                return
            self.restarts += 1
            logger.warning("the viewer's worker died or stopped answering; it is replaced")
            # A worker that ran for long is replaced immediately; after repeated failures the delay grows.
            lived_long = time.monotonic() - started_s > LONG_LIFE_S
            pause_s = FIRST_PAUSE_S if lived_long else min(2 * pause_s, LONGEST_PAUSE_S)
            self._hurry.wait(pause_s)
            setup = self._next_setup()

    def _feed(self, worker: WorkerProcess) -> bool:
        """Deliver messages to one worker until all are delivered (True) or it fails (False)."""
        if not worker.wait_ready(START_LIMIT_S):
            return False
        self._ready = True
        self._setup = self._setup._replace(viewer_url=self._on_ready(self.url))
        while True:
            batch = self.queue.take(0.25, BATCH_BYTES)
            if batch:
                drawn = worker.deliver(batch, self._hang_limit_s)
                if drawn:
                    self.sent += sum(rows(message) for message in batch)
                else:
                    self.queue.count_lost(batch)
                if drawn is None:
                    return False
                if sum(map(size_bytes, batch)) < SMALL_BYTES:
                    self._hurry.wait(GATHER_S)
            elif not worker.running:
                return False
            elif self.queue.closed and self.queue.empty:
                return worker.finish([Finish()], self._hang_limit_s)

    def _next_setup(self) -> Setup:
        """Setup of the next worker, with a new file name, because no file is ever overwritten.

        A live stream moves to another port if the viewer can be given it, because a viewer ignores a
        new stream at an address that it knows. A web page keeps the port, so that reloading it works.
        """
        setup = self._setup
        if setup.rrd_path is None:
            return setup._replace(port=0) if setup.viewer_url else setup
        first = Path(setup.rrd_path)
        parts = (first.with_stem(f"{first.stem}-part{number}") for number in itertools.count(2))
        return setup._replace(rrd_path=str(next(part for part in parts if not part.exists())))

    def _on_report(self, report: dict[str, Any]) -> None:
        for note, trouble in report.get("notes", []):
            self._note(str(note), Trouble(trouble))
        if "port" in report:
            self.url = str(report["url"])
            self._setup = self._setup._replace(port=int(report["port"]))
