"""Notices a laser that is dark although a run needs its light."""

import contextlib
import time

from acquisition.record.events import EventKind
from processing.errors import RigError
from rig.devices.session_devices import Devices

_DARK_FOR_S = 1.0
"""Shorter darkness is not believed: the last state that the devices reported may be so old."""
_RELIGHT_EVERY_S = 1.0  # as long as the state that is believed may be old


class LightWatch:
    """Watches the laser of a run; without a laser that the program controls it sees no darkness.

    `alarm` says why the laser is dark, and is empty while it is lit. `look` is called by the processing
    thread, `relight` by the main thread, which may wait for a device.
    """

    def __init__(self, devices: Devices | None) -> None:
        self._devices = devices
        self._dark_since_s: float | None = None
        self._relit_s = 0.0
        self.alarm = ""

    def look(self) -> list[tuple[EventKind, str]]:
        """Ask for the state of the laser; returns the events that follow from it, as (kind, text)."""
        why = "" if self._devices is None else self._devices.darkness()
        now_s, since_s = time.monotonic(), self._dark_since_s
        if not why:
            self._dark_since_s = None
            was_alarmed, self.alarm = bool(self.alarm), ""
            if was_alarmed and since_s is not None:
                return [(EventKind.LASER_LIT, f"again after {now_s - since_s:.1f} s of darkness")]
            return []
        if since_s is None:
            self._dark_since_s = now_s
        elif not self.alarm and now_s - since_s >= _DARK_FOR_S:
            self.alarm = f"the laser is dark: {why}"
            return [(EventKind.LASER_DARK, why)]
        return []

    def relight(self) -> None:
        """Switch the laser on again if what darkened it is gone; an interlock must be acknowledged first."""
        devices, now_s = self._devices, time.monotonic()
        if devices is None or not self.alarm or now_s - self._relit_s < _RELIGHT_EVERY_S:
            return
        self._relit_s = now_s
        if not devices.permit.refusal:
            # what still prevents it is in the alarm already
            with contextlib.suppress(RigError):
                devices.light()
