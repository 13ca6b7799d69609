"""Base class of the laser drivers: states, queries and answers, limits, safe order of switching."""

import contextlib
import logging
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, final

from processing.errors import DeviceError
from rig.control.controller import InterlockOpen, PowerLimit
from rig.control.lasers.settings import LaserSettings
from rig.control.serial_port import LineReader, PortLost, ReplyTimeout, SerialLine, SerialPort

ON_WITHIN_S = 10.0
"""Longest time from the command to emission, including the delay that a laser's safety class requires."""
_log = logging.getLogger(__name__)
_MAX_RETRIES = 2
_POLL_INTERVAL_S = 0.1
_MAX_METER_RATIO = 1.05
"""Largest ratio of a measured power or current to its limit; such meters err by some per cent."""
_METER_OFFSET_W, _METER_OFFSET_A = 1e-5, 1e-3
"""Readings of these meters in the dark, which are allowed on top of the limit."""
_MAX_READ_BACK_ERROR = 0.02
"""Largest relative difference between a value that was set and the one read back."""


class LaserRefused(DeviceError):
    """The laser did not execute a command: it answered with an error, or another value was read back."""


@dataclass(frozen=True, slots=True)
class LaserIdentity:
    """Vendor, model and serial number."""

    vendor: str
    model: str
    serial: str

    @property
    def text(self) -> str:
        """The identity in words; a family without models has an empty one."""
        return " ".join(filter(None, (self.vendor, self.model, self.serial)))


@dataclass(frozen=True, slots=True)
class LaserState:
    """State read from the laser; None for values that this family does not report."""

    on: bool
    interlock_closed: bool
    power_w: float | None = None
    """Measured optical power."""
    current_a: float | None = None
    """Measured diode current."""
    fault: str = ""
    dark_reason: str = ""
    """The reason why the laser must be dark although its settings are allowed: too much light or current is
    measured, or something besides this program can change the light; else empty.
    """


