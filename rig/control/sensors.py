"""Sensors of ambient conditions, and seismometers, that write lines of text to a serial port."""

import contextlib
import math
import re
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import NamedTuple

from acquisition.frames.queue import take_all
from processing.errors import DeviceError
from processing.units import seconds
from rig.control.device_thread import DeviceThread
from rig.control.protocol import AmbientReading
from rig.control.serial_port import LineReader, PortLost, SerialLine, SerialPort
from rig.control.settings import OWN_TIME, EnvironmentSettings, SeismometerSettings

_REOPEN_INTERVAL_S = 1.0
_READ_TIMEOUT_S = 0.1
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_MAX_QUEUED_SAMPLES = 200_000
"""Largest number of samples that wait for the recorder: an hour at 50 Hz."""


class SensorReader(DeviceThread):
    """Reads a sensor's lines in a thread from `start` to `close`.

    A sensor that was unplugged or is missing is opened again.
    """

    def __init__(self, name: str, open_line: Callable[[], SerialLine], stale_after_s: float) -> None:
        self._open_line = open_line
        self._stale_after_s = stale_after_s
        self._line: SerialLine | None = None
        self._reader: LineReader | None = None
        self._at_line_start = False
        self.last_reading_ns = -1
        """Time of the last line with a reading on the host's monotonic clock; -1 before the first."""
        self.lines_without_reading = 0
        self.last_line = ""
        """Begin of the last line, with or without a reading."""
        self.last_error = ""
        """The reason why the port is closed; empty while it is open."""
        super().__init__(name)

    @property
    def age_s(self) -> float:
        """Time since the last reading; infinite before the first."""
        last_ns = self.last_reading_ns
        return seconds(time.monotonic_ns() - last_ns) if last_ns >= 0 else math.inf

    @property
    def stale(self) -> bool:
        """Whether no reading has come for `stale_after_s`."""
        return self.age_s > self._stale_after_s

    def wait_for_reading(self, timeout_s: float) -> bool:
        """Whether a reading comes within `timeout_s`; called instead of `start`, in the caller's thread."""
        deadline_s = time.monotonic() + timeout_s
        while self.last_reading_ns < 0 and not self.last_error and time.monotonic() < deadline_s:
            self._poll()
        self._finish()
        return self.last_reading_ns >= 0

    @abstractmethod
    def _take(self, text: str, now_ns: int) -> bool:
        """Take the reading from a line; False if it has none."""

    def _request(self, line: SerialLine, now_s: float) -> None:
        """Request a line of a sensor that writes only on request."""

    def _poll(self) -> float:
        try:
            if self._line is None or self._reader is None:
                self._line = self._open_line()
                self._reader = LineReader(self._line)
                self._reader.clear()
                self._at_line_start = False
                self.last_error = ""
            self._read(self._line, self._reader)
        except DeviceError as error:
            # a persistent error is reported once
            if str(error) != self.last_error:
                self._report(str(error))
            self.last_error = str(error)
            self._finish()
            return _REOPEN_INTERVAL_S
        return 0.0

    def _read(self, line: SerialLine, reader: LineReader) -> None:
        now_s = time.monotonic()
        if not self._at_line_start:
            self._at_line_start = reader.finds_line_start(now_s + _READ_TIMEOUT_S)
            return
        self._request(line, now_s)
        raw = reader.read_line(now_s + _READ_TIMEOUT_S)
        if raw is None or not raw.strip():
            return
        text, now_ns = raw.decode("latin-1").strip(), time.monotonic_ns()
        self.last_line = text[:80]
        if self._take(text, now_ns):
            self.last_reading_ns = now_ns
        else:
            self.lines_without_reading += 1

    def _finish(self) -> None:
        """Close the port: a sensor has no unsafe state."""
        line, self._line, self._reader = self._line, None, None
        if line is not None:
            with contextlib.suppress(PortLost):
                line.close()


def parse_environment(pattern: re.Pattern[str], line: str) -> AmbientReading | None:
    """Reading from the pattern's named groups in a line.

    A quantity that is missing, or has an impossible value, is NaN. ``pressure_hpa`` is converted to Pa.
    None if the line does not match, a number is not finite, or no quantity has a possible value.
    """
    match = pattern.search(line)
    if match is None:
        return None
    try:
        values = {name: float(text) for name, text in match.groupdict().items() if text is not None}
    except ValueError:
        return None
    if not values or not all(math.isfinite(value) for value in values.values()):
        return None
    pressure_pa = values.get("pressure_pa", values.get("pressure_hpa", math.nan) * 100.0)
    reading = AmbientReading(
        values.get("temperature_c", math.nan), values.get("humidity_percent", math.nan), pressure_pa
    ).possible
    return None if all(map(math.isnan, asdict(reading).values())) else reading


class AmbientSensor(SensorReader):
    """A sensor of ambient conditions with a port of its own."""

    def __init__(self, settings: EnvironmentSettings) -> None:
        self._settings = settings
        self._pattern = re.compile(settings.pattern)
        self._last_request_s = 0.0
        self._latest = AmbientReading()
        super().__init__(
            "rig-environment", lambda: SerialPort(settings.port, settings.baud), settings.stale_after_s
        )

    @property
    def latest(self) -> AmbientReading:
        """Latest reading, NaN for quantities that are not sent, and all NaN in silence. Never blocks."""
        return AmbientReading() if self.stale else self._latest

    def _request(self, line: SerialLine, now_s: float) -> None:
        if self._settings.request and now_s - self._last_request_s >= self._settings.period_s:
            self._last_request_s = now_s
            line.write(self._settings.request.encode("ascii") + b"\n")

    def _take(self, text: str, now_ns: int) -> bool:
        reading = parse_environment(self._pattern, text)
        # stored before `last_ns`, so that an old reading never counts as a new one
        self._latest = self._latest if reading is None else reading
        return reading is not None


class SeismometerSample(NamedTuple):
    """A sample of a seismometer."""

    host_time_ns: int
    """Arrival on the host's monotonic clock."""
    own_time_s: float
    """Time of the instrument's own clock; NaN without one."""
    components: tuple[float, ...]


def sample_of(line: str, columns: Sequence[str], host_time_ns: int) -> SeismometerSample | None:
    """The sample in a line that has as many numbers as there are columns; None for any other line."""
    numbers = [float(text) for text in _NUMBER.findall(line)]
    if len(numbers) != len(columns) or not all(map(math.isfinite, numbers)):
        return None
    by_name = dict(zip(columns, numbers, strict=True))
    own_s = by_name.pop(OWN_TIME, math.nan)
    return SeismometerSample(host_time_ns, own_s, tuple(by_name.values()))


class SeismometerReader(SensorReader):
    """An auxiliary seismometer: every line of its serial port is a sample."""

    def __init__(self, settings: SeismometerSettings) -> None:
        self._settings = settings
        self._samples: deque[SeismometerSample] = deque(maxlen=_MAX_QUEUED_SAMPLES)
        super().__init__(
            "rig-seismometer", lambda: SerialPort(settings.port, settings.baud), settings.stale_after_s
        )

    def take_samples(self) -> list[SeismometerSample]:
        """Samples since the last call, oldest first. Never blocks; only one thread may call it."""
        return take_all(self._samples)

    def _take(self, text: str, now_ns: int) -> bool:
        sample = sample_of(text, self._settings.columns, now_ns)
        if sample is not None:
            self._samples.append(sample)
        return sample is not None
