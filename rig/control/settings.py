"""Sections [controller] and [environment_sensor]."""

import contextlib
import math
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, model_validator

from processing.errors import DeviceError
from processing.units import seconds
from rig.control.protocol import AirReading
from rig.control.serial_port import LineReader, PortLost, SerialLine, SerialPort
from rig.control.worker import DeviceThread

ControllerKind = Literal["none", "simulated", "serial"]
EnvironmentKind = Literal["none", "controller", "serial"]

_QUANTITIES = frozenset({"temperature_c", "humidity_percent", "pressure_pa", "pressure_hpa"})


class SerialFaults(BaseModel, frozen=True, extra="forbid"):
    """Faults of the simulated controller's serial line; all off by default.

    The probabilities apply to each transmitted block of bytes, in either direction.
    """

    junk_probability: float = Field(default=0.0, ge=0, le=1)
    loss_probability: float = Field(default=0.0, ge=0, le=1)
    delay_s: float = Field(default=0.0, ge=0, le=10)
    reset_at_s: float | None = Field(default=None, ge=0)
    unplug_at_s: float | None = Field(default=None, ge=0)


class ControllerSettings(BaseModel, frozen=True, extra="forbid"):
    """The rig controller: serial line, timeouts and limits checked by the host.

    `watchdog_s` is the time without a heartbeat after which the board puts every output into its safe state;
    it must be at least twice `heartbeat_s`.
    """

    kind: ControllerKind = "none"
    port: str = ""
    baud: int = Field(default=115200, gt=0)
    timeout_s: float = Field(default=0.2, gt=0, le=5)
    retries: int = Field(default=2, ge=0, le=10)
    heartbeat_s: float = Field(default=0.25, gt=0, le=2)
    watchdog_s: float = Field(default=1.5, ge=0.1, le=5)
    starter_max_s: float = Field(default=5.0, gt=0)
    faults: SerialFaults = SerialFaults()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the controller's serial port, or see `rig doctor`")
        if self.watchdog_s < 2 * self.heartbeat_s:
            raise ValueError(
                f"watchdog_s {self.watchdog_s:g} is too short for heartbeat_s {self.heartbeat_s:g};"
                " at least two heartbeats must fit in"
            )
        return self


OWN_TIME = "time_s"
"""Name of a witness's column that holds its own clock."""
_MOST_COLUMNS = 3


class SeismometerSettings(BaseModel, frozen=True, extra="forbid"):
    """An instrument beside the rig that feels the ground: geophone, tiltmeter, seismometer.

    Each line that it writes holds a sample: numbers of the `columns` in their order, between commas,
    semicolons or spaces; text around them is passed over. A column `time_s` is the instrument's own clock.
    A `file` is read as another program appends lines to it.
    """

    kind: Literal["none", "simulated", "serial", "file"] = "none"
    port: str = ""
    baud: int = Field(default=115200, gt=0)
    file: Path | None = Field(default=None, description="to which another program appends lines")
    columns: tuple[str, ...] = Field(
        default=("along", "across"), description="one to three, in any unit; beside them time_s"
    )
    stale_after_s: float = Field(
        default=10.0, gt=0, description="it counts as silent after this time without a sample"
    )

    @property
    def components(self) -> tuple[str, ...]:
        """The columns without the instrument's clock."""
        return tuple(name for name in self.columns if name != OWN_TIME)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the witness's serial port, or see `rig doctor`")
        if self.kind == "file" and self.file is None:
            raise ValueError("file is missing; name the file to which its lines are appended")
        if len(set(self.columns)) < len(self.columns) or not 1 <= len(self.components) <= _MOST_COLUMNS:
            raise ValueError(
                f"columns = {list(self.columns)} are to be one to {_MOST_COLUMNS} different names, and "
                f"{OWN_TIME} where the instrument has a clock"
            )
        return self


def _named_groups(pattern: str) -> str:
    try:
        groups = set(re.compile(pattern).groupindex)
    except re.error as error:
        raise ValueError(f"pattern {pattern!r} is not a regular expression: {error}") from None
    if not groups or groups - _QUANTITIES:
        raise ValueError(
            f"pattern {pattern!r} names the groups {sorted(groups)};"
            f" at least one of {sorted(_QUANTITIES)} is needed and no other is allowed"
        )
    return pattern


class EnvironmentSettings(BaseModel, frozen=True, extra="forbid"):
    """The sensor of temperature, humidity and pressure.

    `pattern` is searched in each line that the sensor writes. Its named groups identify the numbers:
    temperature_c, humidity_percent, and pressure_pa or pressure_hpa. `request` is sent once per `period_s` to
    a sensor that writes only on request.
    """

    kind: EnvironmentKind = "none"
    port: str = ""
    baud: int = Field(default=9600, gt=0)
    pattern: Annotated[str, AfterValidator(_named_groups)] = (
        r"(?P<temperature_c>[-+\d.]+)[,;\s]+(?P<humidity_percent>[\d.]+)[,;\s]+(?P<pressure_hpa>[\d.]+)"
    )
    request: str = ""
    period_s: float = Field(default=1.0, gt=0)
    stale_after_s: float = Field(default=30.0, gt=0)

    @model_validator(mode="after")
    def _port_named(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the sensor's serial port, or see `rig doctor`")
        return self


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

    def _poll(self) -> float:
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
