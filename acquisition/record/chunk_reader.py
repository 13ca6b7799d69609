"""Reads the bytes of a chunk, checks them, and splits them into messages.

A file of one megabyte can claim to hold gigabytes: what a chunk may unpack to is limited before that.
"""

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, NamedTuple, TypeAlias

import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquisition.record.chunk_builder import MESSAGE_HEAD, MESSAGE_HEAD_DTYPE
from acquisition.record.records import CHUNK, HEAD


class ChunkPlace(NamedTuple):
    """Position of a chunk in the file. `channels` are those listed in its index."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass
class ChunkPlaces:
    """Chunks in the order of the file, 34 bytes each: a record of one day has 200,000."""

    _numbers: "array[int]" = field(default_factory=lambda: array("Q"))
    _sets: "array[int]" = field(default_factory=lambda: array("H"))
    _known: dict[frozenset[int], int] = field(default_factory=dict)

    def append(self, place: ChunkPlace) -> None:
        """Add the next chunk."""
        self._numbers.extend(place[:4])
        self._sets.append(self._known.setdefault(place.channels, len(self._known)))

    def __len__(self) -> int:
        return len(self._sets)

    def __getitem__(self, index: int) -> ChunkPlace:
        at = 4 * range(len(self))[index]
        offset, length, start_ns, end_ns = self._numbers[at : at + 4]
        return ChunkPlace(offset, length, start_ns, end_ns, list(self._known)[self._sets[index]])

    def __iter__(self) -> Iterator[ChunkPlace]:
        channels = list(self._known)
        rows = zip(*[iter(self._numbers)] * 4, self._sets, strict=True)
        for offset, length, start_ns, end_ns, known in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[known])

    def extents(self) -> NDArray[np.uint64]:
        """(offset, length) of every chunk, a row each."""
        return np.array(self._numbers, dtype=np.uint64).reshape(-1, 4)[:, :2]


LARGEST_CHUNK_BYTES = 64 * 1024 * 1024
"""Without compression. The writer ends a chunk at 1 MiB, and a whole frame may stand at its end."""
_MESSAGE_START = struct.Struct("<BQH")
_MESSAGE = int(Opcode.MESSAGE)
_RECORDS_OF_A_CHUNK = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL), _MESSAGE})
_FEW_MESSAGES = 64
_UNPACKED_BYTES = 256 * 1024 * 1024
_UNPACKED_PER_BYTE = 256


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
    """Decompressed records of a chunk, and the range of log times stated in its header.

    `most_records` is how many there may be: each takes more than a byte of the compressed data.
    """

    data: bytes
    start_ns: int
    end_ns: int
    most_records: int


class UnpackLimit:
    """Bytes that the chunks of a file may take in one pass through it; whole sessions stay far below."""

    def __init__(self, file_bytes: int) -> None:
        self._left = _UNPACKED_BYTES + _UNPACKED_PER_BYTE * file_bytes

    def allows(self, count: int) -> bool:
        """Whether so many more may be unpacked."""
        self._left -= count
        return self._left >= 0


def open_chunk(file: IO[bytes], place: ChunkPlace) -> OpenedChunk:
    """Read and decompress a chunk. Raises ChunkDamage."""
    file.seek(place.offset)
    record = file.read(place.length)
    if len(record) < place.length or place.length < HEAD.size + CHUNK.size:
        raise ChunkDamage("ends early")
    opcode, length = HEAD.unpack_from(record)
    if opcode != Opcode.CHUNK or length != place.length - HEAD.size:
        raise ChunkDamage("its head has changed")
    start_ns, end_ns, size, crc, name_length = CHUNK.unpack_from(record, HEAD.size)
    data_at = HEAD.size + CHUNK.size + name_length + 8
    if size > LARGEST_CHUNK_BYTES or data_at > len(record):
        raise ChunkDamage("its head has changed")
    compression = record[HEAD.size + CHUNK.size : data_at - 8]
    (data_length,) = struct.unpack_from("<Q", record, data_at - 8)
    if data_at + data_length != len(record):
        raise ChunkDamage("its head has changed")
    data = _decompressed(compression, record[data_at:], size)
    if len(data) != size:
        raise ChunkDamage(f"has {len(data)} bytes, but its header states {size}")
    if crc not in (0, zlib.crc32(data)):
        raise ChunkDamage("its checksum does not match: bytes have changed")
    return OpenedChunk(data, start_ns, end_ns, _FEW_MESSAGES + data_length)


def messages_in(chunk: OpenedChunk, channels: frozenset[int] | None = None) -> Iterator[RawMessage]:
    """Messages of the given channels (None: all) in a chunk. Raises ChunkDamage if a record is incomplete."""
    data, unpack, head_size = chunk.data, MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
    for place, size in zip(*_places(chunk, channels), strict=True):
        _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
        content = data[place + head_size : place + head_size + size]
        yield RawMessage(channel, sequence, log_time_ns, content, place)


def packed_messages(chunk: OpenedChunk, channels: frozenset[int] | None) -> PackedMessages:
    """Contents of the messages that `messages_in` returns."""
    data = chunk.data
    places, sizes = _places(chunk, channels)
    contents = np.array(places, dtype=np.int64) + MESSAGE_HEAD.size
    if len(set(sizes)) == 1:
        return _items(data, contents, sizes[0])
    return [data[place : place + size] for place, size in zip(contents.tolist(), sizes, strict=True)]


def message_heads(chunk: OpenedChunk) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Positions (n,) of the messages in a chunk, and their headers (n,) as rows of `MESSAGE_HEAD_DTYPE`.

    Raises ChunkDamage if a record is incomplete.
    """
    places = np.array(_places(chunk)[0], dtype=np.int64)
    return places, _items(chunk.data, places, MESSAGE_HEAD.size).view(MESSAGE_HEAD_DTYPE)


def _items(data: bytes, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copies of `size` bytes each, from the given positions in `data`."""
    # a view of the overlapping items that begin at each byte
    every: NDArray[np.void] = np.ndarray(
        (max(len(data) - size + 1, 0),), dtype=f"V{size}", buffer=data, strides=(1,)
    )
    return every[places]


def _places(chunk: OpenedChunk, channels: frozenset[int] | None = None) -> tuple[list[int], list[int]]:
    """Positions of the messages of the given channels in a chunk, and the sizes of their contents."""
    places, sizes = [], []
    data = chunk.data
    place, end, left = 0, len(data), chunk.most_records
    unpack, head_size = _MESSAGE_START.unpack_from, MESSAGE_HEAD.size
    while place + _MESSAGE_START.size <= end:
        opcode, length, channel = unpack(data, place)
        following = place + HEAD.size + length
        left -= 1
        if opcode not in _RECORDS_OF_A_CHUNK or left < 0:
            break
        if opcode == _MESSAGE and (channels is None or channel in channels):
            places.append(place)
            sizes.append(following - place - head_size)
        place = following
    if place != end or min(sizes, default=0) < 0:
        raise ChunkDamage("a record in it is incomplete, or there are more than it can hold")
    return places, sizes


def _decompressed(compression: bytes, data: bytes, size: int) -> bytes:
    if compression == b"":
        return data
    if compression != b"zstd":
        raise ChunkDamage(f"its compression {compression!r} is not that of rig run")
    try:
        if zstandard.get_frame_parameters(data).content_size != size:
            raise ChunkDamage("its head and its data state different sizes")
        return zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK_BYTES).decompress(data)
    except zstandard.ZstdError as error:
        raise ChunkDamage(f"cannot be decompressed ({error})") from None
