"""The interface of all laser drivers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from processing.errors import DeviceError

ON_WITHIN_S = 10.0
"""Longest time from the command to emission, including the delay that a laser's safety class requires."""


class LaserRefused(DeviceError):
    """The laser did not execute a command: it answered with an error, or another value was read back."""


@dataclass(frozen=True, slots=True)
class LaserIdentity:
    """Vendor, model and serial number."""

    vendor: str
    model: str
    serial: str


@dataclass(frozen=True, slots=True)
class LaserState:
    """State read from the laser; None for values that this family does not report.

    `power_w` is the measured optical power, `current_a` the measured diode current; `fault` is empty if there
    is none. `excess` says why the laser must be dark although it was set as allowed: more light or current
    is measured, or something else than this program can change it; empty if it need not.
    """

    on: bool
    interlock_closed: bool
    power_w: float | None = None
    current_a: float | None = None
    fault: str = ""
    excess: str = ""


def never() -> str:
    """Nothing refuses the light."""
    return ""


class Laser(Protocol):
    """A laser, or the driver of a laser diode.

    Life cycle: ``open`` -> (``set_power_w`` or ``set_current_a``, ``enable``, ``state``, ``off``) any number
    of times -> ``close``. ``open`` switches the emission off, writes the configured limit into the device
    if it has one, and sets or refuses what else could change the light; ``close`` switches the emission off
    and may be called in any state. Only one thread may call them. Each blocks for at most a few timeouts
    (``enable`` for the delay of the safety class) and raises DeviceError with one line.
    """

    def open(self) -> LaserIdentity:
        """Open the port, check the family, switch the emission off, write the limits into the device."""
        ...

    def identify(self) -> LaserIdentity:
        """Read vendor, model and serial number."""
        ...

    def set_power_w(self, power_w: float) -> None:
        """Set the optical power.

        Raises PowerLimit above max_power_w, LaserRefused for a family that is set in amperes.
        """
        ...

    def set_current_a(self, current_a: float) -> None:
        """Set the diode current.

        Raises PowerLimit above max_current_a, LaserRefused for a family that is set in watts.
        """
        ...

    def enable(self, refusal: Callable[[], str] = never) -> None:
        """Switch on. Raises InterlockOpen if the interlock is open, LaserRefused if the laser does not
        emit, or as soon as `refusal` says why it must not.
        """
        ...

    def off(self) -> None:
        """Switch off and check the state."""
        ...

    def state(self) -> LaserState:
        """Read the laser's state."""
        ...

    def close(self) -> None:
        """Switch off (a failure is logged) and close the port. Raises nothing."""
        ...
