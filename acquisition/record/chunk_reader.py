"""Reads the bytes of a chunk, checks them, and splits them into messages."""

import struct
import zlib
from collections.abc import Iterator
from typing import IO, NamedTuple, TypeAlias

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

from acquisition.record.chunk_builder import MESSAGE_HEAD, MESSAGE_HEAD_DTYPE
from acquisition.record.chunk_places import ChunkPlace

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE_START = struct.Struct("<BQH")
_MESSAGE = int(Opcode.MESSAGE)
_LARGEST_CHUNK_BYTES = 2**31


class ChunkDamage(ValueError):
    """The chunk's bytes differ from what was written; the message describes how."""


PackedMessages: TypeAlias = NDArray[np.void] | list[bytes]
"""Contents of messages, the items of an array if their lengths are equal."""


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
    unpack, head_size = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
    for place, size in zip(*_places(data, channels), strict=True):
        _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
        content = data[place + head_size : place + head_size + size]
        yield RawMessage(channel, sequence, log_time_ns, content, place)


def packed_messages(data: bytes, channels: frozenset[int] | None = None) -> PackedMessages:
    """Contents of the messages that `messages_in` returns."""
    places, sizes = _places(data, channels)
    contents = np.array(places, dtype=np.int64) + MESSAGE_HEAD.size
    if len(set(sizes)) == 1:
        return _items(data, contents, sizes[0])
    return [data[place : place + size] for place, size in zip(contents.tolist(), sizes, strict=True)]


def message_heads(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Positions (n,) of the messages in a chunk, and their headers (n,) as rows of `MESSAGE_HEAD_DTYPE`.

    Raises ChunkDamage if a record is incomplete.
    """
    places = np.array(_places(data)[0], dtype=np.int64)
    return places, _items(data, places, MESSAGE_HEAD.size).view(MESSAGE_HEAD_DTYPE)


def _items(data: bytes, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copies of `size` bytes each, from the given positions in `data`."""
    # a view of the overlapping items that begin at each byte
    every: NDArray[np.void] = np.ndarray(
        (max(len(data) - size + 1, 0),), dtype=f"V{size}", buffer=data, strides=(1,)
    )
    return every[places]


def _places(data: bytes, channels: frozenset[int] | None = None) -> tuple[list[int], list[int]]:
    """Positions of the messages of the given channels in a chunk, and the sizes of their contents."""
    places, sizes = [], []
    place, end = 0, len(data)
    unpack, head_size = _MESSAGE_START.unpack_from, MESSAGE_HEAD.size
    while place + _MESSAGE_START.size <= end:
        opcode, length, channel = unpack(data, place)
        following = place + _HEAD.size + length
        if opcode == _MESSAGE and (channels is None or channel in channels):
            places.append(place)
            sizes.append(following - place - head_size)
        place = following
    if place != end or min(sizes, default=0) < 0:
        raise ChunkDamage("a record in it is incomplete")
    return places, sizes


def _decompressed(compression: bytes, data: bytes, size: int) -> bytes:
    try:
        chunk = Chunk(compression.decode(), data, 0, 0, 0, size)
        stream, length = get_chunk_data_stream(chunk)
        return bytes(stream.read(length))
    except Exception as error:
        # each decompressor raises its own exceptions for damaged data
        raise ChunkDamage(f"cannot be decompressed ({error})") from None
