"""Synchronous driver of the rig controller; `service.ControlService` calls it from a thread."""

import contextlib
import math
import secrets
from collections.abc import Callable

from processing.errors import DeviceError
from rig.control.protocol import (
    AmbientReading,
    BoardEvent,
    ControllerIdentity,
    ControllerReset,
    ControllerStatus,
    Latch,
    Link,
    floats_of,
    status_of,
)
from rig.control.serial_port import PortLost, ReplyTimeout, SerialLine, SerialPort
from rig.control.settings import ControllerSettings

_MAKER = "optical-pendulum-rig"
FIRMWARE = "1.4"
"""Version of the firmware whose protocol this driver speaks: `VERSION` of firmware/core.py."""
_OTHER_BOARDS = (
    "the board must be a Raspberry Pi Pico, or one like it, with this program's firmware "
    "(docs/controller.md, Flashing); with another, such as an Arduino, set controller.kind = 'none' and "
    "laser.kind = 'none', and switch by hand"
)


class InterlockOpen(DeviceError):
    """The interlock loop is open; the laser stays off."""


class PowerLimit(DeviceError):
    """The requested laser power exceeds a limit."""


class Controller:
    """The rig controller, real or simulated, at the other end of a `SerialLine`.

    `open_line` is called at each `open`, so that a controller that was unplugged can be opened again. Each
    method blocks for at most (retries + 1) timeouts and raises a DeviceError: `PortLost`, `ReplyTimeout`,
    `ControllerReset`, `CommandRefused`, `InterlockOpen` or `PowerLimit`. Only one thread may call them.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        laser_max_w: float,
        open_line: Callable[[], SerialLine] | None = None,
    ) -> None:
        self._settings = settings
        self._laser_max_w = laser_max_w
        self._open_line = open_line or (lambda: SerialPort(settings.port, settings.baud))
        self._line: SerialLine | None = None
        self._link: Link | None = None
        self._limit_w = 0.0
        self.earlier_latch: Latch | None = None
        """Trip that was latched on the board before this session; None without one."""

    def open(self) -> ControllerIdentity:
        """Open the line, check that a rig controller answers, and begin a session with every output off.

        Raises DeviceError if the port is missing or another device answers.
        """
        self.close()
        line = self._open_line()
        try:
            link = Link(line, self._settings.timeout_s, self._settings.retries)
            try:
                identity = self._begin(link)
            except ControllerReset:
                # a board that has just been plugged in sends BOOT, after which it is ready
                identity = self._begin(link)
        except BaseException:
            with contextlib.suppress(PortLost):
                line.close()
            raise
        self._line, self._link = line, link
        return identity

    def _begin(self, link: Link) -> ControllerIdentity:
        link.begin()
        try:
            identity = link.ask("*IDN?")
        except ReplyTimeout:
            raise ReplyTimeout(
                f"{link.name}: no rig controller answers ({link.received_text}); "
                f"check port, cable and baud rate; {_OTHER_BOARDS}"
            ) from None
        maker, _, serial, firmware = (identity.split(",") + [""] * 4)[:4]
        if maker != _MAKER:
            raise DeviceError(
                f"{link.name}: {identity!r} answers there, not the rig controller; check the port; "
                f"{_OTHER_BOARDS}"
            )
        if firmware != FIRMWARE:
            raise DeviceError(
                f"{link.name}: the controller's firmware is {firmware}, {FIRMWARE} is needed; flash the one "
                "that came with this version (docs/controller.md, Flashing)"
            )
        self.earlier_latch = status_of(link.ask("SYST:STAT?")).latch
        token = secrets.token_hex(8).upper()
        (stored_w,) = floats_of(link.ask(f"SYST:SESS {token},{round(self._settings.watchdog_s * 1000)}"), 1)
        self._limit_w = min(stored_w, self._laser_max_w)
        link.ask(f"LAS:POW:LIM {_floor_w(self._limit_w)}")
        return ControllerIdentity(serial, firmware, stored_w)

    def close(self) -> None:
        """End the session, which puts every output into its safe state, and close the port.

        A lost controller is not an error here, because its own watchdog has done the same.
        """
        line, link, self._line, self._link = self._line, self._link, None, None
        if line is None or link is None:
            return
        link.repeat_until_s = math.inf
        try:
            with contextlib.suppress(DeviceError):
                link.ask("SYST:SESS:END")
        finally:
            with contextlib.suppress(PortLost):
                line.close()

    def repeat_until(self, deadline_s: float) -> None:
        """Set the time (`time.monotonic`) after which no command is repeated, until the next `open`."""
        if self._link is not None:
            self._link.repeat_until_s = deadline_s

    def heartbeat(self) -> ControllerStatus:
        """Restart the board's watchdog time; returns the board's state."""
        return status_of(self._ask("SYST:HEAR?"))

    def status(self) -> ControllerStatus:
        """The board's state, without restarting its watchdog time."""
        return status_of(self._ask("SYST:STAT?"))

    def acknowledge(self, number: int) -> None:
        """Clear the board's latch of this number, which a person has acknowledged.

        Raises `CommandRefused` for another number, or while its cause persists.
        """
        self._ask(f"SYST:TRIP:ACK {number}")

    def environment(self) -> AmbientReading:
        """Reading of the controller's own sensor; NaN without a sensor, and for impossible values."""
        return AmbientReading(*floats_of(self._ask("ENV?"), 3)).possible

    def set_laser_power_w(self, power_w: float) -> None:
        """Set the power; raises PowerLimit above the configured or the stored limit."""
        if not 0.0 <= power_w <= self._limit_w:
            raise PowerLimit(
                f"{self.name}: a laser power of {power_w:g} W was asked for;"
                f" 0 to {self._limit_w:g} W is allowed by max_power_w and the controller's own limit"
            )
        self._ask(f"LAS:POW {_floor_w(power_w)}")

    def set_laser_pulse(self, delay_us: float, width_us: float) -> None:
        """Set the pulse of light in each exposure, by its delay after the exposure's beginning and its width.

        Raises `CommandRefused` while the laser is on. A new session begins without pulses.
        """
        self._ask(f"LAS:PULS {delay_us:.7g},{width_us:.7g}")

    def laser_on(self) -> None:
        """Switch the laser on. Reads the interlock first and raises InterlockOpen if it is open."""
        if not self.interlock_closed():
            raise InterlockOpen(
                f"{self.name}: the interlock is open, the laser stays off; close the cover or door"
            )
        self._ask("LAS:STAT ON")

    def laser_off(self) -> None:
        """Switch the laser off."""
        self._ask("LAS:STAT OFF")

    def interlock_closed(self) -> bool:
        """Read whether the interlock loop is closed."""
        return self._ask("INT?") == "CLOSED"

    def hold(self) -> None:
        """Energise the magnet that holds the deflected pendulum."""
        self._ask("MAGN ON")

    def release(self) -> None:
        """De-energise the magnet, so that the pendulum starts; raises `CommandRefused` if it is not on."""
        self._ask("MAGN:REL")

    def starter_pulse(self, duration_s: float) -> None:
        """Tilt the pendulum by the starter for duration_s; the board ends the pulse itself."""
        if not 0.001 <= duration_s <= self._settings.starter_max_s:
            raise DeviceError(
                f"{self.name}: a starter pulse of {duration_s:g} s was asked for;"
                f" 0.001 to {self._settings.starter_max_s:g} s is allowed by starter_max_s"
            )
        self._ask(f"STAR:PULS {round(duration_s * 1000)}")

    def clamp(self, closed: bool) -> None:
        """Close or open the clamp."""
        self._ask(f"CLAM {'ON' if closed else 'OFF'}")

    def brake(self, on: bool) -> None:
        """Apply or release the brake; the board releases it itself after its longest time."""
        self._ask(f"BRAK {'ON' if on else 'OFF'}")

    def next_error(self) -> tuple[int, str]:
        """Oldest entry of the board's error queue, (0, "No error") when it is empty."""
        reply = self._ask("SYST:ERR?")
        code, _, text = reply.partition(",")
        try:
            return int(code), text.strip('"')
        except ValueError:
            raise DeviceError(
                f"the controller answered {reply!r}, which is not an error's number and text"
            ) from None

    def take_events(self) -> tuple[BoardEvent, ...]:
        """Unsolicited messages of the board (TRIP, BOOT) since the last call."""
        return self._link.take_events() if self._link else ()

    @property
    def name(self) -> str:
        """Name of the controller in messages."""
        return self._line.name if self._line else self._settings.port or f"{self._settings.kind} controller"

    def _ask(self, command: str) -> str:
        if self._link is None:
            raise PortLost(f"{self.name}: the controller is not open")
        return self._link.ask(command)


def _floor_w(power_w: float) -> str:
    """A power with seven digits, the board's single precision, rounded down so that no limit is exceeded."""
    text = f"{power_w:.7g}"
    return text if float(text) <= power_w else f"{power_w * (1 - 1e-6):.7g}"
