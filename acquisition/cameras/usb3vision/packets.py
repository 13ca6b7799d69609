"""Leader and trailer, the packets that a camera sends before and after the bytes of a frame."""

import struct
from dataclasses import dataclass
from typing import Final

LEADER_MAGIC: Final = 0x4C563355  # "U3VL"
TRAILER_MAGIC: Final = 0x54563355  # "U3VT"
TRAILER_START: Final = TRAILER_MAGIC.to_bytes(4, "little")
_LEADER: Final = struct.Struct("<IHHQHHQIIIIIHH")
_MAGIC_TO_TYPE: Final = struct.Struct("<IHHQHH")
_TRAILER: Final = struct.Struct("<IHHQHHQ")
# payload types that begin with a plain image; in the second, chunk data follow it
_IMAGE_TYPES: Final = {0x0001, 0x4001}


@dataclass(frozen=True, slots=True)
class Leader:
    """Packet before a frame; `timestamp` is the camera's clock in ns, `x_padding` in bytes per line."""

    block: int
    timestamp: int
    pixel_format: int
    width_px: int
    height_px: int
    x_padding: int


@dataclass(frozen=True, slots=True)
class Trailer:
    """Packet after a frame; `status` is 0 if the frame is complete, `valid_bytes` its number of bytes."""

    block: int
    status: int
    valid_bytes: int


def parse_leader(raw: bytes) -> Leader | None:
    """The leader in these bytes; None if they are not a leader, or not one of an image."""
    if len(raw) < _LEADER.size:
        return None
    magic, _, size, block, _, kind, timestamp, pixel_format, width, height, _, _, padding, _ = (
        _LEADER.unpack_from(raw)
    )
    if magic != LEADER_MAGIC or size < _LEADER.size or size > len(raw) or kind not in _IMAGE_TYPES:
        return None
    return Leader(block, timestamp, pixel_format, width, height, padding)


def announced_type(raw: bytes) -> int | None:
    """Payload type of a complete leader, also if it is not an image; None if these bytes are not a leader."""
    if len(raw) < _MAGIC_TO_TYPE.size:
        return None
    magic, _, size, _, _, kind = _MAGIC_TO_TYPE.unpack_from(raw)
    return int(kind) if magic == LEADER_MAGIC and _MAGIC_TO_TYPE.size <= size <= len(raw) else None


def parse_trailer(raw: bytes) -> Trailer | None:
    """The trailer in these bytes; None if they are not a trailer."""
    if len(raw) < _TRAILER.size:
        return None
    magic, _, size, block, status, _, valid = _TRAILER.unpack_from(raw)
    if magic != TRAILER_MAGIC or size < _TRAILER.size or size > len(raw):
        return None
    return Trailer(block, status, valid)
