"""Acknowledgement at the terminal: a person types the number of the trip, then asks for light again."""

import os
import select
import sys
import time
from contextlib import suppress
from datetime import datetime, timedelta

from acquisition.record.events import EventKind
from processing.errors import DeviceError
from rig.control import Light
from rig.devices.audit import AuditEntry
from rig.devices.lit_devices import LitDevices
from rig.devices.session_devices import Devices
from rig.terminal import say

_ASKS_LIGHT = "Type light and Enter: the laser is lit again"


def at_terminal() -> bool:
    """Whether a person can be asked at a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask_acknowledgement(devices: LitDevices) -> None:
    """After a trip, ask at the terminal, if there is one, until it is acknowledged and light is asked for.

    An empty line, the end of input and Ctrl-C change nothing, so that `Devices.light` refuses.
    """
    while at_terminal() and (asks := _what_to_ask(devices)):
        _forget_what_was_typed()
        # not with `input`: a program may read standard output
        say(f"{asks} (only Enter: it stays dark)")
        typed = sys.stdin.readline().strip()
        if not typed:
            return
        _answer(devices, typed)


def _what_to_ask(devices: LitDevices) -> str:
    """The question to a person before anything is lit again; empty if none is needed."""
    if (trip := devices.permit.latched) is not None:
        return f"{trip.text}. Check that nobody is in the beam path, then type {trip.number} and Enter"
    return _ASKS_LIGHT if devices.permit.needs_request else ""


def _answer(devices: LitDevices, typed: str) -> None:
    """Carry out a typed answer: the number of the trip, or `light`."""
    trip = devices.permit.latched
    try:
        if trip is not None and typed == str(trip.number):
            say(devices.acknowledge(trip.number, "terminal"))
        elif trip is None and typed == "light":
            devices.permit.request_light()
        else:
            say(f"{typed!r}: nothing is done")
    except DeviceError as error:
        say(str(error), error=True)


class TypedAcknowledgement:
    """Answers that a person types at the terminal while a run waits in the dark.

    First the trip's number, then `light`; each with Enter. `available` is False without a terminal.
    """

    def __init__(self, devices: LitDevices) -> None:
        self._devices = devices
        self._asked = ""
        self.available = os.name == "posix" and at_terminal()

    def look(self, alarm: str) -> None:
        """Ask once, and carry out the answer; `alarm` is why the laser is dark, empty if it is lit.

        Only the main thread may call it, because lighting waits for the devices.
        """
        devices = self._devices
        asks = (_what_to_ask(devices) or _ASKS_LIGHT) if alarm else ""
        if not self.available or asks != self._asked:
            self._asked = asks
            if self.available and asks:
                _forget_what_was_typed()
                say(asks)
            return
        if asks and (typed := _typed_line()):
            latched = devices.permit.latched
            _answer(devices, typed)
            if typed == "light" and latched is None:
                self._light()

    def _light(self) -> None:
        try:
            say(self._devices.light(on_request=True))
        except DeviceError as error:
            say(str(error), error=True)


def _typed_line() -> str:
    """A line that was typed and ended by Enter; empty if there is none. Never blocks."""
    with suppress(OSError, ValueError):
        if select.select([sys.stdin], [], [], 0.0)[0]:
            return os.read(sys.stdin.fileno(), 1024).decode(errors="replace").strip()
    return ""


def _forget_what_was_typed() -> None:
    """Discard earlier typing, which is no answer to the question."""
    try:
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    except (ImportError, OSError, ValueError):
        # no such terminal
        return


_DARK_FOR_S = 1.0
"""Shortest darkness that is reported, because the last state of the devices may be this old."""
_SAID = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)


class LightWatch:
    """Watches the laser of a run; without a laser that the program controls it detects no darkness.

    `alarm` states why the laser is dark, or what is known of a laser that does not answer; it is empty while
    the laser is lit. This class never lights it again: a person asks for that (`Devices.light`).
    """

    def __init__(self, devices: Devices) -> None:
        self._devices = devices
        self._dark_since_s: float | None = None
        self._said: tuple[Light, float] | None = None
        self._confirmed = False
        self._told = 0
        self.alarm = ""

    def look(self) -> list[tuple[EventKind, str]]:
        """Read the state of the laser; returns the events that follow from it, as (kind, text)."""
        return [*self._trips(), *self._darkness()]

    def _trips(self) -> list[tuple[EventKind, str]]:
        trip, before = self._devices.permit.latched, self._told
        self._told = 0 if trip is None else trip.number
        return [] if trip is None or trip.number == before else [(EventKind.TRIP, trip.text)]

    def _darkness(self) -> list[tuple[EventKind, str]]:
        devices = self._devices
        devices.compare()
        why, laser = devices.darkness(), devices.laser_report()
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
            why = "; ".join(filter(None, (why, self._last_said(now_s), devices.silence_consequence)))
        if self.alarm:
            # the device that was silent answers again
            devices.audit(AuditEntry.DARK, why)
        else:
            devices.note_unexpected_dark(why)
        self.alarm, self._confirmed = f"{claim}: {why}", confirmed
        return [(kind, why)]

    def _last_said(self, now_s: float) -> str:
        if self._said is None:
            return ""
        light, said_s = self._said
        return (
            f"it was last confirmed {light} at {datetime.now() - timedelta(seconds=now_s - said_s):%H:%M:%S}"
        )
