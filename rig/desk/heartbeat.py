"""Whether the session that is followed lives at all, however long its news take."""

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path

from rig.channel import Line, NoSession

_EACH_S = 0.25


class Heartbeat:
    """A thread that asks the session in `folder()` for a sign of life, on a connection of its own.

    News wait for the threads that measure, and take work to make: on a busy machine they come seconds late
    from a session that is sound. A beat waits for neither.
    """

    def __init__(self, folder: Callable[[], Path | None]) -> None:
        self._folder = folder
        self._beat_s = -math.inf
        self._line: Line | None = None
        self._ended = threading.Event()

    def start(self) -> None:
        """Begin to ask."""
        threading.Thread(target=self._ask, name="heartbeat", daemon=True).start()

    def stop(self) -> None:
        """Ask no more."""
        self._ended.set()

    @property
    def age_s(self) -> float:
        """Time since the session has last answered; infinite where it never has."""
        return time.monotonic() - self._beat_s

    def _ask(self) -> None:
        while not self._ended.wait(_EACH_S):
            folder = self._folder()
            if self._line is not None and self._line.folder != folder:
                self._line.close()
                self._line, self._beat_s = None, -math.inf
            try:
                if folder is not None:
                    self._line = self._line or Line(folder)
                    self._line.beat()
                    self._beat_s = time.monotonic()
            except NoSession:
                # it may be another session's file by now
                if self._line is not None:
                    self._line.close()
                self._line = None
        if self._line is not None:
            self._line.close()
