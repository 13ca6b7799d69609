"""Asks a person at the terminal for leave to light again: the number of the trip is typed, then Enter."""

import os
import select
import sys
from contextlib import suppress

from processing.errors import DeviceError
from rig.devices.lit_devices import LitDevices
from rig.presentation import say

_ASKS_LIGHT = "Type light and Enter: the laser is lit again"


def at_terminal() -> bool:
    """Whether somebody can be asked there."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask_leave(devices: LitDevices) -> None:
    """After a trip, and if somebody sits at the terminal, ask until it is acknowledged and light asked for.

    An empty line, the end of input and Ctrl-C change nothing: then `Devices.light` refuses.
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
    """What a person is asked before anything is lit again; empty if nothing."""
    if (trip := devices.permit.latched) is not None:
        return f"{trip.text}. Check that nobody is in the beam path, then type {trip.number} and Enter"
    return _ASKS_LIGHT if devices.waits_for_asking else ""


def _answer(devices: LitDevices, typed: str) -> None:
    """Do what a person has typed: the number of the trip, or `light`."""
    trip = devices.permit.latched
    try:
        if trip is not None and typed == str(trip.number):
            say(devices.acknowledge(trip.number, "terminal"))
        elif trip is None and typed == "light":
            devices.ask_for_light()
        else:
            say(f"{typed!r}: nothing is done")
    except DeviceError as error:
        say(str(error), error=True)


class TypedLeave:
    """While a run waits in the dark: what a person types at the terminal, in whole lines.

    First the trip's number, then `light`; each with Enter. `there` is False where nobody can type.
    """

    def __init__(self, devices: LitDevices) -> None:
        self._devices = devices
        self._asked = ""
        self.there = os.name == "posix" and at_terminal()

    def look(self, alarm: str) -> None:
        """Ask, once, and do what was answered; `alarm` is why the laser is dark, empty if it is lit.

        To be called by the main thread: lighting waits for the devices.
        """
        devices = self._devices
        asks = (_what_to_ask(devices) or _ASKS_LIGHT) if alarm else ""
        if not self.there or asks != self._asked:
            self._asked = asks
            if self.there and asks:
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
            say(self._devices.light(asked=True))
        except DeviceError as error:
            say(str(error), error=True)


def _typed_line() -> str:
    """A line that was typed and ended by Enter; empty if there is none. Never blocks."""
    with suppress(OSError, ValueError):
        if select.select([sys.stdin], [], [], 0.0)[0]:
            return os.read(sys.stdin.fileno(), 1024).decode(errors="replace").strip()
    return ""


def _forget_what_was_typed() -> None:
    """What was typed before the question is no answer to it."""
    try:
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    except (ImportError, OSError, ValueError):
        # no such terminal
        return
