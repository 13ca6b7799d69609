"""The records of an MCAP file: opcode, length, content. One is read, parsed, and judged by itself."""

import io
import struct
import zlib
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length of the content."""
CHUNK = struct.Struct("<QQQII")
"""First log time, last log time, bytes without compression, CRC, length of the compression's name."""
MESSAGE_INDEX = struct.Struct("<HI")
"""Channel, bytes of entries."""
INDEX_ENTRY_BYTES = 16
_SMALL_RECORD_BYTES = 256 * 1024 * 1024
_CLASSES: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}
_LENGTHS: dict[int, int] = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}
_CRC_BYTES = 4


def parse(opcode: int, data: bytes) -> Any:
    """A record of the mcap library from its bytes; None for a kind that is not needed here.

    Raises ValueError if the bytes are not such a record.
    """
    kind = _CLASSES.get(opcode)
    if kind is None:
        return None
    stream = ReadDataStream(io.BytesIO(data))
    try:
        record = kind.read(stream)
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


def read_record(file: IO[bytes], place: int) -> tuple[int, bytes]:
    """Opcode and content of the record at a position in the file. Raises ValueError if there is none."""
    file.seek(place)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        raise ValueError(f"no record at byte {place}")
    opcode, length = HEAD.unpack(head)
    if length > _SMALL_RECORD_BYTES:
        raise ValueError(f"record at byte {place} claims {length} bytes")
    data = file.read(length)
    if len(data) < length:
        raise ValueError(f"record at byte {place} ends early")
    return opcode, data


def check_form(opcode: int, data: bytes) -> None:
    """Raise ValueError if a record other than a chunk cannot have been written so."""
    if opcode == Opcode.MESSAGE_INDEX:
        if len(data) < MESSAGE_INDEX.size:
            raise ValueError("its index ends early")
        _, of_entries = MESSAGE_INDEX.unpack_from(data)
        if of_entries % INDEX_ENTRY_BYTES or len(data) != MESSAGE_INDEX.size + of_entries:
            raise ValueError("its index contradicts its length")
    elif opcode in _LENGTHS:
        if len(data) != _LENGTHS[opcode]:
            raise ValueError("its length is not that of its kind")
    elif opcode == Opcode.ATTACHMENT:
        intact_attachment(data)
    else:
        parse(opcode, data)
