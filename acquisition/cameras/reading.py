"""One run of a camera, from start to stop, that is read in the thread which asks for its frames."""

import threading
import time
from collections.abc import Callable
from typing import Final

from acquisition.camera import Frame
from processing.errors import RigError

_POLL_S: Final = 0.05  # longest wait for the camera, after which `read` checks for `stop`


class CameraRun:
    """Reads a camera when asked, and ends once: by `stop` from any thread, or by an error.

    Parameters
    ----------
    step
        Waits for the camera for at most this many seconds; returns the frame that was completed, if any.
    end
        Gives back what the run has claimed; called when no `step` is under way, and none will be.

    Attributes
    ----------
    delivered
        Number of frames that `read` has returned.
    """

    def __init__(self, step: Callable[[float], Frame | None], end: Callable[[], None]) -> None:
        self._step = step
        self._at_end = [end]
        self._in_use = threading.Lock()
        self._ending = threading.Lock()
        self._stopping = threading.Event()
        self._ended = False
        self._error: RigError | None = None
        self.delivered = 0

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame; None after `stop`.

        Raises TimeoutError if there was none in time. Any other error ends the run, and is raised again by
        every later call.
        """
        with self._in_use:
            deadline_s = time.monotonic() + timeout_s
            try:
                if self._error is not None:
                    raise type(self._error)(str(self._error))
                while not self._stopping.is_set():
                    left_s = max(deadline_s - time.monotonic(), 0.0)
                    frame = self._step(min(left_s, _POLL_S))
                    if self._stopping.is_set():
                        return None
                    if frame is not None:
                        self.delivered += 1
                        return frame
                    if not left_s:
                        raise TimeoutError
                return None
            except RigError as error:
                self._error = error
                self._stopping.set()
                raise
            finally:
                if self._stopping.is_set():
                    self._end()

    def request_stop(self) -> None:
        """Have a `read` that waits return, without waiting for it."""
        self._stopping.set()

    def stop(self, timeout_s: float) -> bool:
        """End the run, at the latest when a `read` that waits has noticed; False if that takes longer."""
        self._stopping.set()
        if not self._in_use.acquire(timeout=timeout_s):
            return False
        try:
            self._end()
        finally:
            self._in_use.release()
        return True

    @property
    def stopped(self) -> bool:
        """Whether no more frames will come."""
        return self._stopping.is_set()

    def when_ended(self, action: Callable[[], None]) -> None:
        """Run `action` when the camera is no longer read: then, or now if that is so already."""
        with self._ending:
            if not self._ended:
                self._at_end.append(action)
                return
        action()

    def _end(self) -> None:
        with self._ending:
            actions, self._at_end = self._at_end, []
            self._ended = True
        for action in actions:
            action()
