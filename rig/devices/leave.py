"""Asks a person at the terminal for leave to light again: the number of the trip is typed, then Enter."""

import os
import select
import sys
from contextlib import suppress

from processing.errors import DeviceError
from rig.control import LatchedTrip
from rig.devices.lit_devices import LitDevices
from rig.presentation import say


def at_terminal() -> bool:
    """Whether somebody can be asked there."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def asked_for(trip: LatchedTrip) -> str:
    """What a person is asked before anything is lit."""
    return f"{trip.text}. Look that nobody is in the beam's way, then type {trip.number} and Enter"


def ask_leave(devices: LitDevices) -> None:
    """Where a trip is latched and somebody sits at the terminal, ask until it is acknowledged.

    An empty line, the end of input and Ctrl-C leave it latched: then `Devices.light` refuses.
    """
    while (trip := devices.permit.latched) is not None and at_terminal():
        _forget_what_was_typed()
        try:
            # a program may read standard output
            say(f"{asked_for(trip)}: the laser is lit then (only Enter: it stays dark)")
            answer = input().strip()
        except EOFError:
            return
        if not answer:
            return
        try:
            say(devices.acknowledge(int(answer), "terminal"))
        except ValueError:
            say(f"{answer!r} is not the number of the trip")
        except DeviceError as error:
            say(str(error))


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
        trip = self._devices.permit.latched
        asks = ""
        if alarm:
            asks = "Type light and Enter: the laser is lit again" if trip is None else asked_for(trip)
        if not self.there or asks != self._asked:
            self._asked = asks
            if self.there and asks:
                _forget_what_was_typed()
                say(asks)
            return
        if asks and (typed := _typed_line()):
            self._answer(typed, trip)

    def _answer(self, typed: str, trip: LatchedTrip | None) -> None:
        try:
            if trip is not None and typed == str(trip.number):
                say(self._devices.acknowledge(trip.number, "terminal"))
            elif trip is None and typed == "light":
                say(self._devices.light())
            else:
                say(f"{typed!r}: nothing is done. {self._asked}")
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
