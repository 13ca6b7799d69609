"""Notices a laser that is dark although a run needs its light."""

import time

from acquisition.record.events import EventKind
from rig.devices.session_devices import Devices

_DARK_FOR_S = 1.0
"""Shorter darkness is not believed: the last state that the devices reported may be so old."""


class LightWatch:
    """Watches the laser of a run; without a laser that the program controls it sees no darkness.

    `alarm` says why the laser is dark, and is empty while it is lit. Nothing here lights it again: a person
    asks for that (`Devices.light`).
    """

    def __init__(self, devices: Devices | None) -> None:
        self._devices = devices
        self._dark_since_s: float | None = None
        self._told = 0
        self.alarm = ""

    def look(self) -> list[tuple[EventKind, str]]:
        """Ask for the state of the laser; returns the events that follow from it, as (kind, text)."""
        return [*self._trips(), *self._darkness()]

    def _trips(self) -> list[tuple[EventKind, str]]:
        trip = None if self._devices is None else self._devices.permit.latched
        number, before = 0 if trip is None else trip.number, self._told
        self._told = number
        return [] if trip is None or number == before else [(EventKind.TRIP, trip.text)]

    def _darkness(self) -> list[tuple[EventKind, str]]:
        why = ""
        if self._devices is not None:
            self._devices.compare()
            why = self._devices.darkness()
        now_s, since_s = time.monotonic(), self._dark_since_s
        if not why:
            self._dark_since_s = None
            was_alarmed, self.alarm = bool(self.alarm), ""
            if was_alarmed and since_s is not None:
                return [(EventKind.LASER_LIT, f"again after {now_s - since_s:.1f} s of darkness")]
            return []
        if since_s is None:
            self._dark_since_s = now_s
        elif self._devices is not None and not self.alarm and now_s - since_s >= _DARK_FOR_S:
            self.alarm = f"the laser is dark: {why}"
            self._devices.fell_dark(why)
            return [(EventKind.LASER_DARK, why)]
        return []
