"""Reads the bytes of a chunk, checks them, and splits them into messages."""

import struct
import zlib
from collections.abc import Iterator
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from acquisition.record.chunk_builder import MESSAGE_HEAD
from acquisition.record.contents import ChunkPlace

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_LARGEST_CHUNK_BYTES = 2**31


class ChunkDamage(ValueError):
    """The chunk's bytes differ from what was written; the message describes how."""


class RawMessage(NamedTuple):
    """An encoded message; `offset` is its position in the chunk in bytes."""

    channel: int
    sequence: int
    log_time_ns: int
    data: bytes
    offset: int


class OpenedChunk(NamedTuple):
    """Decompressed records of a chunk, and the range of log times stated in its header."""

    data: bytes
    start_ns: int
    end_ns: int


def open_chunk(file: IO[bytes], place: ChunkPlace, *, validate_crc: bool = True) -> OpenedChunk:
    """Read and decompress a chunk. Raises ChunkDamage."""
    file.seek(place.offset)
    record = file.read(place.length)
    if len(record) < place.length or place.length < _HEAD.size + _CHUNK.size:
        raise ChunkDamage("ends early")
    opcode, length = _HEAD.unpack_from(record)
    if opcode != Opcode.CHUNK or length != place.length - _HEAD.size:
        raise ChunkDamage("its head has changed")
    start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(record, _HEAD.size)
    data_at = _HEAD.size + _CHUNK.size + name_length + 8
    if size > _LARGEST_CHUNK_BYTES or data_at > len(record):
        raise ChunkDamage("its head has changed")
    compression = record[_HEAD.size + _CHUNK.size : data_at - 8]
    (data_length,) = struct.unpack_from("<Q", record, data_at - 8)
    if data_at + data_length != len(record):
        raise ChunkDamage("its head has changed")
    data = _decompressed(compression, record[data_at:], size)
    if len(data) != size:
        raise ChunkDamage(f"has {len(data)} bytes, but its header states {size}")
    if validate_crc and crc not in (0, zlib.crc32(data)):
        raise ChunkDamage("its checksum does not match: bytes have changed")
    return OpenedChunk(data, start_ns, end_ns)


def messages_in(data: bytes, channels: frozenset[int] | None = None) -> Iterator[RawMessage]:
    """Messages of the given channels (None: all) in a chunk. Raises ChunkDamage if a record is incomplete."""
    place, end = 0, len(data)
    unpack, head_size, body = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, _HEAD.size
    while place < end:
        opcode, length = _HEAD.unpack_from(data, place) if place + body <= end else (0, end)
        following = place + body + length
        if following > end:
            raise ChunkDamage("a record in it is incomplete")
        if opcode == Opcode.MESSAGE:
            _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
            if channels is None or channel in channels:
                yield RawMessage(channel, sequence, log_time_ns, data[place + head_size : following], place)
        place = following


def _decompressed(compression: bytes, data: bytes, size: int) -> bytes:
    try:
        chunk = Chunk(compression.decode(), data, 0, 0, 0, size)
        stream, length = get_chunk_data_stream(chunk)
        return bytes(stream.read(length))
    except Exception as error:
        # each decompressor raises its own exceptions for damaged data
        raise ChunkDamage(f"cannot be decompressed ({error})") from None
