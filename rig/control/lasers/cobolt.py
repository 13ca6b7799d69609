"""Cobolt lasers (04-01, 06-01, 08 series): text commands that end with CR, replies with CR LF, power in W.

An executed command is answered by ``OK``, any other by ``Syntax error: ...``. The driver switches modulation
off (constant power), and also the direct input, where 5 V light an OEM model. Autostart, with which the key
alone lights the laser, must be switched off by hand.
"""

from rig.control.lasers.serial_laser import LaserIdentity, LaserRefused, LaserState, SerialLaser

_MODULATION_MODES = ("3", "4")
_FAULTS = {"0": "", "1": "temperature error", "3": "", "4": "constant-power time-out"}
"""Faults by their numbers; an interlock error (3) is none, because `interlock_closed` reports it."""


class Cobolt(SerialLaser):
    """Mode of constant power, regulated by the laser's own photodiode."""

    on_command, off_command = "l1", "l0"
    set_header = "p"
    digits = 5
    terminator = b"\r"
    resolution = 1e-5

    def identify(self) -> LaserIdentity:
        """Serial number; the family has no other identification."""
        serial = self.ask("sn?")
        if "error" in serial.lower() or not any(c.isdigit() for c in serial) or "," in serial:
            raise LaserRefused(
                f"{self.name}: answered {serial!r}; a Cobolt's serial number was expected; check the port"
            )
        return LaserIdentity("Cobolt", "", serial)

    def _read(self) -> LaserState:
        """Emission, interlock, measured power, fault."""
        fault = self.ask("f?")
        return LaserState(
            on=self.ask_flag("l?"),
            interlock_closed=self.ask("ilk?") == "0",
            power_w=self.ask_float("pa?"),
            fault=_FAULTS.get(fault, f"fault {fault}"),
        )

    def _prepare(self) -> None:
        if self._has_autostart():
            raise LaserRefused(
                f"{self.name}: autostart is on, in which the laser lights by its key and rejects commands; "
                "switch it off (@cobas 0, or in Cobolt Monitor) and turn the key off and on"
            )
        if self._input_can_light():
            self._command("@cobasdr 0")
        self._command("cp")

    def _changed_mode(self) -> str:
        if self.ask("gom?") in _MODULATION_MODES:
            return "its modulation input sets the light"
        if self._input_can_light():
            return "its direct input can light it"
        return "its autostart is on" if self._has_autostart() else ""

    # models without these settings answer with a syntax error

    def _has_autostart(self) -> bool:
        return self.ask_flag("@cobas?")

    def _input_can_light(self) -> bool:
        return self.ask_flag("@cobasdr?")

    def _command(self, command: str) -> None:
        answer = self.ask(command, may_be_ok=True)
        if answer != "OK":
            raise LaserRefused(f"{self.name}: answered {answer!r} to {command}")
