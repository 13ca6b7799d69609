"""Notices that the light of a laser which a run needs is gone, or is confirmed by nothing any more."""

import time
from datetime import datetime, timedelta

from acquisition.record.events import EventKind
from rig.control import Light
from rig.devices.audit import Audited
from rig.devices.session_devices import Devices

_DARK_FOR_S = 1.0
"""Shorter darkness is not believed: the last state that the devices reported may be so old."""
_SAID = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)


class LightWatch:
    """Watches the laser of a run; without a laser that the program controls it sees no darkness.

    `alarm` says why the laser is dark, or what is known of one of which nothing is heard; it is empty while
    it is lit. Nothing here lights it again: a person asks for that (`Devices.light`).
    """

    def __init__(self, devices: Devices | None) -> None:
        self._devices = devices
        self._dark_since_s: float | None = None
        self._said: tuple[Light, float] | None = None
        self._confirmed = False
        self._told = 0
        self.alarm = ""

    def look(self) -> list[tuple[EventKind, str]]:
        """Ask for the state of the laser; returns the events that follow from it, as (kind, text)."""
        return [] if self._devices is None else [*self._trips(self._devices), *self._darkness(self._devices)]

    def _trips(self, devices: Devices) -> list[tuple[EventKind, str]]:
        trip, before = devices.permit.latched, self._told
        self._told = 0 if trip is None else trip.number
        return [] if trip is None or trip.number == before else [(EventKind.TRIP, trip.text)]

    def _darkness(self, devices: Devices) -> list[tuple[EventKind, str]]:
        devices.compare()
        why, laser = devices.darkness(), devices.laser_now()
        if laser is not None and laser.light in _SAID:
            self._said = laser.light, time.monotonic() - laser.age_s
        now_s, since_s = time.monotonic(), self._dark_since_s
        if not why:
            self._dark_since_s = None
            was_alarmed, self.alarm = bool(self.alarm), ""
            if was_alarmed and since_s is not None:
                return [(EventKind.LASER_LIT, f"again after {now_s - since_s:.1f} s")]
            return []
        if since_s is None:
            self._dark_since_s = now_s
            return []
        confirmed = devices.confirmed_dark
        if now_s - since_s < _DARK_FOR_S or (self.alarm and confirmed <= self._confirmed):
            return []
        kind, claim = EventKind.LASER_DARK, "the laser is dark"
        if not confirmed:
            kind, claim = EventKind.LASER_UNKNOWN, "it is not known whether the laser is lit"
            why = "; ".join(filter(None, (why, self._last_said(now_s), devices.without_word)))
        if self.alarm:
            # who was silent speaks again
            devices.audit(Audited.DARK, why)
        else:
            devices.fell_dark(why)
        self.alarm, self._confirmed = f"{claim}: {why}", confirmed
        return [(kind, why)]

    def _last_said(self, now_s: float) -> str:
        if self._said is None:
            return ""
        light, said_s = self._said
        return (
            f"it was last confirmed {light} at {datetime.now() - timedelta(seconds=now_s - said_s):%H:%M:%S}"
        )
