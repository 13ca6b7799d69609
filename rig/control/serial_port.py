"""Reading and writing of a serial line with timeouts; every failure becomes a DeviceError."""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

import serial
from serial.tools import list_ports

from processing.errors import DeviceError

_WRITE_TIMEOUT_S = 1.0
_BUFFER_MAX = 65536
"""Largest number of bytes that are stored of a device that never ends a line."""


class PortLost(DeviceError):
    """The port is missing or was unplugged; opening it again may succeed."""


class ReplyTimeout(DeviceError):
    """A device answered neither a command nor its repetitions."""


class SerialLine(Protocol):
    """Bytes to and from a device: a serial port, or the simulated controller in this process.

    Only one thread may use it. Each method raises `PortLost` if the device is no longer connected.
    """

    @property
    def name(self) -> str:
        """Name of the line in messages."""
        ...

    def write(self, data: bytes) -> None:
        """Send all the data; blocks at most for the line's write timeout."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Received bytes, at least one; b"" after the timeout."""
        ...

    def discard_input(self) -> None:
        """Discard bytes that were received but not read."""
        ...

    def close(self) -> None:
        """Close the line; may be called more than once."""
        ...


class SerialPort:
    """A `SerialLine` over pyserial: a device node, or any of its URLs (socket://, loop://).

    pyserial raises SerialException, OSError (errno 5 from in_waiting after unplugging), termios.error (not an
    OSError) or TypeError (a port closed by another thread during a read): all of them become `PortLost`.
    """

    def __init__(self, url: str, baud: int = 115200) -> None:
        self._url = url
        try:
            # exclusive, because a second program would receive some of the replies
            self._serial = serial.serial_for_url(
                url, baudrate=baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S, exclusive=True
            )
        except (OSError, ValueError, serial.SerialException) as error:
            raise PortLost(f"{url}: cannot open the serial port: {_open_failure(error)}") from error

    @property
    def name(self) -> str:
        """The URL with which it was opened."""
        return self._url

    def write(self, data: bytes) -> None:
        """Send all the data."""
        with self._failing_as_loss("write"):
            self._serial.write(data)

    def read(self, timeout_s: float) -> bytes:
        """All received bytes, at least one; b"" after `timeout_s`."""
        with self._failing_as_loss("read"):
            if received_bytes := self._serial.in_waiting:
                return bytes(self._serial.read(received_bytes))
            self._serial.timeout = max(timeout_s, 0.0)
            data = bytes(self._serial.read(1))
            if data and (received_bytes := self._serial.in_waiting):
                data += bytes(self._serial.read(received_bytes))
            return data

    def discard_input(self) -> None:
        """Discard bytes that were received but not read."""
        with self._failing_as_loss("read"):
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        with self._failing_as_loss("close"):
            self._serial.close()

    @contextmanager
    def _failing_as_loss(self, operation: str) -> Iterator[None]:
        """Context in which any error of the library becomes `PortLost`."""
        try:
            yield
        except Exception as error:
            raise PortLost(
                f"{self._url}: the serial port is no longer available ({operation}): "
                f"{str(error) or type(error).__name__}; check the cable"
            ) from error


class LineReader:
    """Divides the bytes of a `SerialLine` into lines; an incomplete line is kept for the next call."""

    def __init__(self, line: SerialLine) -> None:
        self._line = line
        self._buffer = bytearray()

    def read_line(self, deadline_s: float) -> bytes | None:
        """Next line without its terminator; None if it has not ended by deadline_s (`time.monotonic`)."""
        while True:
            end = self._buffer.find(b"\n")
            if end >= 0:
                line = bytes(self._buffer[:end])
                del self._buffer[: end + 1]
                return line
            remaining_s = deadline_s - time.monotonic()
            data = self._line.read(max(remaining_s, 0.0))
            self._buffer += data
            if len(self._buffer) > _BUFFER_MAX:
                del self._buffer[:-_BUFFER_MAX]
            if remaining_s <= 0 and b"\n" not in data:
                return None

    @property
    def incomplete_line(self) -> bytes:
        """The bytes of a line that has not ended."""
        return bytes(self._buffer)

    def finds_line_start(self, deadline_s: float) -> bool:
        """Discard the rest of a line, in the middle of which the port may have been opened.

        True if the next byte begins a line: one has ended, or nothing came until `deadline_s`.
        """
        return self.read_line(deadline_s) is not None or not self._buffer

    def clear(self) -> None:
        """Discard everything received so far."""
        self._line.discard_input()
        self._buffer.clear()


def _open_failure(error: Exception) -> str:
    """The system's reason, without the port's name, which the library repeats, and the ports that exist."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open; end that program"
    if number == errno.EACCES:
        return "you may not open it; rig doctor --install-udev, as root, or the group dialout allows it"
    reason = os.strerror(number) if number else str(error) or type(error).__name__
    return f"{reason}; {ports_here()}"


def ports_here() -> str:
    """The serial ports of this computer in words, as the remedy for a wrong port."""
    devices: list[str] = []
    with suppress(OSError):
        devices = sorted(port.device for port in list_ports.comports())
    present = ", ".join(devices)
    return f"present are {present}" if present else "this computer has no serial port: plug the device in"
