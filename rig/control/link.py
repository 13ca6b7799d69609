"""Commands to the controller and its replies over a line: tags, checksums, timeouts, repetitions.

It is safe to repeat a command: the board executes a line with a given tag once and answers a repetition from
memory. A board that was reset in between has lost its session and rejects the command. A pulse is therefore
never given twice.
"""

import math
import secrets
import time
from collections import deque

from processing.errors import DeviceError
from rig.control.protocol import TAG_MAX, BoardEvent, Reply, decode, encode
from rig.control.serial_port import LineReader, SerialLine

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
