"""Leader and trailer packets of a frame, and the registers that set up the stream."""

import contextlib
import struct
from dataclasses import dataclass
from typing import Final

from acquisition.cameras.usb3vision.gencp import GenCpChannel, RegisterRefused
from processing.errors import DeviceError

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
    """Packet before a frame."""

    block: int
    timestamp: int
    """The camera's clock in ns."""
    pixel_format: int
    width_px: int
    height_px: int
    x_padding: int
    """Bytes after each row."""


@dataclass(frozen=True, slots=True)
class Trailer:
    """Packet after a frame."""

    block: int
    status: int
    """Zero for a complete frame."""
    valid_bytes: int
    """Size of the frame."""


def parse_leader(raw: bytes) -> Leader | None:
    """The leader in these bytes; None if they are not the leader of an image."""
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


# Technology-agnostic bootstrap registers (ABRM), at absolute addresses
_MANUFACTURER: Final = 0x0004
_MODEL: Final = 0x0044
_SERIAL: Final = 0x0144
_TEXT_LENGTH: Final = 64
_MAX_RESPONSE_TIME_MS: Final = 0x01CC
_MANIFEST_ADDRESS: Final = 0x01D0
_SBRM_ADDRESS: Final = 0x01D8
_TIMESTAMP_INCREMENT: Final = 0x01FC

# USB3 Vision bootstrap registers (SBRM), relative to their base
_MAX_COMMAND: Final = 0x14
_MAX_REPLY: Final = 0x18
_SIRM_ADDRESS: Final = 0x20
_EIRM_ADDRESS: Final = 0x2C

# Stream interface registers (SIRM), relative to their base
_STREAM_INFO: Final = 0x00
_STREAM_CONTROL: Final = 0x04
_STREAM_REQUIRED_PAYLOAD: Final = 0x08
_STREAM_REQUIRED_LEADER: Final = 0x10
_STREAM_REQUIRED_TRAILER: Final = 0x14
_STREAM_HOST_SIZES: Final = 0x18

_USUAL_PACKET: Final = 1024


@dataclass(frozen=True, slots=True)
class Identity:
    """Contents of the bootstrap registers."""

    vendor: str
    model: str
    serial: str
    manifest_address: int
    stream_address: int
    event_address: int
    timestamp_increment_ns: int
    """Resolution of the timestamps, 0 for a camera without a clock; their unit is always ns (GenCP 1.3.1,
    5.4.16 and 5.4.18)."""


@dataclass(frozen=True, slots=True)
class TransferPlan:
    """Sizes in bytes of the bulk transfers of one frame, multiples of the camera's alignment."""

    leader: int
    payload_size: int
    payload_count: int
    """Number of transfers of `payload_size`, with which the payload begins."""
    final_1: int
    final_2: int
    """Last two transfers of the payload; either may be 0."""
    trailer: int

    @property
    def payload(self) -> tuple[int, ...]:
        """Sizes of the payload's transfers, in order."""
        finals = tuple(size for size in (self.final_1, self.final_2) if size)
        return (self.payload_size,) * self.payload_count + finals


