"""Base class of the serial laser drivers: query and reply, limits, safe order of switching."""

import contextlib
import logging
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from processing.errors import DeviceError
from rig.control.controller import InterlockOpen, PowerLimit
from rig.control.lasers.laser import ON_WITHIN_S, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.settings import LaserSettings
from rig.control.link import ReplyTimeout
from rig.control.serial_port import Line, LineReader, PortLost, SerialPort

_log = logging.getLogger(__name__)
_RETRIES = 2
_POLL_S = 0.1


class SerialLaser(ABC):
    """A `Laser` over a serial line; a subclass defines how its family asks, sets and reads.

    Limits are kept here, before anything is sent, and in the device too where it has a limit of its own.
    """

    terminator = b"\n"
    unit = "w"
    step = 1e-6
    """Resolution of the device in its unit; a value that is less by so much counts as set."""

    def __init__(self, settings: LaserSettings, open_line: Callable[[], Line] | None = None) -> None:
        self._settings = settings
        self._open_line = open_line or (lambda: SerialPort(settings.port, settings.baud, write_timeout_s=1.0))
        self._line: Line | None = None
        self._reader: LineReader | None = None

    # -- defined by each family ------------------------------------------------

    @abstractmethod
    def identify(self) -> LaserIdentity:
        """Read vendor, model and serial number; raises DeviceError where it is of another family."""

    @abstractmethod
    def state(self) -> LaserState:
        """Read the laser's state."""

    @abstractmethod
    def _prepare(self) -> None:
        """After the light is off: modes, limits."""

    @abstractmethod
    def _switch(self, on: bool) -> None:
        """Turn the light on or off."""

    @abstractmethod
    def _set(self, value: float) -> float:
        """Set power or current in W or A; return the value read back from the device."""

    # -- Laser ----------------------------------------------------------------

    def open(self) -> LaserIdentity:
        """Open the port, check the family, light off, write the limits into the device."""
        self.close()
        self._line = self._open_line()
        self._reader = LineReader(self._line)
        try:
            self._reader.clear()
            identity = self.identify()
            self.off()
            self._prepare()
        except BaseException:
            self._give_back()
            raise
        return identity

    def set_power_w(self, power_w: float) -> None:
        """Set the optical power; raises PowerLimit above max_power_w."""
        if self.unit != "w":
            raise LaserRefused(
                f"{self.name}: this driver sets current_a, not power_w; change the configuration"
            )
        self._set_within(power_w, self._settings.max_power_w, "max_power_w")

    def set_current_a(self, current_a: float) -> None:
        """Set the diode current; raises PowerLimit above max_current_a."""
        if self.unit != "a":
            raise LaserRefused(
                f"{self.name}: this laser sets power_w, not current_a; change the configuration"
            )
        self._set_within(current_a, self._settings.max_current_a, "max_current_a")

    def enable(self) -> None:
        """Light on, interlock permitting; read back that it is on."""
        state = self.state()
        if not state.interlock_closed:
            raise InterlockOpen(
                f"{self.name}: the interlock is open, the laser stays dark; close the cover or door"
            )
        if state.fault:
            raise LaserRefused(
                f"{self.name}: the laser reports {state.fault!r} and was not lit; clear the fault"
            )
        self._switch(True)
        # Some families light only after a delay that their safety class demands.
        deadline_s = time.monotonic() + ON_WITHIN_S
        while not self.state().on:
            if time.monotonic() > deadline_s:
                self._switch(False)
                raise LaserRefused(
                    f"{self.name}: told to light, still dark after {ON_WITHIN_S:g} s; see its panel"
                )
            time.sleep(_POLL_S)

    def off(self) -> None:
        """Light off, read back."""
        self._switch(False)
        if self.state().on:
            raise LaserRefused(f"{self.name}: told to go dark, still lit; open the interlock by hand")

    def close(self) -> None:
        """Light off, repeated where it is not confirmed; release the port."""
        if self._line is None:
            return
        try:
            self._off_at_last()
        except DeviceError as error:
            _log.error("%s: it is not sure that it is dark (%s); switch it off by hand", self.name, error)
        finally:
            self._give_back()

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"{self._settings.kind} laser on {self._settings.port}"

    def _off_at_last(self) -> None:
        for _ in range(_RETRIES):
            with contextlib.suppress(LaserRefused, ReplyTimeout):
                self.off()
                return
        self.off()

    # -- for the families -----------------------------------------------------

    def ask(self, command: str) -> str:
        """Send a question and return the line that answers it; asks again after silence."""
        line, reader = self._claimed()
        for _ in range(_RETRIES + 1):
            # An answer that came too late for an earlier question must not answer this one.
            reader.clear()
            line.write(command.encode("ascii") + self.terminator)
            answer = reader.read_line(time.monotonic() + self._settings.timeout_s)
            if answer is not None:
                return answer.decode("latin-1").strip()
        raise ReplyTimeout(
            f"{self.name}: no reply to {command} within {self._settings.timeout_s:g} s,"
            f" asked {_RETRIES + 1} times; check port, baud rate and cable"
        )

    def ask_float(self, command: str) -> float:
        """A question whose answer is a number."""
        answer = self.ask(command)
        try:
            return float(answer)
        except ValueError:
            raise LaserRefused(
                f"{self.name}: answered {answer!r} to {command} where a number was due"
            ) from None

    def tell(self, command: str) -> None:
        """Send a command that this family does not answer."""
        line, _ = self._claimed()
        line.write(command.encode("ascii") + self.terminator)

    def _set_within(self, value: float, limit: float, limit_name: str) -> None:
        # Written so that NaN is rejected too.
        if not 0.0 <= value <= limit:
            raise PowerLimit(
                f"{self.name}: {value:g} {self.unit.upper()} was asked for;"
                f" 0 to {limit:g} is allowed by {limit_name}"
            )
        applied = self._set(value)
        if not math.isclose(applied, value, rel_tol=0.02, abs_tol=1.001 * self.step):
            self._switch(False)
            raise LaserRefused(
                f"{self.name}: told {value:g} {self.unit.upper()}, set {applied:g}; it was turned off"
            )

    def _claimed(self) -> tuple[Line, LineReader]:
        if self._line is None or self._reader is None:
            raise PortLost(f"{self.name}: the laser is not open")
        return self._line, self._reader

    def _give_back(self) -> None:
        line, self._line, self._reader = self._line, None, None
        if line is not None:
            with contextlib.suppress(PortLost):
                line.close()


def rounded_down(value: float, digits: int) -> str:
    """Fixed-point text, rounded down so that a limit is never exceeded (but for binary rounding)."""
    scale = 10**digits
    return f"{math.floor(value * scale + 1e-6) / scale:.{digits}f}"
