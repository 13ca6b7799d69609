"""Taking leave of a camera: libaravis waits 2.5 s for each reply of one that is gone, we don't."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_PATIENCE_S: Final = 0.4
_LONGEST_S: Final = 15.0


class Parting:
    """Does what comes last with a camera in threads, one after the other, and waits for them a little."""

    def __init__(self) -> None:
        self._threads: list[threading.Thread] = []

    def leave(self, action: Callable[[], None], held: list[Any], error: type[Exception]) -> None:
        """Do the action, then empty the list `held`; returns soon, done or not.

        Nobody else may hold what is in the list: the last to let go of a camera waits for its reply.
        """
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        thread = threading.Thread(
            target=_leave, args=(action, held, error, list(self._threads)), name="leaves camera", daemon=True
        )
        del action
        self._threads.append(thread)
        thread.start()
        thread.join(_PATIENCE_S)

    def wait(self, name: str) -> None:
        """Until all is done: a camera that is still being given back must not be taken again.

        Raises DeviceError where that takes too long.
        """
        deadline_s = time.monotonic() + _LONGEST_S
        for thread in list(self._threads):
            thread.join(max(deadline_s - time.monotonic(), 0.0))
            if thread.is_alive():
                raise DeviceError(f"{name}: does not answer, and is still being given back; wait")


def nothing() -> None:
    """For leaving without a last action."""


def _leave(
    action: Callable[[], None], held: list[Any], error: type[Exception], before: list[threading.Thread]
) -> None:
    for other in before:
        other.join()
    try:
        action()
    except error as refused:
        logger.info("%s", refused)
    held.clear()
