"""Reads the bytes of a chunk, checks them, and splits them into messages."""

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquisition.record.chunk_builder import MESSAGE_HEAD, MESSAGE_HEAD_DTYPE
from acquisition.record.records import CHUNK_HEAD, HEAD, ZSTD, read_at


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

    def __iter__(self) -> Iterator[ChunkPlace]:
        channels = list(self._known)
        rows = zip(*[iter(self._numbers)] * 4, self._sets, strict=True)
        for offset, length, start_ns, end_ns, known in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[known])


_MESSAGE_START = struct.Struct("<BQH")


class ChunkDamage(ValueError):
    """The chunk's bytes differ from what was written; the message describes how."""


class Message(NamedTuple):
    """An encoded message; `log_time_ns` is UTC."""

    channel: int
    sequence: int
    log_time_ns: int
    data: bytes


def open_chunk(file: IO[bytes], place: ChunkPlace) -> bytes:
    """The decompressed messages of a chunk. Raises ChunkDamage."""
    record = read_at(file, place.offset, place.length)
    if len(record) < place.length or place.length < CHUNK_HEAD.size:
        raise ChunkDamage("ends early, or its disk cannot give all of it")
    opcode, length, _, _, size, crc, *name, data_length = CHUNK_HEAD.unpack_from(record)
    compressed = record[CHUNK_HEAD.size :]
    stated = (opcode, length, *name, data_length)
    if stated != (Opcode.CHUNK, place.length - HEAD.size, len(ZSTD), ZSTD, len(compressed)):
        raise ChunkDamage("its head has changed")
    try:
        # one changed bit of either size would take gigabytes
        if zstandard.get_frame_parameters(compressed).content_size != size:
            raise ChunkDamage("its head has changed: it and its data state different sizes")
        data = zstandard.ZstdDecompressor().decompress(compressed)
    except zstandard.ZstdError as error:
        raise ChunkDamage(f"cannot be decompressed ({error})") from None
    if crc != zlib.crc32(data):
        raise ChunkDamage("its checksum does not match: bytes have changed")
    return data


def messages_in(data: bytes, channels: frozenset[int] | None = None) -> list[Message]:
    """Messages of the given channels (None: all) in a chunk."""
    unpack, head_size = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
    found = []
    for place, size in zip(*_places(data, channels), strict=True):
        _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
        content = data[place + head_size : place + head_size + size]
        found.append(Message(channel, sequence, log_time_ns, content))
    return found


def packed_messages(data: bytes, channels: frozenset[int]) -> NDArray[np.void]:
    """Contents of the messages of these channels, which are of equal length, as the items of an array."""
    places, sizes = _places(data, channels)
    contents = np.array(places, dtype=np.int64) + MESSAGE_HEAD.size
    return _items(data, contents, sizes[0] if sizes else 0)


def message_heads(data: bytes) -> NDArray[np.void]:
    """Headers (n,) of the messages in a chunk as rows of `MESSAGE_HEAD_DTYPE`."""
    places = np.array(_places(data)[0], dtype=np.int64)
    return _items(data, places, MESSAGE_HEAD.size).view(MESSAGE_HEAD_DTYPE)


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
    while place < end:
        _, length, channel = unpack(data, place)
        following = place + HEAD.size + length
        if channels is None or channel in channels:
            places.append(place)
            sizes.append(following - place - head_size)
        place = following
    return places, sizes
