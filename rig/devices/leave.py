"""Asks a person at the terminal for leave to light again: the number of the trip is typed, then Enter."""

import sys

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
            answer = input(f"{asked_for(trip)}: the laser is lit then (only Enter: it stays dark) ").strip()
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


def _forget_what_was_typed() -> None:
    """What was typed before the question is no answer to it."""
    try:
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    except (ImportError, OSError, ValueError):
        # no such terminal
        return
