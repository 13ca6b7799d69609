"""LIGHT OFF by a program that has no devices: to the ports, the rig's state, and what may light."""

from collections.abc import Collection
from concurrent.futures import Future, as_completed
from contextlib import suppress
from pathlib import Path

from processing.errors import RigError
from rig.control import SafetyState, darken_beside, in_thread
from rig.devices.order_line import OrderConnection
from rig.settings import Configuration

_STORED_WITHIN_S = 0.5
"""Longest wait until the press is stored; everything is commanded off before that."""
HEARD_WITHIN_S = 1.5
"""Longest wait for the answers to orders; devices are commanded off before that."""


class LightOff:
    """A press of LIGHT OFF at the place `who`, which is carried out from the beginning of this object on.

    All get the order before any device, session or disk is waited for. "Off" is written to the ports
    directly, because a frozen session takes its order only when it goes on. Meanwhile the press is stored
    beside the rig's state, where every program reads it before it lights: a program that is only starting
    cannot take an order. The sessions of `folders`, and the program that has the rig, are ordered to darken.
    """

    def __init__(self, config: Configuration, rig: SafetyState, who: str, folders: Collection[Path]) -> None:
        self._rig, self._who = rig, who
        self._lamps = config.laser, config.controller
        # in threads, because a port, and the disk of the rig's state, of a trip or of a folder, may hang
        self._ports = in_thread(darken_beside, *self._lamps)
        self._press = None if rig.presses is None else in_thread(rig.presses.press, who)
        absolute = {folder.absolute() for folder in folders}
        self._orders = [in_thread(self._order_dark, folder) for folder in absolute]
        self._orders.append(in_thread(self._holder_dark, absolute))

    def result(self) -> tuple[list[str], bool, bool]:
        """What failed; whether a program has answered; whether the press is kept for those that start.

        "Off" is written to the ports once more, for what began to light before the press was stored.
        """
        problems = self._ports.result()
        if unkept := self._not_kept(self._press):
            problems.append(
                f"it is not kept ({unkept}): a program that starts may light; turn the key switch"
            )
        elif self._press is not None:
            darken_beside(*self._lamps)
        heard = False
        with suppress(TimeoutError):
            for one in as_completed(self._orders, HEARD_WITHIN_S):
                heard = heard or (one.exception() is None and one.result())
        return problems, heard, not unkept

    def _not_kept(self, press: Future[None] | None) -> str:
        """Why the press is not stored beside the rig's state; empty if it is, or without such a place."""
        try:
            if press is not None:
                press.result(_STORED_WITHIN_S)
        except TimeoutError:
            return f"{self._rig.path}: the disk hangs"
        except Exception as error:
            # after any error the laser must still be switched off
            return str(error)
        return ""

    def _order_dark(self, folder: Path) -> bool:
        with suppress(RigError), OrderConnection(folder) as line:
            line.order(f"dark {self._who}")
            return True
        return False

    def _holder_dark(self, ordered: Collection[Path]) -> bool:
        """Order a program that has the rig and works in another folder to darken; True if it answered."""
        folder = self._rig.folder_of_holder
        return folder is not None and folder not in ordered and self._order_dark(folder)
