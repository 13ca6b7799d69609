"""A thread that operates one device: the base class for controller, lasers and sensors."""

import itertools
import logging
import queue
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self, TypeVar

from acquisition.frames.queue import take_all
from processing.errors import DeviceError

_log = logging.getLogger(__name__)
_MAX_WAIT_S = 0.5
_MAX_EVENTS = 1024

T = TypeVar("T")


class JobExpired(DeviceError):
    """A job waited too long and was not started, because a late command must not take effect."""


def run_in_thread(function: Callable[..., T], *args: object) -> "Future[T]":
    """Call a function, which may hang at a disk, a port or another process, in a thread of its own.

    The program does not wait for that thread when it ends. A caller that stops waiting cannot cancel the
    call.
    """
    future: Future[T] = Future()
    future.set_running_or_notify_cancel()

    def run() -> None:
        try:
            future.set_result(function(*args))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name=getattr(function, "__name__", "in thread"), daemon=True).start()
    return future


@dataclass(order=True, slots=True)
class _Job:
    """A job of the queue, executed unless `deadline_s` (`time.monotonic`) has passed."""

    order: tuple[int, int]
    """0 if urgent, else 1; and number of the job."""
    deadline_s: float = field(compare=False)
    call: Callable[[], Any] = field(compare=False)
    future: "Future[Any]" = field(compare=False)


class DeviceThread(ABC):
    """Operates one device in one thread from `start` to `close`; a context manager.

    It calls `_poll` regularly and does jobs in between, so that callers never wait for a device. `name` is
    also that of messages; `close` waits for `longest_job_s`, so that the device can be left safe.
    """

    def __init__(self, name: str, longest_job_s: float = 5.0) -> None:
        self.name = name
        self._longest_job_s = longest_job_s
        self._events: deque[str] = deque(maxlen=_MAX_EVENTS)
        self._jobs: queue.PriorityQueue[_Job] = queue.PriorityQueue()
        self._job_numbers = itertools.count()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._accepting = True
        self.failure: BaseException | None = None
        """The error that ended the thread; None while it runs, and after a regular end."""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @abstractmethod
    def _poll(self) -> float:
        """Regular work on the device, done first; returns the longest time in s until the next call."""

    @abstractmethod
    def _finish(self) -> None:
        """Put the device into its safe state and close it; also after an error."""

    def start(self) -> None:
        """Start the thread; may be called once."""
        self._thread.start()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def take_events(self) -> tuple[str, ...]:
        """Texts of the events since the last call, oldest first: device opened, lost, tripped, or its errors.

        Never blocks. Only one thread may call it.
        """
        return tuple(take_all(self._events))

    def _report(self, text: str) -> None:
        _log.info("%s: %s", self.name, text)
        self._events.append(text)

    def _queue(self, call: Callable[[], T], timeout_s: float, urgent: bool = False) -> "Future[T]":
        """Queue a job, before the others if urgent; the future receives its result or error.

        The future of a job that was not started within `timeout_s` raises `JobExpired`. After `close` the
        future raises DeviceError immediately.
        """
        future: Future[T] = Future()
        job = _Job((0 if urgent else 1, next(self._job_numbers)), time.monotonic() + timeout_s, call, future)
        with self._lock:
            if self._accepting:
                self._jobs.put(job)
                return future
        future.set_exception(DeviceError(f"{self.name} is closed"))
        return future

    def close(self) -> bool:
        """Fail the queued jobs, put the device into its safe state, close it, and end the thread.

        Returns False if that hangs. Ctrl-C does not interrupt it: KeyboardInterrupt is raised after the
        device is in its safe state.
        """
        self._stopping.set()
        if self._thread.ident is None:
            self._fail_jobs()
            return True
        self._queue(lambda: None, 0.0, urgent=True)  # wakes the thread
        if self._thread is threading.current_thread():
            return True
        interrupt: KeyboardInterrupt | None = None
        deadline_s = time.monotonic() + self._longest_job_s
        while self._thread.is_alive() and time.monotonic() < deadline_s:
            try:
                self._thread.join(max(deadline_s - time.monotonic(), 0.0))
            except KeyboardInterrupt as error:
                interrupt = error
        if interrupt is not None:
            raise interrupt
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            next_poll_s = 0.0
            while not self._stopping.is_set():
                now_s = time.monotonic()
                if now_s >= next_poll_s:
                    next_poll_s = now_s + self._poll()
                self._run_next_job(min(next_poll_s - time.monotonic(), _MAX_WAIT_S))
        except BaseException as error:
            _log.exception("%s ended", self.name)
            self.failure = error
        finally:
            self._fail_jobs()
            try:
                self._finish()
            except BaseException as error:
                _log.exception("%s did not finish", self.name)
                self.failure = self.failure or error

    def _run_next_job(self, wait_s: float) -> None:
        try:
            job = self._jobs.get(timeout=wait_s) if wait_s > 0 else self._jobs.get_nowait()
        except queue.Empty:
            return
        if self._stopping.is_set():
            self._jobs.put(job)  # fails with the rest
        elif time.monotonic() > job.deadline_s:
            if job.future.set_running_or_notify_cancel():
                job.future.set_exception(
                    JobExpired(f"{self.name} was busy; a command waited too long and was not executed")
                )
        elif job.future.set_running_or_notify_cancel():
            try:
                job.future.set_result(job.call())
            except Exception as error:
                job.future.set_exception(error)

    def _fail_jobs(self) -> None:
        """Fail the queued jobs, and all later ones."""
        with self._lock:
            self._accepting = False
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                return
            if job.future.set_running_or_notify_cancel():
                job.future.set_exception(DeviceError(f"{self.name} is closed"))
