"""LIGHT OFF by a program that has no devices: to the ports, the rig's state, and programs that may light."""

from collections.abc import Collection
from concurrent.futures import as_completed
from contextlib import suppress
from pathlib import Path

from processing.errors import RigError
from rig.control import SafetyState, darken_directly, run_in_thread
from rig.devices.order_line import OrderConnection
from rig.settings import Configuration

_MAX_STORE_S = 0.5
"""Longest wait until the press is stored; everything is commanded off before that."""
MAX_ANSWER_S = 1.5
"""Longest wait for the answers to orders; devices are commanded off before that."""


class LightOff:
    """A press of LIGHT OFF, which is carried out from the construction of this object on.

    Ports, sessions and the rig's state get the order before any of them is waited for. "Off" is written to
    the ports directly, because a frozen session takes its order only when it goes on. Meanwhile the press is
    stored beside the rig's state, where every program reads it before it lights: a program that is only
    starting cannot take an order. The sessions of `folders`, and the program that has the rig, are ordered to
    switch off. `place` names where the button was pressed.
    """

    def __init__(
        self, config: Configuration, rig: SafetyState, place: str, folders: Collection[Path]
    ) -> None:
        self._rig, self._place = rig, place
        self._settings = config.laser, config.controller
        # in threads, because a port, and the disk of the rig's state, of a trip or of a folder, may hang
        self._port_writes = run_in_thread(darken_directly, *self._settings)
        self._press = None if rig.presses is None else run_in_thread(rig.presses.press, place)
        absolute = {folder.absolute() for folder in folders}
        self._orders = [run_in_thread(self._order_session_off, folder) for folder in absolute]
        self._orders.append(run_in_thread(self._order_holder_off, absolute))

    def result(self) -> tuple[list[str], bool, bool]:
        """Problems, whether a program has answered, and whether the press is stored for programs that start.

        "Off" is written to the ports once more, for what began to light before the press was stored.
        """
        problems = self._port_writes.result()
        if storage_problem := self._storage_problem():
            problems.append(
                f"it is not kept ({storage_problem}): a program that starts may light; turn the key switch"
            )
        elif self._press is not None:
            darken_directly(*self._settings)
        answered = False
        with suppress(TimeoutError):
            for order in as_completed(self._orders, MAX_ANSWER_S):
                answered = answered or (order.exception() is None and order.result())
        return problems, answered, not storage_problem

    def _storage_problem(self) -> str:
        """Why the press is not stored beside the rig's state; empty if it is, or if there is no state."""
        try:
            if self._press is not None:
                self._press.result(_MAX_STORE_S)
        except TimeoutError:
            return f"{self._rig.path}: the disk hangs"
        except Exception as error:
            # after any error the laser must still be switched off
            return str(error)
        return ""

    def _order_session_off(self, folder: Path) -> bool:
        with suppress(RigError), OrderConnection(folder) as line:
            line.order(f"dark {self._place}")
            return True
        return False

    def _order_holder_off(self, folders: Collection[Path]) -> bool:
        """Order a program that has the rig and works in another folder to switch off; True if it answered."""
        folder = self._rig.holder_folder
        return folder is not None and folder not in folders and self._order_session_off(folder)
