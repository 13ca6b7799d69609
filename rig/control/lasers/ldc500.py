"""SRS LDC500 series diode controllers: four-letter commands, lines end with LF, current in mA.

`SILM` is the instrument's own current limit, which no later setting exceeds. Modulation by the analogue input
is switched off, because it would add to the set current. A scan of the current, which only another program
can start, is refused.
"""

import time

from rig.control.lasers.serial_laser import DiodeController, LaserIdentity, LaserRefused, LaserState

_EXECUTION_S = 0.1


class Ldc500(DiodeController):
    """Diode controller in the mode of constant current."""

    on_command, off_command = "LDON ON", "LDON OFF"
    set_header, limit_header = "SILD", "SILM"
    scale, digits = 1000.0, 3

    def identify(self) -> LaserIdentity:
        """Vendor, model and serial number."""
        return self._identify("STANFORD", ("LDC50",), "an SRS LDC500 series driver")

    def _read(self) -> LaserState:
        """Output, interlock, measured current, monitor diode's power."""
        return LaserState(
            on=self.ask_flag("LDON?"),
            interlock_closed=self.ask_flag("ILOC?"),
            current_a=self.ask_float("RILD?") / 1000.0,
            power_w=self.ask_float("RWPD?") / 1000.0,
        )

    def _prepare(self) -> None:
        self._command("SMOD CC")
        self._command("MODU OFF")
        self._write_limit()

    def _changed_mode(self) -> str:
        if self.ask("SMOD?").upper() not in ("CC", "0"):
            return "it is not in the mode of constant current"
        if self.ask_flag("MODU?"):
            return "its modulation input is on"
        return "a scan of its current is in progress" if self.ask_flag("SCAN?") else ""

    def _command(self, command: str) -> None:
        self.tell(command)
        # an error is registered only after the command was executed, for which a query does not wait
        time.sleep(_EXECUTION_S)
        # LEXE? is the error of the last execution, LCME? that of the last command; reading clears them.
        errors = (self.ask("LEXE?"), self.ask("LCME?"))
        if any(error not in ("0", "0.0") for error in errors):
            raise LaserRefused(f"{self.name}: refused {command} (LEXE {errors[0]}, LCME {errors[1]})")