def plan_transfers(
    payload: int, leader: int, trailer: int, alignment: int, largest_transfer: int
) -> TransferPlan:
    """Divide a payload of `payload` bytes into transfers of at most `largest_transfer` bytes.

    The sizes of leader, trailer and the last part of the payload are rounded up to a multiple of `alignment`.
    """

    def aligned(size: int) -> int:
        return -(-size // alignment) * alignment

    size = max(min(largest_transfer, payload) // alignment, 1) * alignment
    count, rest = divmod(payload, size)
    final_1 = rest // alignment * alignment
    final_2 = aligned(rest - final_1)
    return TransferPlan(aligned(leader), size if count else 0, count, final_1, final_2, aligned(trailer))


def _text(channel: GenCpChannel, address: int) -> str:
    raw = channel.read(address, _TEXT_LENGTH)
    return raw.split(b"\0", 1)[0].decode("utf-8", "replace").strip()


def _u32(channel: GenCpChannel, address: int) -> int:
    return int.from_bytes(channel.read(address, 4), "little")


def _u64(channel: GenCpChannel, address: int) -> int:
    return int.from_bytes(channel.read(address, 8), "little")


def read_identity(channel: GenCpChannel) -> Identity:
    """Read the bootstrap registers, and set the channel to the camera's own packet sizes."""
    sbrm = _u64(channel, _SBRM_ADDRESS)
    response_time_s = _u32(channel, _MAX_RESPONSE_TIME_MS) / 1000.0
    increment_ns = 0
    with contextlib.suppress(RegisterRefused):
        # a camera without a clock need not have the register
        increment_ns = _u64(channel, _TIMESTAMP_INCREMENT)
    channel.set_limits(_u32(channel, sbrm + _MAX_COMMAND), _u32(channel, sbrm + _MAX_REPLY), response_time_s)
    return Identity(
        vendor=_text(channel, _MANUFACTURER),
        model=_text(channel, _MODEL),
        serial=_text(channel, _SERIAL),
        manifest_address=_u64(channel, _MANIFEST_ADDRESS),
        stream_address=_u64(channel, sbrm + _SIRM_ADDRESS),
        event_address=_u64(channel, sbrm + _EIRM_ADDRESS),
        # a resolution of 1 s or more is no usable clock, and probably not the content of this register
        timestamp_increment_ns=increment_ns if increment_ns < 1_000_000_000 else 0,
    )


def silence_events(channel: GenCpChannel, event_address: int) -> None:
    """Switch the event endpoint off, because it is never read, and some cameras stall when it is full."""
    if event_address:
        # a camera that rejects the command has no events to send
        with contextlib.suppress(RegisterRefused):
            channel.write(event_address, struct.pack("<I", 0))


class StreamRegisters:
    """Registers of one camera's stream interface."""

    def __init__(self, channel: GenCpChannel, address: int, name: str) -> None:
        self._channel = channel
        self._address = address
        self._name = name

    def set_up(self, payload_limit: int, largest_transfer: int) -> TransferPlan:
        """Read the size of a frame, write the sizes of the transfers, and return these.

        The stream must be off. Raises DeviceError if the registers contain impossible sizes.
        """
        base = self._address
        alignment = 1 << (_u32(self._channel, base + _STREAM_INFO) >> 24)
        payload = _u64(self._channel, base + _STREAM_REQUIRED_PAYLOAD)
        # some cameras state 0 after they were plugged in
        leader = _u32(self._channel, base + _STREAM_REQUIRED_LEADER) or _USUAL_PACKET
        trailer = _u32(self._channel, base + _STREAM_REQUIRED_TRAILER) or _USUAL_PACKET
        if not 0 < payload <= payload_limit or not 0 < leader <= 65536 or not 0 < trailer <= 65536:
            raise DeviceError(
                f"{self._name}: requires frames of {payload} bytes with a leader of {leader} and a trailer "
                f"of {trailer} bytes; reduce Width and Height, or unplug the camera and plug it in again"
            )
        if alignment > 65536:
            raise DeviceError(
                f"{self._name}: aligns its stream to {alignment} bytes, which is not possible; "
                "unplug the camera and plug it in again"
            )
        # packets have at most 1024 bytes: with multiples of that, no packet overruns a buffer
        plan = plan_transfers(payload, leader, trailer, max(alignment, 1024), largest_transfer)
        sizes = (plan.leader, plan.payload_size, plan.payload_count, plan.final_1, plan.final_2, plan.trailer)
        self._channel.write(base + _STREAM_HOST_SIZES, struct.pack("<6I", *sizes))
        return plan

    def enable(self, on: bool) -> None:
        """Switch the sending of frames to the stream endpoint on or off."""
        self._channel.write(self._address + _STREAM_CONTROL, struct.pack("<I", int(on)))
