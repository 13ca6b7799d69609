"""Forcing a file to the disk while the thread that writes it goes on."""

import threading
from collections.abc import Callable


class BackgroundSync:
    """Runs `action` in a thread of its own whenever it is asked to; requests that come meanwhile are one.

    The thread ends when there is nothing left to do, so that a record that is never closed leaves none
    behind. What goes wrong in it is kept until it is asked for.
    """

    def __init__(self, action: Callable[[], None]) -> None:
        self._action = action
        self._lock = threading.Lock()
        self._asked = False
        self._thread: threading.Thread | None = None
        self._failure: OSError | None = None

    def request(self) -> None:
        """Have it done as soon as possible, after this call and at least once; never waits for it."""
        with self._lock:
            self._asked = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="record sync", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Return when nothing is being done any more."""
        thread = self._thread
        if thread is not None:
            thread.join()

    def take_failure(self) -> OSError | None:
        """First error since the last call."""
        with self._lock:
            failure, self._failure = self._failure, None
        return failure

    def _work(self) -> None:
        while True:
            with self._lock:
                if not self._asked:
                    self._thread = None
                    return
                self._asked = False
            try:
                self._action()
            except OSError as error:
                with self._lock:
                    self._failure = self._failure or error
