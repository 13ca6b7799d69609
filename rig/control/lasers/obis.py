"""Coherent OBIS and its remotes: SCPI, lines end with CR LF, power in W.

With handshaking (the factory setting) each command is answered by a line ``OK`` or ``ERR<number>``, which
also follows the answer to each query. Both lines are always read, and handshaking is switched on first.

Its analogue and digital inputs are switched off (constant power), and so is ``SYSTem:AUTostart``, with which
the key alone lights it. The delay of its safety class (``SYSTem:CDRH``) stays as it is. It is not switched
on while it warms up, because it would then light at the end of the warm-up.
"""

import time

from rig.control.lasers.serial_laser import LaserIdentity, LaserRefused, LaserState, SerialLaser
from rig.control.serial_port import ReplyTimeout

_WARMING_UP = 0x100


class Obis(SerialLaser):
    """Mode of continuous emission at constant power, regulated by the laser's own photodiode."""

    on_command, off_command = "SOURce:AM:STATe ON", "SOURce:AM:STATe OFF"
    set_header = "SOURce:POWer:LEVel:IMMediate:AMPLitude"
    terminator = b"\r\n"
    resolution = 1e-5

    def identify(self) -> LaserIdentity:
        """Vendor, model and serial number."""
        # read without the OK that follows only with handshaking
        identity = super().ask("*IDN?")
        if "COHERENT" not in identity.upper() or "OBIS" not in identity.upper():
            raise LaserRefused(f"{self.name}: {identity!r} is not a Coherent OBIS; check the port")
        self._begin_handshaking()
        return LaserIdentity(
            "Coherent", self.ask("SYSTem:INFormation:MODel?"), self.ask("SYSTem:INFormation:SNUMber?")
        )

    def _read(self) -> LaserState:
        """Emission, interlock, measured power, fault code."""
        fault = self.ask("SYSTem:FAULt?")
        if _number(fault) != 0:
            fault = f"fault {fault}"
        else:
            fault = "warming up" if (_number(self.ask("SYSTem:STATus?")) or 0) & _WARMING_UP else ""
        return LaserState(
            on=self.ask_flag("SOURce:AM:STATe?"),
            # some models answer it by OK
            interlock_closed=self.ask_flag("SYSTem:LOCK?", may_be_ok=True),
            power_w=self.ask_float("SOURce:POWer:LEVel?"),
            fault=fault,
        )

    def ask(self, command: str, *, may_be_ok: bool = False) -> str:
        """The answer to a query; the ``OK`` that follows it is read too."""
        answer = super().ask(command, may_be_ok=may_be_ok)
        if answer.startswith("ERR"):
            raise LaserRefused(f"{self.name}: answered {answer} to {command}")
        self._read_handshake(command)
        return answer

    def _prepare(self) -> None:
        self._command("SOURce:AM:INTernal CWP")
        self._command("SYSTem:AUTostart OFF")

    def _changed_mode(self) -> str:
        if (source := self.ask("SOURce:AM:SOURce?").upper()) != "CWP":
            return f"it does not run at constant power: {source} sets its light"
        return "" if self.ask("SYSTem:AUTostart?").upper() in ("OFF", "0") else "its autostart is on"

    def _command(self, command: str) -> None:
        _, reader = self._require_open()
        reader.clear()
        self.tell(command)
        self._read_handshake(command)

    def _begin_handshaking(self) -> None:
        """Switch handshaking on; whether this is answered depends on what it was before."""
        _, reader = self._require_open()
        reader.clear()
        self.tell("SYSTem:COMMunicate:HANDshaking ON")
        reader.read_line(time.monotonic() + self._settings.timeout_s)

    def _read_handshake(self, command: str) -> None:
        _, reader = self._require_open()
        deadline_s = time.monotonic() + self._settings.timeout_s
        while (line := reader.read_line(deadline_s)) is not None:
            if line.strip() == b"OK":
                return
            if line.startswith(b"ERR"):
                raise LaserRefused(f"{self.name}: answered {line.decode('latin-1').strip()} to {command}")
        raise ReplyTimeout(f"{self.name}: no OK after {command} within {self._settings.timeout_s:g} s")


def _number(code: str) -> int | None:
    try:
        return int(code.removeprefix("0x"), 16)
    except ValueError:
        return None
