"""Samples of a witness of the ground: lines from a serial port, or from a file that grows."""

import contextlib
import math
import os
import re
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from processing.errors import DeviceError
from processing.units import seconds
from rig.control.serial_port import LineReader, PortLost, SerialLine, SerialPort
from rig.control.settings import OWN_TIME, SeismometerSettings
from rig.control.worker import DeviceThread

_REOPEN_S = 1.0
_READ_S = 0.1
_POLL_S = 0.02
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_MOST_WAITING = 200_000
"""Samples that wait for the recorder: an hour at 50 Hz."""


class SeismometerSample(NamedTuple):
    """A sample: when it arrived (host's monotonic clock), its own time or NaN, and its components."""

    host_time_ns: int
    own_time_s: float
    value: tuple[float, ...]


def sample_of(line: str, columns: Sequence[str], host_time_ns: int) -> SeismometerSample | None:
    """The numbers of a line, which are as many as the columns; None for any other line."""
    found = [float(text) for text in _NUMBER.findall(line)]
    if len(found) != len(columns) or not all(map(math.isfinite, found)):
        return None
    of = dict(zip(columns, found, strict=True))
    own_s = of.pop(OWN_TIME, math.nan)
    return SeismometerSample(host_time_ns, own_s, tuple(of.values()))


class FileTail:
    """A `SerialLine` of what is appended to a file; one that was cut or replaced is read from its begin."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None
        self._is_within_line = False
        self._open()

    @property
    def name(self) -> str:
        """The file."""
        return str(self._path)

    def write(self, data: bytes) -> None:
        """A file takes no orders."""
        raise PortLost(f"{self._path}: nothing is written to the file of a witness")

    def read(self, timeout_s: float) -> bytes:
        """What was appended, at least one byte; b"" after timeout_s."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                assert self._file is not None
                data = self._file.read()
                if not data and self._is_another():
                    self._open()
                    # what was left of a line does not go on in another file
                    data = b"\n" * self._is_within_line + self._file.read()
            except OSError as error:
                raise PortLost(f"{self._path}: {error.strerror or error}") from error
            left_s = deadline_s - time.monotonic()
            if data:
                self._is_within_line = not data.endswith(b"\n")
            if data or left_s <= 0:
                return data
            time.sleep(min(_POLL_S, left_s))

    def discard_input(self) -> None:
        """Go to the end."""
        assert self._file is not None
        self._file.seek(0, 2)

    def close(self) -> None:
        """Close the file; may be called more than once."""
        if self._file is not None:
            self._file.close()

    def _is_another(self) -> bool:
        """Whether the file of this name was cut, or is not the one that is read."""
        assert self._file is not None
        now, opened = self._path.stat(), os.fstat(self._file.fileno())
        return not os.path.samestat(now, opened) or now.st_size < self._file.tell()

    def _open(self) -> None:
        self.close()
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise PortLost(f"{self._path}: cannot be read: {error.strerror or error}") from error


class SeismometerLines(DeviceThread):
    """Every line of a serial port or of a file that grows is a sample.

    They are taken in a thread from `start` to `close`; what was unplugged or is not there is opened again.
    """

    def __init__(self, settings: SeismometerSettings) -> None:
        self._settings = settings
        self._samples: deque[SeismometerSample] = deque(maxlen=_MOST_WAITING)
        self._last_error = ""
        self._line: SerialLine | None = None
        self._reader: LineReader | None = None
        self._between_lines = False
        self.last_ns = -1
        self.unread_lines = 0
        self.last_line = ""
        super().__init__("rig-witness")

    @property
    def age_s(self) -> float:
        """Since the last sample; infinite before the first."""
        return seconds(time.monotonic_ns() - self.last_ns) if self.last_ns >= 0 else math.inf

    @property
    def silent(self) -> bool:
        """Whether no sample has come for `stale_after_s`."""
        return self.age_s > self._settings.stale_after_s

    def take_samples(self) -> list[SeismometerSample]:
        """Those since the last call, oldest first. Never blocks; only one thread may call it."""
        return [self._samples.popleft() for _ in range(len(self._samples))]

    def _opened(self) -> SerialLine:
        settings = self._settings
        if settings.kind == "file":
            assert settings.file is not None
            return FileTail(settings.file)
        return SerialPort(settings.port, settings.baud)

    def _poll(self) -> float:
        try:
            if self._line is None or self._reader is None:
                self._line = self._opened()
                self._reader = LineReader(self._line)
                self._reader.clear()
                self._between_lines = False
                self._last_error = ""
            self._read(self._reader)
        except DeviceError as error:
            # of an error that goes on people are told once
            if str(error) != self._last_error:
                self._say(str(error))
            self._last_error = str(error)
            self._finish()
            return _REOPEN_S
        return 0.0

    def _read(self, reader: LineReader) -> None:
        deadline_s = time.monotonic() + _READ_S
        if not self._between_lines:
            self._between_lines = reader.finds_line_start(deadline_s)
            return
        raw = reader.read_line(deadline_s)
        if raw is None or not raw.strip():
            return
        text = raw.decode("latin-1").strip()
        now_ns = time.monotonic_ns()
        sample = sample_of(text, self._settings.columns, now_ns)
        self.last_line = text[:80]
        if sample is None:
            self.unread_lines += 1
            return
        self._samples.append(sample)
        self.last_ns = time.monotonic_ns()

    def _finish(self) -> None:
        line, self._line, self._reader = self._line, None, None
        if line is not None:
            with contextlib.suppress(PortLost):
                line.close()
