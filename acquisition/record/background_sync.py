"""Forces a file to the disk (fsync) in a thread, so that the thread that writes it does not wait."""

import threading
from collections.abc import Callable


class BackgroundSync:
    """Runs `action` in a thread on request; all requests during a run are answered by one further run.

    The thread ends when there is nothing left to do, so that a record that is never closed leaves no thread.
    An OSError of the action is kept until `take_failure`.
    """

    def __init__(self, action: Callable[[], None]) -> None:
        self._action = action
        self._lock = threading.Lock()
        self._asked = False
        self._thread: threading.Thread | None = None
        self._failure: OSError | None = None

    def request(self) -> None:
        """Start a run of the action after this call, as soon as possible; does not wait for it."""
        with self._lock:
            self._asked = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="record sync", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Wait until all requested runs have ended."""
        thread = self._thread
        if thread is not None:
            thread.join()

    def take_failure(self) -> OSError | None:
        """First error since the last call, or None."""
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
