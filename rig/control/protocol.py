"""Format of the lines between host and controller; see docs/controller.md.

    host  -> board   #<tag> <command>*<crc>
    board -> host    #<tag> OK[ <values>]*<crc>   or   #<tag> ERR <code>,"<text>"*<crc>
    board -> host    !<event>*<crc>               unsolicited: BOOT, TRIP, NAK

The tag (1 to 65535) identifies the command to which a reply belongs. The checksum is CRC-16/CCITT-FALSE of
everything before the asterisk, as four hexadecimal digits. A line ends with LF.
"""

import math
import re
from binascii import crc_hqx
from dataclasses import asdict, dataclass
from enum import StrEnum

from processing.ambient import is_possible
from processing.errors import DeviceError

LINE_MAX = 240
TAG_MAX = 65535
_REPLY = re.compile(r'#(\d{1,5}) (?:OK(?: (.*))?|ERR (-?\d+),"(.*)")')
_EVENT = re.compile(r"!(\S+)(?: (.*))?")


@dataclass(frozen=True, slots=True)
class Reply:
    """Reply to the command with this tag; `error_code` is 0 if it was executed."""

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
    """The line that sends a command.

    Raises
    ------
    ValueError
        The tag is not within 1 to 65535; the command is not one line of printable ASCII, or contains ``#`` or
        ``!``, which mark the beginning of a line.
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
    """Why the board switched its outputs off by itself, in the words of its protocol."""

    NONE = "NONE"
    WATCHDOG = "WATCHDOG"
    INTERLOCK = "INTERLOCK"
    OUTPUT = "OUTPUT"
    """The laser's output did not follow what it was set to."""
    POWER = "POWER"
    """The board has started."""


@dataclass(frozen=True, slots=True)
class Latch:
    """A trip that waits on the board for its acknowledgement; `lit` as the laser was when it came."""

    number: int
    cause: Trip
    lit: bool


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """Identity of the controller, and the power limit stored on it."""

    serial: str
    firmware: str
    laser_max_w: float


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """The board's outputs and inputs in its last reply to a heartbeat.

    `latch` is the trip that waits for its acknowledgement, `readback` whether the pin of the laser's relay is
    high, `light_seen` whether a photodiode sees light (None without one), `errors_waiting` the number
    of entries in its error queue.
    """

    uptime_ms: int
    interlock_closed: bool
    laser_on: bool
    laser_power_w: float
    magnet_on: bool
    starter_on: bool
    clamp_closed: bool
    brake_on: bool
    errors_waiting: int
    latch: Latch | None = None
    readback: bool = False
    light_seen: bool | None = None

    @property
    def trip(self) -> Trip:
        """Cause of the latched trip."""
        return Trip.NONE if self.latch is None else self.latch.cause


@dataclass(frozen=True, slots=True)
class AirReading:
    """Temperature, humidity and pressure of the air; NaN without a sensor."""

    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan

    @property
    def possible(self) -> "AirReading":
        """The same without what no air has: NaN for what a broken sensor or wire says."""
        return AirReading(
            **{name: value if is_possible(name, value) else math.nan for name, value in asdict(self).items()}
        )


def floats_of(values: str, count: int) -> list[float]:
    """So many numbers; raises DeviceError for anything else."""
    try:
        numbers = [float(value) for value in values.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise DeviceError(f"the controller answered {values!r}; {count} numbers were expected")
    return numbers


def status_of(values: str) -> ControllerStatus:
    """The answer to a heartbeat; raises DeviceError for anything else."""
    fields = values.split(",")
    if len(fields) != 14:
        raise DeviceError(f"the controller answered {values!r}; a status of 14 fields was expected")
    uptime_ms, interlock, laser, power_w, magnet, starter, clamp, brake, trip, errors, *latch = fields
    number, lit, readback, light = latch
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
    """Raises ValueError for what no power is: NaN would compare with nothing."""
    power_w = float(field)
    if not (math.isfinite(power_w) and power_w >= 0.0):
        raise ValueError(field)
    return power_w


def _is_one(field: str) -> bool:
    """Raises ValueError for anything but 0 and 1: an unknown state must not pass for dark or closed."""
    if field not in ("0", "1"):
        raise ValueError(field)
    return field == "1"
