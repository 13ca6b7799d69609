"""Lines between host and controller: their format (docs/controller.md), and the link that sends them.

    host  -> board   #<tag> <command>*<crc>
    board -> host    #<tag> OK[ <values>]*<crc>   or   #<tag> ERR <code>,"<text>"*<crc>
    board -> host    !<event>*<crc>               unsolicited: BOOT, TRIP, NAK

The tag (1 to 65535) identifies the command to which a reply belongs. The checksum is CRC-16/CCITT-FALSE of
everything before the asterisk, as four hexadecimal digits. A line ends with LF.
"""

import math
import re
import secrets
import time
from binascii import crc_hqx
from collections import deque
from dataclasses import asdict, dataclass
from enum import StrEnum

from acquisition.frames.queue import take_all
from processing.ambient import is_possible
from processing.errors import DeviceError
from rig.control.serial_port import LineReader, ReplyTimeout, SerialLine

LINE_MAX = 240
TAG_MAX = 65535
_REPLY = re.compile(r'#(\d{1,5}) (?:OK(?: (.*))?|ERR (-?\d+),"(.*)")')
_EVENT = re.compile(r"!(\S+)(?: (.*))?")


@dataclass(frozen=True, slots=True)
class Reply:
    """Reply to the command with this tag; `error_code` is 0 if the command was executed."""

    tag: int
    values: str = ""
    error_code: int = 0
    error_text: str = ""


@dataclass(frozen=True, slots=True)
class BoardEvent:
    """A message that the board sends without a command."""

    name: str
    detail: str = ""


def checksum(body: bytes) -> int:
    """CRC-16/CCITT-FALSE; of b"123456789" it is 0x29B1."""
    return crc_hqx(body, 0xFFFF)


def encode(tag: int, command: str) -> bytes:
    """The line that sends a command; raises ValueError for a tag or a command that cannot be sent.

    A command is one line of printable ASCII without ``#`` and ``!``, which mark the beginning of a line.
    """
    if not 1 <= tag <= TAG_MAX:
        raise ValueError(f"tag {tag} is not within 1 to {TAG_MAX}")
    if not (command.isascii() and command.isprintable()) or "#" in command or "!" in command:
        raise ValueError(
            f"{command!r} is not a command: one line of printable ASCII without # and ! is needed"
        )
    body = f"#{tag} {command}".encode("ascii")
    return body + b"*%04X\n" % checksum(body)


def decode(line: bytes) -> Reply | BoardEvent | None:
    """Parse a line from the board; None for a line without a valid checksum.

    Parsing begins at the last ``#`` or ``!``, because a line whose end was lost may precede a complete one.
    """
    line = line.rstrip(b"\r\n")
    line = line[max(line.rfind(b"#"), line.rfind(b"!"), 0) :]
    body, star, digits = line[:-5], line[-5:-4], line[-4:]
    if star != b"*" or digits != b"%04X" % checksum(body):
        return None
    text = body.decode("latin-1")
    if match := _REPLY.fullmatch(text):
        tag, values, code, message = match.groups()
        return Reply(int(tag), values or "", int(code or 0), message or "")
    if match := _EVENT.fullmatch(text):
        return BoardEvent(match[1], match[2] or "")
    return None


class Trip(StrEnum):
    """Reasons why the board switched its outputs off by itself, in the words of its protocol."""

    NONE = "NONE"
    WATCHDOG = "WATCHDOG"
    INTERLOCK = "INTERLOCK"
    OUTPUT = "OUTPUT"
    """The laser's output did not follow its setting."""
    POWER = "POWER"
    """The board has started."""


@dataclass(frozen=True, slots=True)
class Latch:
    """A trip that waits on the board for its acknowledgement."""

    number: int
    cause: Trip
    lit: bool
    """Whether the laser was on when the trip occurred."""


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """Identity of the controller, and the power limit stored on it."""

    serial: str
    firmware: str
    laser_max_w: float


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """The board's outputs and inputs in its last reply to a heartbeat."""

    uptime_ms: int
    interlock_closed: bool
    laser_on: bool
    laser_power_w: float
    magnet_on: bool
    starter_on: bool
    clamp_closed: bool
    brake_on: bool
    errors_waiting: int
    """Number of entries in the board's error queue."""
    latch: Latch | None = None
    """The trip that waits for its acknowledgement."""
    readback: bool = False
    """Whether the pin of the laser's relay is high."""
    light_seen: bool | None = None
    """Whether a photodiode sees light; None without one."""

    @property
    def trip(self) -> Trip:
        """Cause of the latched trip."""
        return Trip.NONE if self.latch is None else self.latch.cause


@dataclass(frozen=True, slots=True)
class AmbientReading:
    """Ambient temperature, humidity and pressure; NaN for a quantity that is not measured."""

    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan

    @property
    def possible(self) -> "AmbientReading":
        """The reading with NaN for impossible values, which a broken sensor or wire causes."""
        return AmbientReading(
            **{name: value if is_possible(name, value) else math.nan for name, value in asdict(self).items()}
        )


