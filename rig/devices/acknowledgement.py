"""Acknowledgement at the terminal, and the watch over the laser of a run.

A person types the number of the trip, then asks for light again.
"""

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

_LIGHT_QUESTION = "Type light and Enter: the laser is lit again"


def at_terminal() -> bool:
    """Whether a person can be asked at a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask_acknowledgement(devices: LitDevices) -> None:
    """After a trip, ask at the terminal, if there is one, until it is acknowledged and light is asked for.

    After an empty line, the end of input or Ctrl-C, `Devices.light` still refuses.
    """
    while at_terminal() and (question := _next_question(devices)):
        _discard_typing()
        # not with `input`: a program may read standard output
        say(f"{question} (only Enter: it stays dark)")
        answer = sys.stdin.readline().strip()
        if not answer:
            return
        _carry_out(devices, answer)


def _next_question(devices: LitDevices) -> str:
    """The question to a person before anything is lit again; empty without one."""
    if (trip := devices.permit.latched) is not None:
        return f"{trip.text}. Check that nobody is in the beam path, then type {trip.number} and Enter"
    return _LIGHT_QUESTION if devices.permit.needs_request else ""


def _carry_out(devices: LitDevices, answer: str) -> None:
    """Carry out an answer: the number of the trip, or `light`."""
    trip = devices.permit.latched
    try:
        if trip is not None and answer == str(trip.number):
            say(devices.acknowledge(trip.number, "terminal"))
        elif trip is None and answer == "light":
            devices.permit.request_light()
        else:
            say(f"{answer!r}: nothing is done")
    except DeviceError as error:
        say(str(error), error=True)


class TypedAcknowledgement:
    """Answers that a person types at the terminal while a run waits in the dark.

    They are the trip's number, then `light`, each with Enter. `available` is False without a terminal.
    """

    def __init__(self, devices: LitDevices) -> None:
        self._devices = devices
        self._last_question = ""
        self.available = os.name == "posix" and at_terminal()

    def look(self, alarm: str) -> None:
        """Ask once, and carry out the answer.

        `alarm` is the reason why the laser is dark, empty if it is lit. Only the main thread may call this,
        because lighting waits for the devices.
        """
        devices = self._devices
        question = (_next_question(devices) or _LIGHT_QUESTION) if alarm else ""
        if not self.available or question != self._last_question:
            self._last_question = question
            if self.available and question:
                _discard_typing()
                say(question)
            return
        if question and (answer := _read_line()):
            latched = devices.permit.latched
            _carry_out(devices, answer)
            if answer == "light" and latched is None:
                self._light()

    def _light(self) -> None:
        try:
            say(self._devices.light(on_request=True))
        except DeviceError as error:
            say(str(error), error=True)


def _read_line() -> str:
    """A line that was typed and ended by Enter; empty without one. Never blocks."""
    with suppress(OSError, ValueError):
        if select.select([sys.stdin], [], [], 0.0)[0]:
            return os.read(sys.stdin.fileno(), 1024).decode(errors="replace").strip()
    return ""


def _discard_typing() -> None:
    """Discard earlier typing, which is no answer to the question."""
    try:
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    except (ImportError, OSError, ValueError):
        return  # this input is no terminal of a POSIX system


_MIN_DARK_S = 1.0
"""Shortest darkness that is reported, because the last state of the devices may be this old."""
_CONFIRMED_STATES = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)


class LightWatch:
    """Watches the laser of a run; without a laser that the program controls it detects no darkness.

    The laser is lit again only when a person asks for that (`Devices.light`).
    """

    def __init__(self, devices: Devices) -> None:
        self._devices = devices
        self._dark_since_s: float | None = None
        self._last_confirmed: tuple[Light, float] | None = None
        self._is_confirmed = False
        self._reported_trip = 0
        self.alarm = ""
        """The reason why the laser is dark, or what is known of one that does not answer; empty while lit."""

    def look(self) -> list[tuple[EventKind, str]]:
        """Events that follow from the state of the laser now, as (kind, text)."""
        return [*self._trips(), *self._darkness()]

    def _trips(self) -> list[tuple[EventKind, str]]:
        trip, earlier_number = self._devices.permit.latched, self._reported_trip
        self._reported_trip = 0 if trip is None else trip.number
        return [] if trip is None or trip.number == earlier_number else [(EventKind.TRIP, trip.text)]

    def _darkness(self) -> list[tuple[EventKind, str]]:
        devices = self._devices
        devices.compare()
        reason, laser = devices.darkness(), devices.laser_report()
        if laser is not None and laser.light in _CONFIRMED_STATES:
            self._last_confirmed = laser.light, time.monotonic() - laser.age_s
        now_s, since_s = time.monotonic(), self._dark_since_s
        if not reason:
            self._dark_since_s = None
            was_alarmed, self.alarm = bool(self.alarm), ""
            if was_alarmed and since_s is not None:
                return [(EventKind.LASER_LIT, f"again after {now_s - since_s:.1f} s")]
            return []
        if since_s is None:
            self._dark_since_s = now_s
            return []
        confirmed = devices.confirmed_dark
        if now_s - since_s < _MIN_DARK_S or (self.alarm and confirmed <= self._is_confirmed):
            return []
        kind, claim = EventKind.LASER_DARK, "the laser is dark"
        if not confirmed:
            kind, claim = EventKind.LASER_UNKNOWN, "it is not known whether the laser is lit"
            facts = (reason, self._last_confirmed_text(now_s), devices.silence_consequence)
            reason = "; ".join(filter(None, facts))
        if self.alarm:
            # the device that was silent answers again
            devices.audit(AuditEntry.DARK, reason)
        else:
            devices.note_unexpected_dark(reason)
        self.alarm, self._is_confirmed = f"{claim}: {reason}", confirmed
        return [(kind, reason)]

    def _last_confirmed_text(self, now_s: float) -> str:
        if self._last_confirmed is None:
            return ""
        light, confirmed_s = self._last_confirmed
        time_of_day = datetime.now() - timedelta(seconds=now_s - confirmed_s)
        return f"it was last confirmed {light} at {time_of_day:%H:%M:%S}"
