"""Lines to and from a USB Test & Measurement instrument, over the Linux kernel's own driver (/dev/usbtmc*).

The kernel's driver is kept with the kernel and needs no package, so it was preferred to pyvisa-py and
python-usbtmc, which bring a USB library of their own and take the instrument away from it. Linux only.
"""

import contextlib
import math
import os
import secrets
import struct
import time
from collections import deque
from pathlib import Path

from processing.errors import DeviceError
from rig.control.protocol import TAG_MAX, BoardEvent, Reply, decode, encode
from rig.control.serial_port import LineReader, PortLost, SerialLine

try:
    import fcntl
except ImportError:  # pragma: no cover
    # a serial port of the same instrument works on every system
    fcntl = None  # type: ignore[assignment]

PREFIX = "usbtmc"
"""A port of this name is the only such instrument; with ``:SERIAL`` behind it the one of that number."""
_DEVICES = Path("/sys/class/usbmisc")
_CLEAR = 0x5B02
_SET_TIMEOUT = 0x40045B0A
"""_IO(91, 2) and _IOW(91, 10, __u32) of linux/usb/tmc.h."""
_LEAST_TIMEOUT_MS = 100
_ANSWER_BYTES = 4096


def is_usbtmc(port: str) -> bool:
    """Whether a port names a USBTMC instrument."""
    return port.partition(":")[0] == PREFIX or Path(port).name.startswith(PREFIX)


def find_usbtmc(port: str, vendor: int, devices: Path = _DEVICES) -> str:
    """The device node of an instrument; a path is returned as it is.

    Raises PortLost if there is none of this USB vendor and serial number, or several.
    """
    if port.partition(":")[0] != PREFIX:
        return port
    wanted = port.partition(":")[2]
    found = {}
    for node in sorted(devices.glob("usbtmc*")):
        # the class device belongs to an interface, whose parent is the USB device
        with contextlib.suppress(OSError, ValueError):
            usb = (node / "device").resolve().parent
            if int((usb / "idVendor").read_text(encoding="utf-8"), 16) == vendor:
                found[(usb / "serial").read_text(encoding="utf-8").strip()] = f"/dev/{node.name}"
    matching = {serial: path for serial, path in found.items() if wanted in ("", serial)}
    if len(matching) == 1:
        return next(iter(matching.values()))
    there = ", ".join(f"usbtmc:{serial}" for serial in found) or "none"
    raise PortLost(
        f"{port}: {len(matching)} USBTMC instruments of vendor {vendor:04x} fit, there is {there};"
        " name one, switch it on, and see that the kernel has its module usbtmc"
    )


