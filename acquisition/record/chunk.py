"""One chunk of an MCAP file: checked by its checksum, and split into messages with numpy."""

import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

HEAD: Final = struct.Struct("<BQ")
"""Opcode, and length of the content."""
CHUNK_HEAD: Final = struct.Struct("<BQQQQII")
"""Opcode, length, first and last log time, uncompressed size, its CRC-32, length of the compression's
name. After this head stand that name, the compressed size and the data.
"""
_COMPRESSIONS = {0: b"", 4: b"zstd"}
"""Names of the compressions of a chunk by their lengths."""
_CHANNEL = struct.Struct("<BQH")
"""Opcode and length of a message, and its channel."""
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time; `_MESSAGE_DTYPE` is this layout for numpy."""
_MESSAGE_DTYPE = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_time_ns", "publish_time_ns"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
    }
)


class ChunkDamage(ValueError):
    """The chunk's bytes differ from what was written; the message describes how."""


class Message(NamedTuple):
    """An encoded message; `log_time_ns` is UTC."""

    channel: int
    sequence: int
    log_time_ns: int
    data: bytes


def chunk_content(data: bytes, length: int) -> tuple[int, int, bytes, int] | None:
    """Uncompressed size, CRC-32, compression and offset of the content of a chunk that begins with `data`.

    None if `data` are not the head of a chunk of `length` bytes.
    """
    if len(data) < CHUNK_HEAD.size:
        return None
    opcode, stated, start_ns, end_ns, size, crc, name_length = CHUNK_HEAD.unpack_from(data)
    start = CHUNK_HEAD.size + name_length + 8
    if opcode != Opcode.CHUNK or start_ns > end_ns or name_length not in _COMPRESSIONS or len(data) < start:
        return None
    name = data[CHUNK_HEAD.size : start - 8]
    end = start + int.from_bytes(data[start - 8 : start], "little")
    agree = name == _COMPRESSIONS[name_length] and end == HEAD.size + stated == length
    return (size, crc, name, start) if agree else None


def decompress_chunk(record: bytes, length: int) -> bytes:
    """The decompressed content of a chunk. Raises ChunkDamage if damaged."""
    if len(record) < length:
        raise ChunkDamage("ends early, or its disk cannot give all of it")
    head = chunk_content(record, length)
    if head is None:
        raise ChunkDamage("its head has changed")
    size, crc, compression, start = head
    data = record[start:]
    if compression:
        try:
            # one changed bit in either size could make the decompression ask for gigabytes of memory
            if zstandard.get_frame_parameters(data).content_size != size:
                raise ChunkDamage("its head has changed: it and its data state different sizes")
            data = zstandard.ZstdDecompressor().decompress(data)
        except zstandard.ZstdError as error:
            raise ChunkDamage(f"cannot be decompressed ({error})") from None
    if len(data) != size or crc != zlib.crc32(data):
        raise ChunkDamage("its checksum does not match: bytes have changed")
    return data


def messages_in(data: bytes, channels: frozenset[int] | None = None) -> list[Message]:
    """Messages of the given channels (None: all) in a chunk."""
    unpack, head_size = _MESSAGE.unpack_from, _MESSAGE.size
    found = []
    for place, size in zip(*_places(data, channels), strict=True):
        _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
        content = data[place + head_size : place + head_size + size]
        found.append(Message(channel, sequence, log_time_ns, content))
    return found


def packed_messages(data: bytes, channels: frozenset[int]) -> NDArray[np.void]:
    """Contents (n,) of the messages of these channels, which must all have the same length."""
    places, sizes = _places(data, channels)
    return _items(data, np.array(places, dtype=np.int64) + _MESSAGE.size, sizes[0] if sizes else 0)


def message_heads(data: bytes) -> NDArray[np.void]:
    """Headers (n,) of the messages in a chunk: channel, sequence, log_time_ns and more."""
    places = np.array(_places(data)[0], dtype=np.int64)
    return _items(data, places, _MESSAGE.size).view(_MESSAGE_DTYPE)


