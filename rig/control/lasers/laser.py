"""The interface of all laser drivers."""

from dataclasses import dataclass
from typing import Protocol

from processing.errors import DeviceError

ON_WITHIN_S = 10.0
"""Longest time from the command to light, with the delay that a laser's safety class demands."""


class LaserRefused(DeviceError):
    """The laser did not carry out a command: it answered an error, or read back another value."""


@dataclass(frozen=True, slots=True)
class LaserIdentity:
    """Vendor, model and serial number."""

    vendor: str
    model: str
    serial: str


@dataclass(frozen=True, slots=True)
class LaserState:
    """State read from the laser; None for values that this family does not report.

    `power_w` is measured light, `current_a` measured diode current; `fault` is empty when all is well.
    """

    on: bool
    interlock_closed: bool
    power_w: float | None = None
    current_a: float | None = None
    fault: str = ""


class Laser(Protocol):
    """A laser, or the driver of a laser diode.

    Life cycle: ``open`` -> (``set_power_w`` or ``set_current_a``, ``enable``, ``state``, ``off``)
    any number of times -> ``close``. ``open`` leaves the light off and puts the configured limit
    into the device where it has one; ``close`` turns the light off and may be called from any
    state. One thread calls them; each blocks for at most a few timeouts (``enable`` for the
    delay that a safety class demands) and raises DeviceError with one line.
    """

    def open(self) -> LaserIdentity:
        """Open the port, check the family, light off, write the limits into the device."""
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

    def enable(self) -> None:
        """Switch on: reads the interlock first (InterlockOpen), then reads back the state (LaserRefused)."""
        ...

    def off(self) -> None:
        """Light off, read back."""
        ...

    def state(self) -> LaserState:
        """Read the laser's state."""
        ...

    def close(self) -> None:
        """Light off (a failure is logged), then release the port. Raises nothing."""
        ...
