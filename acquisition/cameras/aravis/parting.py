"""Release of a camera in the background: libaravis waits 2.5 s for each reply of one that is gone."""

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
    """Runs the final actions on a camera in threads, one after the other, and waits for them only briefly."""

    def __init__(self) -> None:
        self._threads: list[threading.Thread] = []

    def leave(self, action: Callable[[], None], held: list[Any], error: type[Exception]) -> None:
        """Run the action, then clear the list `held`; returns soon, whether this is finished or not.

        There must be no other references to the objects in the list, because dropping the last reference to a
        camera waits for its reply.
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
        """Wait until all actions are finished; a camera that is still being released must not be opened.

        Raises DeviceError if that takes too long.
        """
        deadline_s = time.monotonic() + _LONGEST_S
        for thread in list(self._threads):
            thread.join(max(deadline_s - time.monotonic(), 0.0))
            if thread.is_alive():
                raise DeviceError(f"{name}: does not answer, and is still being closed; wait")


def nothing() -> None:
    """Empty action."""


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
