"""Format of the lines between host and controller; see docs/controller.md.

    host  -> board   #<tag> <command>*<crc>
    board -> host    #<tag> OK[ <values>]*<crc>   or   #<tag> ERR <code>,"<text>"*<crc>
    board -> host    !<event>*<crc>               unsolicited: BOOT, TRIP, NAK

The tag (1 to 65535) identifies the command to which a reply belongs. The checksum is CRC-16/CCITT-FALSE of
everything before the asterisk, as four hexadecimal digits. A line ends with LF.
"""

import re
from binascii import crc_hqx
from dataclasses import dataclass

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
