"""Bytes and chunks of an MCAP file: where a chunk lies, its verified content, and the messages in that."""

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


class ChunkEntry(NamedTuple):
    """A chunk in the table of contents of a file."""

    offset: int
    """Position of the chunk in the file, in bytes."""
    length: int
    """Number of bytes of the chunk, its head included."""
    start_ns: int
    end_ns: int
    """Log times (UTC) of the first and the last message."""
    channels: int = 0
    """Bits ``1 << number`` of the channels that occur; 0: they are not known."""


def chunk_at(offset: int, data: bytes) -> ChunkEntry | None:
    """The chunk at a position in the file, where `data` begin; None if they are not the head of one."""
    if len(data) < CHUNK_HEAD.size:
        return None
    opcode, length, start_ns, end_ns, _, _, name_bytes, name, size = CHUNK_HEAD.unpack_from(data)
    if (opcode, name_bytes, name) != (Opcode.CHUNK, len(_COMPRESSION), _COMPRESSION) or start_ns > end_ns:
        return None
    lengths_agree = length == CHUNK_HEAD.size - HEAD.size + size
    return ChunkEntry(offset, HEAD.size + length, start_ns, end_ns) if lengths_agree else None


def content_of(record: bytes, chunk: ChunkEntry) -> bytes:
    """The messages of a chunk, verified. Raises ValueError, with what has changed, for a damaged chunk."""
    if len(record) < chunk.length:
        raise ValueError("ends early, or its disk cannot give all of it")
    if chunk_at(chunk.offset, record) is None:
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
        offset = 0
        while offset < len(content):
            begin, head = offset, content[offset : offset + _MESSAGE_BEGIN.size]
            opcode, length, channel = _MESSAGE_BEGIN.unpack(head)
            step = HEAD.size + length
            offset += step
            # the first chunk begins with schemas and channels, which are no messages
            if opcode == Opcode.MESSAGE and channel in channels:
                while content.startswith(head, offset):
                    offset += step
                self._runs.setdefault(channels[channel], []).append(range(begin, offset, step))

    def __contains__(self, topic: str) -> bool:
        return topic in self._runs

    def messages(self, topic: str | None = None) -> Iterator[Message]:
        """Messages of a topic, or all, in the order of the file."""
        topics = self._runs if topic is None else (topic,)
        named_runs = [(run, name) for name in topics for run in self._runs.get(name, ())]
        for run, name in sorted(named_runs, key=lambda named_run: named_run[0].start):
            for offset in run:
                _, _, _, sequence, log_time_ns, _ = _MESSAGE.unpack_from(self._content, offset)
                data = self._content[offset + MESSAGE_HEAD_BYTES : offset + run.step]
                yield Message(name, sequence, log_time_ns, data)

    def count(self, topic: str) -> int:
        """Number of messages of a topic."""
        return sum(len(run) for run in self._runs.get(topic, ()))

    def rows(self, topic: str) -> Iterator[tuple[int, memoryview]]:
        """Consecutive messages of a topic with their heads, and the number of bytes of each."""
        view = memoryview(self._content)
        return ((run.step, view[run.start : run.stop]) for run in self._runs.get(topic, ()))


def read_bytes(file: IO[bytes], offset: int, count: int) -> bytes:
    """Bytes from a position on; none where the disk cannot read all of them, as exFAT after a power cut."""
    file.seek(offset)
    try:
        return file.read(count)
    except OSError as error:
        # a disk that was pulled out does not mean that the record is damaged
        if error.errno not in _FAULTS:
            raise
        return b""
