"""The records of an MCAP file: opcode, length, content. One is read and parsed by itself."""

import errno
import hashlib
import io
import struct
import zlib
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Header, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length of the content."""
ZSTD = b"zstd"
"""Name of the compression, always this one."""
CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
"""Opcode, length, first and last log time, bytes without compression, CRC of these, length of the
compression's name, the name, compressed bytes, which follow.
"""
INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode and length of a chunk's message index, channel, bytes of entries, which follow."""
INDEX_ENTRY_BYTES = 16
OWN_SHA256 = "sha256"
"""Key in a channel's metadata: SHA-256 of its description, for which MCAP has no checksum."""
_SMALL_RECORD_BYTES = 256 * 1024 * 1024
_CLASSES: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
}
_CRC_BYTES = 4
_FAULTS = {errno.EIO, getattr(errno, "EUCLEAN", errno.EIO), getattr(errno, "EBADMSG", errno.EIO)}


def parse(opcode: int, data: bytes) -> Any:
    """A record of the mcap library from its bytes. Raises ValueError if they are not such a record."""
    stream = ReadDataStream(io.BytesIO(data))
    try:
        record = _CLASSES[opcode].read(stream)
    except (struct.error, UnicodeDecodeError, OverflowError, McapError) as error:
        raise ValueError(str(error) or type(error).__name__) from None
    if stream.count != len(data):
        raise ValueError("its lengths contradict each other")
    return record


def intact_attachment(data: bytes) -> bytes:
    """What is attached, from the content of the record. Raises ValueError if its checksum does not match."""
    attachment: Attachment = parse(Opcode.ATTACHMENT, data)
    if zlib.crc32(data[:-_CRC_BYTES]) != int.from_bytes(data[-_CRC_BYTES:], "little"):
        raise ValueError("its checksum does not match: bytes have changed")
    return attachment.data


def read_at(file: IO[bytes], place: int, count: int) -> bytes:
    """Bytes of a file; none where its disk cannot give some of them, as exFAT's after a power cut."""
    file.seek(place)
    try:
        return file.read(count)
    except OSError as error:
        # a disk that was pulled out is no damage
        if error.errno not in _FAULTS:
            raise
        return b""


def read_record(file: IO[bytes], place: int) -> tuple[int, bytes]:
    """Opcode and content of the record at a position in the file. Raises ValueError if there is none."""
    head = read_at(file, place, HEAD.size)
    if len(head) < HEAD.size:
        raise ValueError(f"no record at byte {place}")
    opcode, length = HEAD.unpack(head)
    if length > _SMALL_RECORD_BYTES:
        raise ValueError(f"record at byte {place} claims {length} bytes")
    data = read_at(file, place + HEAD.size, length)
    if len(data) < length:
        raise ValueError(f"record at byte {place} ends early")
    return opcode, data


def sha256_of_description(channel: Channel, schema: Schema) -> str:
    """Hexadecimal SHA-256 over everything that says how a topic's messages are read."""
    parts = [channel.id, channel.topic, channel.message_encoding, schema.id, schema.name, schema.encoding]
    return hashlib.sha256(repr(parts).encode() + schema.data).hexdigest()