class SerialLaser(ABC):
    """A laser, or a laser diode's controller, over a serial line; a subclass has its family's commands.

    Life cycle: ``open`` -> (``set_power_w`` or ``set_current_a``, ``enable``, ``state``, ``off``) any number
    of times -> ``close``, which may be called in any state. ``open`` sets or refuses all modes in which
    something else could change the light. Only one thread may call them. Each blocks for at most a few
    timeouts (``enable`` for the delay of the safety class) and raises DeviceError with one line. Limits are
    checked before a value is sent, and are also written into a device that has a limit of its own.
    """

    terminator = b"\n"
    on_command: str
    off_command: str
    set_header: str
    """Command that sets power or current; with a "?" it reads the value back."""
    scale = 1.0
    """Number that is sent for 1 W or 1 A."""
    digits = 6
    """Number of decimals that are sent."""
    set_key: ClassVar[Literal["power_w", "current_a"]] = "power_w"
    """Key of the configuration with the value that is set."""
    resolution = 1e-6
    """Resolution of the device in W or A, by which a value read back may differ."""

    def __init__(self, settings: LaserSettings, open_line: Callable[[], SerialLine] | None = None) -> None:
        self._settings = settings
        self._open_line = open_line or (lambda: SerialPort(settings.port, settings.baud))
        self._line: SerialLine | None = None
        self._reader: LineReader | None = None

    # -- defined by each family ------------------------------------------------

    @abstractmethod
    def identify(self) -> LaserIdentity:
        """Read vendor, model and serial number; raises DeviceError if the device is of another family."""

    @abstractmethod
    def _read(self) -> LaserState:
        """Read the laser's state, without `dark_reason`."""

    @abstractmethod
    def _changed_mode(self) -> str:
        """A mode of `_prepare` that has changed, so that something else sets the light; empty if none has."""

    @abstractmethod
    def _prepare(self) -> None:
        """Set modes and limits, while the emission is off."""

    @abstractmethod
    def _command(self, command: str) -> None:
        """Send a command; raises LaserRefused unless the laser has executed it."""

    # -- the same for every family ---------------------------------------------

    def open(self) -> LaserIdentity:
        """Open the port, check the family, switch the emission off, write the limits into the device."""
        self.close()
        self._line = self._open_line()
        self._reader = LineReader(self._line)
        try:
            self._reader.clear()
            identity = self.identify()
            self.off()
            self._prepare()
            if changed_mode := self._changed_mode():
                raise LaserRefused(f"{self.name}: {changed_mode}, and stays so; change it as its manual says")
        except BaseException:
            self._close_port()
            raise
        return identity

    @final
    def state(self) -> LaserState:
        """Read the laser's state."""
        state = self._read()
        return replace(state, dark_reason=self._excess(state) or self._changed_mode())

    def set_power_w(self, power_w: float) -> None:
        """Set the optical power; raises PowerLimit above max_power_w, LaserRefused for one set in amperes."""
        self._set(power_w, "power_w")

    def set_current_a(self, current_a: float) -> None:
        """Set the diode current; raises PowerLimit above max_current_a, LaserRefused for one set in watts."""
        self._set(current_a, "current_a")

    def enable(self, refusal: Callable[[], str] = lambda: "") -> None:
        """Switch on if nothing forbids it, and wait until the laser reports emission.

        `refusal` returns the reason why the laser must not light, or "". Raises InterlockOpen if the
        interlock is open, LaserRefused with a fault, without emission, or as soon as it must not emit. After
        another error the laser may emit: `LaserService` switches off what it has not lit.
        """
        state = self.state()
        if not state.interlock_closed:
            raise InterlockOpen(
                f"{self.name}: the interlock is open, the laser stays off; close the cover or door"
            )
        if state.fault:
            raise LaserRefused(
                f"{self.name}: the laser reports {state.fault!r} and was not switched on; clear the fault"
            )
        if reason := state.dark_reason or refusal():
            raise LaserRefused(f"{self.name}: {reason}; it was not switched on")
        self._switch(True)
        # some families emit only after a delay that their safety class requires
        deadline_s = time.monotonic() + ON_WITHIN_S
        while True:
            state = self.state()
            if reason := state.dark_reason or refusal():
                self._switch(False)
                raise LaserRefused(f"{self.name}: {reason}; it was switched off")
            if state.on:
                return
            if time.monotonic() > deadline_s:
                self._switch(False)
                raise LaserRefused(
                    f"{self.name}: was switched on but does not emit after {ON_WITHIN_S:g} s; check its panel"
                )
            time.sleep(_POLL_INTERVAL_S)

    def off(self) -> None:
        """Switch off; LaserRefused if the laser still reports emission."""
        self._switch(False)
        if self._read().on:
            raise LaserRefused(f"{self.name}: was switched off but still emits; open the interlock by hand")

    def close(self) -> None:
        """Switch off, repeatedly if it is not confirmed (a failure is logged), and close the port."""
        if self._line is None:
            return
        try:
            for _ in range(_MAX_RETRIES):
                with contextlib.suppress(LaserRefused, ReplyTimeout):
                    self.off()
                    return
            self.off()
        except DeviceError as error:
            _log.error("%s: may still emit (%s); switch it off by hand", self.name, error)
        finally:
            self._close_port()

    @property
    def name(self) -> str:
        """Name of the laser in messages."""
        return f"{self._settings.kind} laser on {self._settings.port}"

    # -- for the subclasses ---------------------------------------------------

    def ask(self, command: str, *, may_be_ok: bool = False) -> str:
        """Send a query and return the answer; the query is repeated if none arrives in time.

        ``OK`` is skipped unless `may_be_ok`: another program may have written LIGHT OFF to the same port, and
        its confirmation arrives here.
        """
        line, reader = self._require_open()
        for _ in range(_MAX_RETRIES + 1):
            # a late answer to an earlier query must not be taken for the answer to this one
            reader.clear()
            line.write(command.encode("ascii") + self.terminator)
            deadline_s = time.monotonic() + self._settings.timeout_s
            while (line_bytes := reader.read_line(deadline_s)) is not None:
                answer = line_bytes.decode("latin-1").strip()
                if may_be_ok or answer != "OK":
                    return answer
        raise ReplyTimeout(
            f"{self.name}: no reply to {command} within {self._settings.timeout_s:g} s,"
            f" sent {_MAX_RETRIES + 1} times; check port, baud rate and cable"
        )

    def ask_float(self, command: str) -> float:
        """The answer to a query as a number; raises LaserRefused if it is not a number."""
        answer = self.ask(command)
        try:
            return float(answer)
        except ValueError:
            raise LaserRefused(
                f"{self.name}: answered {answer!r} to {command}; a number was expected"
            ) from None

    def tell(self, command: str) -> None:
        """Send a command that this family does not answer."""
        line, _ = self._require_open()
        line.write(command.encode("ascii") + self.terminator)

    def ask_flag(self, command: str, *, may_be_ok: bool = False) -> bool:
        """Whether the answer to a query says that something is on or closed."""
        return self.ask(command, may_be_ok=may_be_ok).upper() in ("1", "ON", "OK", "CLOSED")

    def _switch(self, on: bool) -> None:
        self._command(self.on_command if on else self.off_command)

    def _write_value(self, header: str, value: float) -> float:
        # rounded down, so that a limit is not exceeded (except by binary rounding)
        steps = math.floor(value * self.scale * 10**self.digits + 1e-6)
        self._command(f"{header} {steps / 10**self.digits:.{self.digits}f}")
        return self.ask_float(f"{header}?") / self.scale

    def _set(self, value: float, key: str) -> None:
        if key != self.set_key:
            raise LaserRefused(
                f"{self.name}: this laser sets {self.set_key}, not {key}; change the configuration"
            )
        limit, unit = getattr(self._settings, f"max_{key}"), key[-1].upper()
        # this form of the condition also rejects NaN
        if not 0.0 <= value <= limit:
            raise PowerLimit(
                f"{self.name}: {value:g} {unit} was asked for; 0 to {limit:g} is allowed by max_{key}"
            )
        applied = self._write_value(self.set_header, value)
        if not math.isclose(applied, value, rel_tol=_MAX_READ_BACK_ERROR, abs_tol=1.001 * self.resolution):
            self._switch(False)
            raise LaserRefused(
                f"{self.name}: {value:g} {unit} was sent, {applied:g} was read back; it was switched off"
            )

    def _excess(self, state: LaserState) -> str:
        """The measured power or current that exceeds its limit, in words; empty if none does."""
        limits = self._settings
        for value, limit, offset, unit, name in (
            (state.power_w, limits.max_power_w, _METER_OFFSET_W, "mW", "max_power_w"),
            (state.current_a, limits.max_current_a, _METER_OFFSET_A, "mA", "max_current_a"),
        ):
            if value is not None and not value <= limit * _MAX_METER_RATIO + offset:
                return f"{value * 1e3:.3g} {unit} measured, {limit * 1e3:g} {unit} allowed by {name}"
        return ""

    def _require_open(self) -> tuple[SerialLine, LineReader]:
        if self._line is None or self._reader is None:
            raise PortLost(f"{self.name}: the laser is not open")
        return self._line, self._reader

    def _close_port(self) -> None:
        line, self._line, self._reader = self._line, None, None
        if line is not None:
            with contextlib.suppress(PortLost):
                line.close()


class DiodeController(SerialLaser):
    """The controller of a laser diode, whose current is set, with a limit of its own."""

    set_key = "current_a"
    limit_header: str

    def _identify(self, maker: str, models: tuple[str, ...], expected: str) -> LaserIdentity:
        """Vendor, model and serial number; raises LaserRefused for other models, naming `expected`."""
        fields = [field.strip() for field in self.ask("*IDN?").split(",")]
        if len(fields) < 3 or maker not in fields[0].upper() or not fields[1].upper().startswith(models):
            raise LaserRefused(f"{self.name}: {','.join(fields)!r} is not {expected}; check the port")
        return LaserIdentity(fields[0], fields[1], fields[2].removeprefix("s/n"))

    def _write_limit(self) -> None:
        """Write max_current_a into the device; LaserRefused where it has not taken it as its limit."""
        limit_a = self._settings.max_current_a
        applied_a = self._write_value(self.limit_header, limit_a)
        if applied_a > limit_a + 1e-6:
            raise LaserRefused(
                f"{self.name}: the current limit was set to {limit_a:g} A and is {applied_a:g} A;"
                " set it on the instrument's panel"
            )