class UsbTmcLine:
    """A `SerialLine` over /dev/usbtmc*: one message out, one message in.

    The kernel asks the instrument for an answer at each `read`; one is therefore made only after a query.
    """

    def __init__(self, path: str, timeout_s: float) -> None:
        self._path = path
        self._timeout_ms = 0
        self._answer_due = False
        self._fd = -1
        if fcntl is None:
            raise PortLost(f"{path}: USBTMC instruments are reached on Linux only")
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            # a second program would receive some of the answers
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._set_timeout(timeout_s)
        except PermissionError as error:
            self.close()
            raise PortLost(
                f"{path}: no permission; run rig doctor --install-udev, and plug the instrument in again"
            ) from error
        except OSError as error:
            self.close()
            raise PortLost(f"{path}: cannot open the instrument: {error.strerror or error}") from error

    @property
    def name(self) -> str:
        """The device node."""
        return self._path

    def write(self, data: bytes) -> None:
        """Send one message."""
        try:
            os.write(self._fd, data)
        except TimeoutError:
            # the caller gets no answer, and asks again
            self._clear()
        except OSError as error:
            raise self._lost("write", error) from error
        self._answer_due = b"?" in data

    def read(self, timeout_s: float) -> bytes:
        """The answer to the last message; b"" after the timeout, or if none was asked for."""
        if not self._answer_due:
            return b""
        try:
            self._set_timeout(timeout_s)
            answer = os.read(self._fd, _ANSWER_BYTES)
        except TimeoutError:
            self._clear()
            return b""
        except OSError as error:
            raise self._lost("read", error) from error
        self._answer_due = False
        return answer

    def discard_input(self) -> None:
        """Discard an answer that was not read."""
        if self._answer_due:
            self._clear()

    def close(self) -> None:
        """Close the device; may be called more than once."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            with contextlib.suppress(OSError):
                os.close(fd)

    def _clear(self) -> None:
        self._answer_due = False
        try:
            fcntl.ioctl(self._fd, _CLEAR)
        except TimeoutError:
            pass
        except OSError as error:
            raise self._lost("clear", error) from error

    def _set_timeout(self, timeout_s: float) -> None:
        timeout_ms = max(round(1000 * timeout_s), _LEAST_TIMEOUT_MS)
        if timeout_ms != self._timeout_ms:
            fcntl.ioctl(self._fd, _SET_TIMEOUT, struct.pack("@I", timeout_ms))
            self._timeout_ms = timeout_ms

    def _lost(self, doing: str, error: OSError) -> PortLost:
        return PortLost(
            f"{self._path}: the instrument is no longer available ({doing}): {error.strerror or error};"
            " check the cable"
        )


_SESSION_NEEDED = -203
_EVENTS_KEPT = 256
_LINES_WAITING = 64


class ReplyTimeout(DeviceError):
    """The controller answered neither a command nor its repetitions."""


class ControllerReset(DeviceError):
    """The controller was reset and has lost the session; the last command may not have been executed."""


class CommandRefused(DeviceError):
    """The controller rejected a command; `code` is from its list of errors."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class Link:
    """Sends one command at a time over a `SerialLine`; only one thread may use it."""

    def __init__(self, line: SerialLine, timeout_s: float = 0.2, retries: int = 2) -> None:
        self._line = line
        self._reader = LineReader(line)
        self._timeout_s = timeout_s
        self._retries = retries
        self._tag = 0
        self.repeat_until_s = math.inf
        """On `time.monotonic`: nothing is repeated later, and no reply is waited for."""
        self._events: deque[BoardEvent] = deque(maxlen=_EVENTS_KEPT)
        self._last_junk = b""
        self.junk_lines = 0
        self.late_replies = 0
        self.retried = 0

    @property
    def name(self) -> str:
        """Name of the line in messages."""
        return self._line.name

    def begin(self) -> None:
        """Discard what was received, end an incomplete line at the board, and choose a new tag.

        The first tag is random, so that a reply to an earlier program is not taken for a reply to this one.
        """
        self._reader.clear()
        self._events.clear()
        self._tag = secrets.randbelow(TAG_MAX)
        self._line.write(b"\n")

    def ask(self, command: str, timeout_s: float | None = None) -> str:
        """Send a command and return the values of its reply.

        Raises
        ------
        ReplyTimeout
            No valid reply within timeout_s, nor to the repetitions (each with the same timeout).
        CommandRefused
            The board rejected the command, or it contains characters that cannot be sent.
        ControllerReset
            The board was reset before or during the command.
        PortLost
            The line is no longer connected.
        """
        self._tag = self._tag % TAG_MAX + 1
        try:
            line = encode(self._tag, command)
        except ValueError as error:
            raise CommandRefused(f"{self._line.name}: {error}", 0) from None
        patience_s = self._timeout_s if timeout_s is None else timeout_s
        self._hear_what_waits()
        sent = 0
        for attempt in range(self._retries + 1):
            now_s = time.monotonic()
            deadline_s = now_s + patience_s
            if attempt:
                if now_s >= self.repeat_until_s:
                    break
                self.retried += 1
                deadline_s = min(deadline_s, self.repeat_until_s)
            self._line.write(line)
            sent += 1
            reply = self._await(self._tag, deadline_s)
            if reply is None:
                continue
            if reply.error_code == _SESSION_NEEDED:
                raise ControllerReset(
                    f"{self._line.name}: the controller has no session (reset, or its watchdog tripped)"
                    f" and rejected {command}; it is opened again with every output off"
                )
            if reply.error_code:
                raise CommandRefused(
                    f"{self._line.name}: the controller rejected {command}: {reply.error_text}"
                    f" ({reply.error_code})",
                    reply.error_code,
                )
            return reply.values
        raise ReplyTimeout(
            f"{self._line.name}: no reply to {command} within {patience_s:g} s,"
            f" sent {sent} time{'s' * (sent > 1)}: {self.heard};"
            " check port, cable, baud rate and that the controller runs"
        )

    @property
    def heard(self) -> str:
        """What came instead of a valid line."""
        junk = (self._last_junk or self._reader.unended).decode("latin-1").strip()
        return f"it sends {junk[:60]!r}, which is not a line of the controller" if junk else "it is silent"

    def take_events(self) -> tuple[BoardEvent, ...]:
        """Unsolicited messages of the board since the last call."""
        events = tuple(self._events)
        self._events.clear()
        return events

    def _hear_what_waits(self) -> None:
        """Read what arrived since the last command, so that an old NAK is not taken for a reply to a new
        one.
        """
        for _ in range(_LINES_WAITING):
            line = self._reader.read_line(0.0)
            if line is None:
                return
            self.late_replies += isinstance(self._hear(line), Reply)

    def _await(self, tag: int, deadline_s: float) -> Reply | None:
        while True:
            line = self._reader.read_line(deadline_s)
            if line is None:
                return None
            message = self._hear(line)
            if isinstance(message, Reply):
                if message.tag == tag:
                    return message
                self.late_replies += 1
            elif message is not None and message.name == "NAK":
                # The board received an invalid line, most likely this one: repeat it immediately.
                return None
            if time.monotonic() > deadline_s:
                # a device that sends without pause must not prevent the timeout
                return None

    def _hear(self, line: bytes) -> Reply | BoardEvent | None:
        message = decode(line)
        if message is None:
            if line.strip():
                self.junk_lines += 1
                self._last_junk = line[:60]
        elif isinstance(message, BoardEvent) and message.name != "NAK":
            self._events.append(message)
            if message.name == "BOOT":
                raise ControllerReset(
                    f"{self._line.name}: the controller was reset; it is opened again with every output off"
                )
        return message