def floats_of(values: str, count: int) -> list[float]:
    """The `count` numbers of a reply; raises DeviceError for anything else."""
    try:
        numbers = [float(value) for value in values.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise DeviceError(f"the controller answered {values!r}; {count} numbers were expected")
    return numbers


def status_of(values: str) -> ControllerStatus:
    """The status in the reply to a heartbeat; raises DeviceError for anything else."""
    fields = values.split(",")
    if len(fields) != 14:
        raise DeviceError(f"the controller answered {values!r}; a status of 14 fields was expected")
    uptime_ms, interlock, laser, power_w, magnet, starter, clamp, brake, trip, errors, *rest = fields
    number, lit, readback, light = rest
    try:
        return ControllerStatus(
            latch=Latch(int(number), Trip(trip), _is_one(lit)) if number != "0" else None,
            readback=_is_one(readback),
            light_seen=None if light == "-" else _is_one(light),
            uptime_ms=int(uptime_ms),
            interlock_closed=_is_one(interlock),
            laser_on=_is_one(laser),
            laser_power_w=_power(power_w),
            magnet_on=_is_one(magnet),
            starter_on=_is_one(starter),
            clamp_closed=_is_one(clamp),
            brake_on=_is_one(brake),
            errors_waiting=int(errors),
        )
    except ValueError:
        raise DeviceError(f"the controller answered {values!r}, which is not a status") from None


def _power(field: str) -> float:
    """A power in W; ValueError for an impossible one, and for NaN, with which every comparison is false."""
    power_w = float(field)
    if not (math.isfinite(power_w) and power_w >= 0.0):
        raise ValueError(field)
    return power_w


def _is_one(field: str) -> bool:
    """Whether a field is 1; ValueError unless 0 or 1: an unknown state must not count as dark or closed."""
    if field not in ("0", "1"):
        raise ValueError(field)
    return field == "1"


_SESSION_NEEDED = -203
_MAX_EVENTS = 256
_MAX_EARLIER_LINES = 64


class ControllerReset(DeviceError):
    """The controller was reset and has lost the session; the last command may not have been executed."""


class CommandRefused(DeviceError):
    """The controller rejected a command."""


class Link:
    """Sends one command at a time over a `SerialLine`; only one thread may use it."""

    def __init__(self, line: SerialLine, timeout_s: float = 0.2, retries: int = 2) -> None:
        self._line = line
        self._reader = LineReader(line)
        self._timeout_s = timeout_s
        self._retries = retries
        self._tag = 0
        self.repeat_until_s = math.inf
        """Time (`time.monotonic`) after which no command is repeated and no reply is waited for."""
        self._events: deque[BoardEvent] = deque(maxlen=_MAX_EVENTS)
        self._last_junk = b""

    @property
    def name(self) -> str:
        """Name of the line in messages."""
        return self._line.name

    def begin(self) -> None:
        """Discard the received bytes, end an incomplete line at the board, and choose a new tag.

        The first tag is random, so that a reply to an earlier program is not taken for a reply to this one.
        """
        self._reader.clear()
        self._events.clear()
        self._tag = secrets.randbelow(TAG_MAX)
        self._line.write(b"\n")

    def ask(self, command: str) -> str:
        """Send a command and return the values of its reply.

        Raises `ReplyTimeout` without a valid reply in time, also to the repetitions;
        `CommandRefused` if the board rejects the command, or it cannot be sent; `ControllerReset` if the
        board was reset before or during it; `PortLost` if the line is not connected any more.
        """
        self._tag = self._tag % TAG_MAX + 1
        try:
            line = encode(self._tag, command)
        except ValueError as error:
            raise CommandRefused(f"{self._line.name}: {error}") from None
        self._take_earlier_lines()
        send_count = 0
        for attempt in range(self._retries + 1):
            now_s = time.monotonic()
            deadline_s = now_s + self._timeout_s
            if attempt:
                if now_s >= self.repeat_until_s:
                    break
                deadline_s = min(deadline_s, self.repeat_until_s)
            self._line.write(line)
            send_count += 1
            reply = self._wait_for_reply(self._tag, deadline_s)
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
                    f" ({reply.error_code})"
                )
            return reply.values
        raise ReplyTimeout(
            f"{self._line.name}: no reply to {command} within {self._timeout_s:g} s,"
            f" sent {send_count} time{'s' * (send_count > 1)}: {self.received_text};"
            " check port, cable, baud rate and that the controller runs"
        )

    @property
    def received_text(self) -> str:
        """Description of the bytes that were received instead of a valid line, for messages."""
        junk = (self._last_junk or self._reader.incomplete_line).decode("latin-1").strip()
        return f"it sends {junk[:60]!r}, which is not a line of the controller" if junk else "it is silent"

    def take_events(self) -> tuple[BoardEvent, ...]:
        """Unsolicited messages of the board since the last call."""
        return tuple(take_all(self._events))

    def _take_earlier_lines(self) -> None:
        """Take lines that came since the last command, so that an old NAK does not count as a new reply."""
        for _ in range(_MAX_EARLIER_LINES):
            line = self._reader.read_line(0.0)
            if line is None:
                return
            self._decode(line)

    def _wait_for_reply(self, tag: int, deadline_s: float) -> Reply | None:
        while True:
            line = self._reader.read_line(deadline_s)
            if line is None:
                return None
            message = self._decode(line)
            if isinstance(message, Reply):
                if message.tag == tag:
                    return message
            elif message is not None and message.name == "NAK":
                # the board received an invalid line, most likely this one, which is repeated immediately
                return None
            if time.monotonic() > deadline_s:
                # a device that sends without pause must not prevent the timeout
                return None

    def _decode(self, line: bytes) -> Reply | BoardEvent | None:
        message = decode(line)
        if message is None:
            if line.strip():
                self._last_junk = line[:60]
        elif isinstance(message, BoardEvent) and message.name != "NAK":
            self._events.append(message)
            if message.name == "BOOT":
                raise ControllerReset(
                    f"{self._line.name}: the controller was reset; it is opened again with every output off"
                )
        return message