def _items(data: bytes, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copies of `size` bytes each, from the given positions in `data`."""
    # a view of the overlapping items that begin at each byte
    overlapping: NDArray[np.void] = np.ndarray(
        (max(len(data) - size + 1, 0),), dtype=f"V{size}", buffer=data, strides=(1,)
    )
    return overlapping[places]


def _places(data: bytes, channels: frozenset[int] | None = None) -> tuple[list[int], list[int]]:
    """Positions of the messages of the given channels in a chunk, and the sizes of their contents."""
    places, sizes = [], []
    place, end = 0, len(data)
    unpack, message_opcode = _CHANNEL.unpack_from, Opcode.MESSAGE.value
    while place < end:
        opcode, length, channel = unpack(data, place)
        following = place + HEAD.size + length
        # the first chunk also holds schemas and channels, which are no messages
        if opcode == message_opcode and (channels is None or channel in channels):
            places.append(place)
            sizes.append(following - place - _MESSAGE.size)
        place = following
    return places, sizes


class Damage(NamedTuple):
    """A damaged part of a record: topics and times (UTC) of the chunk, and a description."""

    start_ns: int
    end_ns: int
    topics: tuple[str, ...]
    description: str


class ChunkPlace(NamedTuple):
    """Offset and length of a chunk in bytes, its log times (UTC), and its channels (none: not known)."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


class ChunkPlaces:
    """The chunks in the order of the file, 34 bytes each: a record of one day has 170,000."""

    def __init__(self) -> None:
        self._numbers = array("Q")
        self._set_numbers = array("H")
        self._number_of_set: dict[frozenset[int], int] = {}

    def append(self, place: ChunkPlace) -> None:
        """Add the next chunk."""
        self._numbers.extend(place[:4])
        self._set_numbers.append(self._number_of_set.setdefault(place.channels, len(self._number_of_set)))

    def __len__(self) -> int:
        return len(self._set_numbers)

    def __iter__(self) -> Iterator[ChunkPlace]:
        return self.since(0)

    def since(self, first: int) -> Iterator[ChunkPlace]:
        """The chunks from number `first` on, counted from 0."""
        channels = list(self._number_of_set)
        rows = zip(*[iter(self._numbers[4 * first :])] * 4, self._set_numbers[first:], strict=True)
        for offset, length, start_ns, end_ns, set_number in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[set_number])


@dataclass
class Contents:
    """Table of contents of a file.

    `whole` is False for a file without an ending; `readable_bytes` is the end of its last complete record.
    `indexed` is True if the chunks come from a summary with a correct checksum, so that their channels are
    reliable. `counts` are the numbers of messages by channel. `attachments` are the sizes of attached files,
    `attachment_places` the offsets of their copies. `damage` describes unreadable parts of the structure.
    `size` is in bytes, `data_end` the end of the data section, `data_crc` its CRC-32.
    """

    size: int = 0
    library: str = ""
    whole: bool = False
    indexed: bool = False
    readable_bytes: int = len(MAGIC)
    channels: dict[int, str] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    attachment_places: dict[str, list[int]] = field(default_factory=dict)
    chunks: ChunkPlaces = field(default_factory=ChunkPlaces)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int = 0
    end_ns: int = 0
    data_end: int = 0
    data_crc: int = 0
    damage: list[str] = field(default_factory=list)

    def add_chunk(self, place: ChunkPlace) -> None:
        """Note the next chunk."""
        self.start_ns = min(self.start_ns, place.start_ns) if len(self.chunks) else place.start_ns
        self.end_ns = max(self.end_ns, place.end_ns)
        self.chunks.append(place)

    def add_attachment(self, name: str, size: int, place: int) -> None:
        """Note an attached file; its checksum is verified when it is read."""
        self.attachments[name] = size
        self.attachment_places.setdefault(name, []).append(place)
