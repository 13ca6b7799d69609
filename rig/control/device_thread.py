"""Base class of services that operate one device in a separate thread."""

import logging
from abc import ABC, abstractmethod
from collections import deque
from types import TracebackType
from typing import Self

from rig.control.worker import Worker

_log = logging.getLogger(__name__)
_EVENTS_KEPT = 1024


class DeviceThread(ABC):
    """Operates one device in one thread from `start` to `close`; a context manager.

    Parameters
    ----------
    name
        Name of the thread, also used in messages.
    longest_job_s
        Longest duration of one job; `close` waits for this time so that the device can be left safe.
    """

    def __init__(self, name: str, longest_job_s: float = 5.0) -> None:
        self.name = name
        self._longest_job_s = longest_job_s
        self._events: deque[str] = deque(maxlen=_EVENTS_KEPT)
        self._worker = Worker(name, self._turn, self._finish)

    @abstractmethod
    def _turn(self) -> float:
        """Regular work on the device; returns the time in s until the next call."""

    @abstractmethod
    def _finish(self) -> None:
        """Put the device into its safe state and close it."""

    def start(self) -> None:
        """Start the thread."""
        self._worker.start()

    def close(self) -> bool:
        """Put the device into its safe state, close it and end the thread; False if the thread hangs."""
        return self._worker.close(self._longest_job_s)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def failure(self) -> BaseException | None:
        """The error that ended the thread; None while it runs, and after a regular end."""
        return self._worker.failure

    def take_events(self) -> tuple[str, ...]:
        """Texts of the events since the last call, oldest first: device opened, lost, tripped, or its errors.

        Never blocks. Only one thread may call it.
        """
        events = []
        while self._events:
            events.append(self._events.popleft())
        return tuple(events)

    def _say(self, text: str) -> None:
        _log.info("%s: %s", self.name, text)
        self._events.append(text)
