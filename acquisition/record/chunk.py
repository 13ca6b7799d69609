"""The bytes of an MCAP file as its disk gives them, and one chunk: its place, its content, verified by its
checksum, and the messages in that."""

import errno
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import IO, Final, NamedTuple

import zstandard
from mcap.opcode import Opcode

HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of every record."""
CHUNK_HEAD: Final = struct.Struct("<BQQQQII4sQ")
"""Opcode and length of a chunk, its first and last log time, size and CRC-32 of its messages, length and name
of their compression, and the size of the compressed messages, which follow.
"""
_COMPRESSION = b"zstd"
_FAULTS = {errno.EIO, getattr(errno, "EUCLEAN", errno.EIO), getattr(errno, "EBADMSG", errno.EIO)}
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode and length of a message, its channel, sequence, log time, publish time; its content follows."""
MESSAGE_HEAD_BYTES: Final = _MESSAGE.size
_MESSAGE_BEGIN = struct.Struct("<BQH")
"""The part of a message that all messages of one channel and length share."""


class Message(NamedTuple):
    """An encoded message; `log_time_ns` is UTC."""

    topic: str
    sequence: int
    log_time_ns: int
    data: bytes


class ChunkPlace(NamedTuple):
    """Offset and length of a chunk in bytes, its log times (UTC), and its channels.

    `channels` has the bit ``1 << number`` for each channel; 0: they are not known.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: int = 0


def chunk_at(offset: int, data: bytes) -> ChunkPlace | None:
    """The chunk at a position in the file, where `data` begin; None if they are not the head of one."""
    if len(data) < CHUNK_HEAD.size:
        return None
    opcode, length, start_ns, end_ns, _, _, name_bytes, name, size = CHUNK_HEAD.unpack_from(data)
    if (opcode, name_bytes, name) != (Opcode.CHUNK, len(_COMPRESSION), _COMPRESSION) or start_ns > end_ns:
        return None
    lengths_agree = length == CHUNK_HEAD.size - HEAD.size + size
    return ChunkPlace(offset, HEAD.size + length, start_ns, end_ns) if lengths_agree else None


def content_of(record: bytes, place: ChunkPlace) -> bytes:
    """The messages of a chunk, verified. Raises ValueError, with what has changed, for a damaged chunk."""
    if len(record) < place.length:
        raise ValueError("ends early, or its disk cannot give all of it")
    if chunk_at(place.offset, record) is None:
        raise ValueError("its head has changed")
    _, _, _, _, size, crc, *_ = CHUNK_HEAD.unpack_from(record)
    packed = memoryview(record)[CHUNK_HEAD.size :]
    try:
        # one changed bit in either size could make the decompression ask for gigabytes of memory
        if zstandard.get_frame_parameters(packed).content_size != size:
            raise ValueError("its head has changed: it and its data state different sizes")
        content = zstandard.decompress(packed)
    except zstandard.ZstdError as error:
        raise ValueError(f"cannot be decompressed ({error})") from None
    if len(content) != size or crc != zlib.crc32(content):
        raise ValueError("its checksum does not match: bytes have changed")
    return content


class Piece:
    """The messages of one verified chunk, by topic; `topic in piece` says whether it has any of that topic.

    `channels` are the topics by channel. Runs of messages of one channel and length are found without
    decoding any of them.
    """

    def __init__(self, content: bytes, channels: Mapping[int, str]) -> None:
        self._content = content
        self._runs: dict[str, list[range]] = {}
        at = 0
        while at < len(content):
            begin, head = at, content[at : at + _MESSAGE_BEGIN.size]
            opcode, length, channel = _MESSAGE_BEGIN.unpack(head)
            step = HEAD.size + length
            at += step
            # the first chunk begins with schemas and channels, which are no messages
            if opcode == Opcode.MESSAGE and channel in channels:
                while content.startswith(head, at):
                    at += step
                self._runs.setdefault(channels[channel], []).append(range(begin, at, step))

    def __contains__(self, topic: str) -> bool:
        return topic in self._runs

    def messages(self, topic: str | None = None) -> Iterator[Message]:
        """Messages of a topic, or all, in the order of the file."""
        runs = [(run, name) for name, found in self._runs.items() if topic in (None, name) for run in found]
        for run, name in sorted(runs, key=lambda one: one[0].start):
            for at in run:
                _, _, _, sequence, log_time_ns, _ = _MESSAGE.unpack_from(self._content, at)
                data = self._content[at + MESSAGE_HEAD_BYTES : at + run.step]
                yield Message(name, sequence, log_time_ns, data)

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return sum(len(run) for run in self._runs.get(topic, ()))

    def rows(self, topic: str) -> Iterator[tuple[int, memoryview]]:
        """Consecutive messages of a topic with their heads, and the number of bytes of each."""
        view = memoryview(self._content)
        return ((run.step, view[run.start : run.stop]) for run in self._runs.get(topic, ()))


def read_at(file: IO[bytes], place: int, count: int) -> bytes:
    """Bytes from a position on; none where the disk cannot read all of them, as exFAT after a power cut."""
    file.seek(place)
    try:
        return file.read(count)
    except OSError as error:
        # a disk that was pulled out does not mean that the record is damaged
        if error.errno not in _FAULTS:
            raise
        return b""
