"""Format of the lines: encoded lines can be decoded, damaged lines are rejected."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.firmware.lines import crc16
from rig.control.protocol import BoardEvent, Reply, checksum, decode, encode
from tests.rig.control.stepped import Clock, SteppedBoard

PRINTABLE = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="#!"), max_size=60)


def seal(body: bytes) -> bytes:
    return body + b"*%04X\n" % checksum(body)


@given(st.binary(max_size=100))
def test_checksum_is_the_published_one_on_both_sides(data: bytes) -> None:
    # Check value of CRC-16/CCITT-FALSE in the catalogues of CRC algorithms.
    assert checksum(b"123456789") == 0x29B1
    assert crc16(data) == checksum(data)


@given(st.integers(1, 65535), PRINTABLE.filter(lambda t: not t.startswith(("OK", "ERR"))))
def test_a_reply_comes_through(tag: int, values: str) -> None:
    reply = decode(seal(f"#{tag} OK {values}".encode()))
    assert reply == Reply(tag, values)


def test_refusals_and_events_are_told_apart() -> None:
    assert decode(seal(b'#7 ERR -222,"Data out of range"')) == Reply(7, "", -222, "Data out of range")
    assert decode(seal(b"#8 OK")) == Reply(8)
    assert decode(seal(b"!TRIP WATCHDOG")) == BoardEvent("TRIP", "WATCHDOG")


@given(st.binary(max_size=80))
def test_junk_is_never_believed(junk: bytes) -> None:
    if junk[-5:-4] != b"*":
        assert decode(junk) is None


@given(st.integers(1, 65535), st.data())
def test_a_spoilt_byte_is_noticed(tag: int, data: st.DataObject) -> None:
    line = bytearray(encode(tag, "LAS:POW 0.0005").rstrip(b"\n"))
    body_length = len(line) - 5
    position = data.draw(st.integers(1, body_length - 1))
    line[position] ^= data.draw(st.integers(1, 255))
    body = bytes(line[:body_length])
    # The checksum catches every error burst of up to 16 bits.
    assert b"%04X" % checksum(body) != bytes(line[-4:])


def test_reading_begins_at_the_last_tag() -> None:
    assert decode(b"#12 OK 3.1#13 OK" + seal(b"#13 OK")[6:]) == Reply(13)


@pytest.mark.parametrize(
    ("tag", "command", "said"),
    [
        *[(1, command, "is not a command") for command in ("LAS:POW 1\n", "A#B", "A!B", "µ")],
        *[(tag, "*IDN?", "tag") for tag in (0, 65536)],
    ],
)
def test_what_would_break_the_line_is_refused(tag: int, command: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        encode(tag, command)


def test_the_document_names_every_command_and_its_example_is_valid() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs" / "controller.md").read_text()
    assert encode(1, "SYST:SESS A1,1500").decode().strip() in text
    table = text.split("## Commands")[1].split("Status:")[0]
    documented: set[str] = set()
    command = ""
    for cell in re.findall(r"^\| (`.*?`(?:[, ]+`.*?`)*) \|", table, re.MULTILINE):
        for code in re.findall(r"`([^`]*)`", cell):
            if code == "?":
                documented.add(command + "?")
                continue
            command = code.split(" ")[0].upper()
            documented.add(command)
    firmware = SteppedBoard(Clock()).firmware
    known = set(firmware._free) | set(firmware._acting)
    assert documented <= known
    # Every action of the firmware is reached by a documented command.
    named = {**firmware._free, **firmware._acting}
    assert {id(named[command]) for command in documented} >= {id(action) for action in named.values()}
