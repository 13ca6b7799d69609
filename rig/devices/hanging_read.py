"""Notices that a camera's `read` does not return, which its driver, perhaps somebody's own, must not do."""

from collections.abc import Callable
from concurrent.futures import Future, wait
from threading import Event, Thread
from typing import Final, TypeVar

HANGS_S: Final = 10.0
"""Longer than it was asked to wait: a `read` that has not returned then is not waited for."""
_ELSEWHERE: Final = -1
_LOOK_S: Final = 0.05
T = TypeVar("T")


class HangingRead:
    """Told by the thread that reads, asked by the one that waits for frames.

    It counts the waits of the latter, not a clock: while the program stands still nobody waits.
    """

    def __init__(self, asked_s: float, hangs_s: float = HANGS_S) -> None:
        self._asked_s, self._longest_s = asked_s, asked_s + hangs_s
        self._reads = 0
        self._now = self._then = _ELSEWHERE
        self._waited_s = 0.0

    def begins(self) -> None:
        """A `read` begins."""
        self._reads += 1
        self._now = self._reads

    def is_elsewhere(self) -> None:
        """The thread does something that has a limit of its own."""
        self._now = _ELSEWHERE

    def after(self, waited_s: float) -> str:
        """What is to be said after so long without a frame; 0 with one."""
        same = self._now == self._then and self._now != _ELSEWHERE
        self._waited_s = self._waited_s + waited_s if same and waited_s else 0.0
        self._then = self._now
        if self._waited_s < self._longest_s:
            return ""
        return (
            f"camera: read() has not returned for {self._waited_s:.0f} s; it was asked to wait for "
            f"{self._asked_s:g} s at most: its driver hangs"
        )


def beside(do: Callable[[], T]) -> tuple[Thread, Future[T]]:
    """Begin to do it in a thread of its own, whose result is still to come."""
    coming: Future[T] = Future()

    def run() -> None:
        try:
            coming.set_result(do())
        except Exception as error:
            coming.set_exception(error)

    thread = Thread(target=run, name="camera, first frame", daemon=True)
    thread.start()
    return thread, coming


def awaited(coming: Future[T], waited: Callable[[float], None], stop: Event) -> T | None:
    """What comes, returned or raised; None after `stop`.

    `waited` is told each time how long it took again, and raises where that is too long.
    """
    while not stop.is_set():
        if wait([coming], _LOOK_S).done:
            return coming.result()
        waited(_LOOK_S)
    return None
