"""Reads temperature, humidity and pressure from any sensor that writes lines to a serial port."""

import contextlib
import math
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from processing.errors import DeviceError
from processing.units import seconds
from rig.control.controller_answers import AirReading
from rig.control.serial_port import LineReader, PortLost, SerialLine, SerialPort
from rig.control.settings import EnvironmentSettings
from rig.control.worker import DeviceThread

_REOPEN_S = 1.0
_READ_S = 0.1


@dataclass(frozen=True, slots=True)
class EnvironmentReading:
    """Latest reading and its time (host's monotonic clock, ns); NaN for quantities the sensor does not send.

    `unread_lines` is the number of lines that did not match the pattern.
    """

    environment: AirReading
    time_ns: int = 0
    unread_lines: int = 0
    last_line: str = ""
    last_error: str = ""


def parse_environment(pattern: re.Pattern[str], line: str) -> AirReading | None:
    """Values of the pattern's named groups in a line; None without a match, if a number is not finite, or if
    none is one of air.

    ``pressure_hpa`` is converted to Pa. A quantity that is not in the line, or that no air has, is NaN.
    """
    match = pattern.search(line)
    if match is None:
        return None
    try:
        found = {name: float(text) for name, text in match.groupdict().items() if text is not None}
    except ValueError:
        return None
    if not found or not all(math.isfinite(value) for value in found.values()):
        return None
    pressure_pa = found.get("pressure_pa", found.get("pressure_hpa", math.nan) * 100.0)
    reading = AirReading(
        found.get("temperature_c", math.nan), found.get("humidity_percent", math.nan), pressure_pa
    ).possible
    return None if all(map(math.isnan, asdict(reading).values())) else reading


class EnvironmentService(DeviceThread):
    """Reads the sensor in a thread from `start` to `close`; reopens its port if it was unplugged."""

    def __init__(
        self, settings: EnvironmentSettings, open_line: Callable[[], SerialLine] | None = None
    ) -> None:
        self._settings = settings
        self._pattern = re.compile(settings.pattern)
        self._open_line = open_line or (lambda: SerialPort(settings.port, settings.baud))
        self._line: SerialLine | None = None
        self._reader: LineReader | None = None
        self._asked_s = 0.0
        self._between_lines = False
        self._latest = EnvironmentReading(AirReading())
        super().__init__("rig-environment")

    @property
    def latest(self) -> EnvironmentReading:
        """Latest reading; all NaN once it is older than stale_after_s. Never blocks."""
        latest = self._latest
        age_s = seconds(time.monotonic_ns() - latest.time_ns)
        if age_s > self._settings.stale_after_s:
            return replace(latest, environment=AirReading())
        return latest

    def _turn(self) -> float:
        try:
            if self._line is None or self._reader is None:
                self._line = self._open_line()
                self._reader = LineReader(self._line)
                self._reader.clear()
                self._between_lines = False
                self._latest = replace(self._latest, last_error="")
            self._read(self._line, self._reader)
        except DeviceError as error:
            if str(error) != self._latest.last_error:
                self._say(str(error))
            self._latest = replace(self._latest, last_error=str(error))
            self._finish()
            return _REOPEN_S
        return 0.0

    def _read(self, line: SerialLine, reader: LineReader) -> None:
        now_s = time.monotonic()
        if not self._between_lines:
            self._between_lines = reader.finds_line_start(now_s + _READ_S)
            return
        if self._settings.request and now_s - self._asked_s >= self._settings.period_s:
            self._asked_s = now_s
            line.write(self._settings.request.encode("ascii") + b"\n")
        raw = reader.read_line(now_s + _READ_S)
        if raw is None or not raw.strip():
            return
        text = raw.decode("latin-1").strip()
        environment = parse_environment(self._pattern, text)
        if environment is None:
            self._latest = replace(
                self._latest, unread_lines=self._latest.unread_lines + 1, last_line=text[:80]
            )
        else:
            self._latest = replace(
                self._latest, environment=environment, time_ns=time.monotonic_ns(), last_line=text[:80]
            )

    def _finish(self) -> None:
        line, self._line, self._reader = self._line, None, None
        if line is not None:
            with contextlib.suppress(PortLost):
                line.close()
