"""Asks a device whether the laser is off, until it says so or has had time to."""

import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future

from processing.errors import DeviceError
from rig.control import ControllerReset
from rig.devices.laser import wait_for_command

_ASK_AGAIN_S = 0.1
_LAST_WAIT_S = 0.2


def confirmed_dark(
    off: Callable[[], "Future[None]"], command: "Future[None]", end_s: float
) -> tuple[str, KeyboardInterrupt | None]:
    """Ask until it is confirmed that the laser is off, or the time is over; why it is not, empty if it is.

    A late answer is waited for, and a port that is being opened again. A controller that has no session is
    dark by definition. Ctrl-C ends no wait that ends soon by itself: it is returned.
    """
    interrupt: KeyboardInterrupt | None = None
    no_session = False
    while True:
        try:
            wait_for_command(command, max(end_s - time.monotonic(), _LAST_WAIT_S))
            return "", interrupt
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
            if time.monotonic() < end_s:
                continue
            why = "interrupted"
        except (DeviceError, CancelledError) as error:
            why = str(error) or "its thread has ended"
            no_session = no_session or isinstance(error, ControllerReset)
        if time.monotonic() > end_s - _ASK_AGAIN_S:
            return "" if no_session else why, interrupt
        try:
            time.sleep(_ASK_AGAIN_S)
        except KeyboardInterrupt as error:
            interrupt = interrupt or error
        if command.done():
            command = off()
