"""A serial line as bytes and lines with deadlines; every failure becomes a DeviceError."""

import time
from types import TracebackType
from typing import Protocol, Self

import serial

from processing.errors import DeviceError

# A device that talks without ever ending a line must not eat the memory.
_BUFFER_MAX = 65536


class PortLost(DeviceError):
    """The port is missing or was unplugged; opening it again may bring it back."""


class Line(Protocol):
    """Bytes to and from a device: a serial port, or the simulated controller in this process.

    One thread uses it. Each method raises `PortLost` when the other side is gone.
    """

    @property
    def name(self) -> str:
        """How messages call this line."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of it; blocks at most the line's write timeout."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Received bytes, at least one; b"" after the timeout."""
        ...

    def discard_input(self) -> None:
        """Forget what has come and was not read."""
        ...

    def close(self) -> None:
        """Close the line; may be called more than once."""
        ...


class SerialPort:
    """A `Line` over pyserial: a device node, or any of its URLs (socket://, loop://).

    pyserial raises SerialException, a bare OSError (errno 5 from in_waiting after an unplug),
    termios.error (no OSError) and even TypeError (a port closed by another thread in mid-read):
    all of them mean that the port has gone.
    """

    def __init__(self, url: str, baud: int = 115200, write_timeout_s: float = 1.0) -> None:
        self._url = url
        try:
            # Exclusive, so that a second program cannot steal half of the replies.
            self._serial = serial.serial_for_url(
                url, baudrate=baud, timeout=0, write_timeout=write_timeout_s, exclusive=True
            )
        except (OSError, ValueError, serial.SerialException) as error:
            raise PortLost(f"{url}: cannot open the serial port: {_reason(error)}") from error

    @property
    def name(self) -> str:
        """The URL it was opened with."""
        return self._url

    def write(self, data: bytes) -> None:
        """Send all of it."""
        try:
            self._serial.write(data)
        except Exception as error:
            raise self._lost("write", error) from error

    def read(self, timeout_s: float) -> bytes:
        """At least one byte, with whatever came beside it; b"" after timeout_s."""
        try:
            waiting = self._serial.in_waiting
            if waiting:
                return bytes(self._serial.read(waiting))
            self._serial.timeout = max(timeout_s, 0.0)
            first = bytes(self._serial.read(1))
            if first and (waiting := self._serial.in_waiting):
                first += bytes(self._serial.read(waiting))
            return first
        except Exception as error:
            raise self._lost("read", error) from error

    def discard_input(self) -> None:
        """Forget what has come and was not read."""
        try:
            self._serial.reset_input_buffer()
        except Exception as error:
            raise self._lost("read", error) from error

    def close(self) -> None:
        """Give the port back."""
        try:
            self._serial.close()
        except Exception as error:
            raise self._lost("close", error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _lost(self, doing: str, error: Exception) -> PortLost:
        return PortLost(
            f"{self._url}: the serial port has gone (on {doing}): {_reason(error)}; check the cable"
        )


class LineReader:
    """Cuts what a `Line` delivers into lines; the rest of an unfinished one waits for the next call."""

    def __init__(self, line: Line, terminator: bytes = b"\n") -> None:
        self._line = line
        self._terminator = terminator
        self._buffer = bytearray()

    def read_line(self, deadline_s: float) -> bytes | None:
        """Next line without its terminator; None when `time.monotonic` passed deadline_s before its end."""
        while True:
            end = self._buffer.find(self._terminator)
            if end >= 0:
                line = bytes(self._buffer[:end])
                del self._buffer[: end + len(self._terminator)]
                return line
            remaining_s = deadline_s - time.monotonic()
            data = self._line.read(max(remaining_s, 0.0))
            self._buffer += data
            if len(self._buffer) > _BUFFER_MAX:
                del self._buffer[:-_BUFFER_MAX]
            if remaining_s <= 0 and self._terminator not in data:
                return None

    def clear(self) -> None:
        """Forget everything that has come so far."""
        self._line.discard_input()
        self._buffer.clear()


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__
