"""Looks whether LIGHT OFF was pressed where no order reaches the program that has the rig."""

import threading
from types import TracebackType
from typing import Self

from rig.devices.lit_devices import LitDevices

_LOOK_S = 0.1
_ENDS_WITHIN_S = 1.0


class PressWatch:
    """A context manager; in a thread of its own: a disk that hangs may delay no command to a device."""

    def __init__(self, devices: LitDevices) -> None:
        self._devices = devices
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, name="presses", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        # what it writes may not come after the next program has the state; a disk that hangs holds nothing up
        self._thread.join(_ENDS_WITHIN_S)
        self._devices.permit.stop_looking()

    def _look(self) -> None:
        while not self._over.wait(_LOOK_S):
            self._devices.hear_presses()
