"""Thorlabs 4000 series diode controllers (LDC4000, ITC4000): SCPI, lines end with LF, current in A.

They are USBTMC instruments (1313:804a is an ITC4001): ``port`` is "usbtmc", "usbtmc:SERIAL" or /dev/usbtmcN.
A serial port is served as well.

The commands are those of the series' programmer's reference manual. The set current and its limit are read
back, and the instrument's error queue is read after every setting. Modulation, by its analogue input or by
its own generator, and pulses are switched off. Its input LD ENABLE, if used, is set to switch the laser off
permanently instead of only while it is low.
"""

from collections.abc import Callable

from rig.control.lasers.serial_laser import DiodeController, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.settings import LaserSettings
from rig.control.serial_port import SerialLine
from rig.control.usbtmc import UsbTmcLine, find_usbtmc, is_usbtmc

USB_VENDOR = 0x1313
_MAX_ERRORS = 30

_PROTECTIONS = {
    "INTLock": "interlock",
    "KEYLock": "key switch",
    "EXTernal": "input LD ENABLE",
    "OTEMp": "over-temperature",
    "VOLTage": "compliance voltage",
}


class Thorlabs4000(DiodeController):
    """Diode controller in the mode of constant current."""

    on_command, off_command = "OUTPut:STATe ON", "OUTPut:STATe OFF"
    set_header = "SOURce:CURRent:LEVel:AMPLitude"
    limit_header = "SOURce:CURRent:LIMit:AMPLitude"

    def __init__(self, settings: LaserSettings, open_line: Callable[[], SerialLine] | None = None) -> None:
        if open_line is None and is_usbtmc(settings.port):

            def open_line() -> SerialLine:
                return UsbTmcLine(find_usbtmc(settings.port, USB_VENDOR), settings.timeout_s)

        super().__init__(settings, open_line)

    def identify(self) -> LaserIdentity:
        """Vendor, model and serial number."""
        return self._identify("THORLABS", ("LDC4", "ITC4"), "a Thorlabs 4000 series driver")

    def _read(self) -> LaserState:
        """Output, protections and measured current."""
        trips = [
            name for key, name in _PROTECTIONS.items() if self.ask_flag(f"OUTPut:PROTection:{key}:TRIPped?")
        ]
        return LaserState(
            on=self.ask_flag("OUTPut:STATe?"),
            interlock_closed="interlock" not in trips,
            current_a=self.ask_float("MEASure:CURRent?"),
            fault=", ".join(trip for trip in trips if trip != "interlock"),
        )

    def _prepare(self) -> None:
        self.tell("*CLS")
        self._command("SOURce:FUNCtion:MODE CURRent")
        self._command("SOURce:FUNCtion:SHAPe DC")
        self._command("SOURce:AM:STATe OFF")
        if self._input_can_light():
            self._command("OUTPut:PROTection:EXTernal:MODE PROTection")
        self._write_limit()

    def _changed_mode(self) -> str:
        if not self.ask("SOURce:FUNCtion:MODE?").upper().startswith("CURR"):
            return "it is not in the mode of constant current"
        if not self.ask("SOURce:FUNCtion:SHAPe?").upper().startswith("DC"):
            return "it makes pulses"
        if self.ask_flag("SOURce:AM:STATe?"):
            return "its amplitude modulation is on"
        return "its input LD ENABLE can light it" if self._input_can_light() else ""

    def _input_can_light(self) -> bool:
        return self.ask("OUTPut:PROTection:EXTernal:MODE?").upper().startswith("ENAB")

    def _command(self, command: str) -> None:
        self.tell(command)
        for _ in range(_MAX_ERRORS):
            code, _, text = (field.strip() for field in self.ask("SYSTem:ERRor?").partition(","))
            if code.lstrip("+") == "0":
                return
            # a question that LIGHT OFF of another program interrupted (-400 to -499) is no error of a command
            if not code.startswith("-4"):
                raise LaserRefused(f"{self.name}: refused {command}: {text.strip(chr(34))} ({code})")
