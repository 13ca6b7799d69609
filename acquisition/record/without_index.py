"""What a file without an index needs: the times of its chunks, proved, and the next record behind damage.

The times stand in the chunk's head, which no checksum covers, and once more in the message index behind it.
"""

import os
import re
import struct
from typing import IO

from mcap.opcode import Opcode

from acquisition.record.chunk_reader import (
    LARGEST_CHUNK_BYTES,
    ChunkDamage,
    ChunkPlace,
    message_heads,
    open_chunk,
)
from acquisition.record.records import CHUNK, HEAD, INDEX_ENTRY_BYTES, MESSAGE_INDEX, check_form, read_record

_ENTRY = struct.Struct("<QQ")
_MOST_OPENED_BYTES = 2 * LARGEST_CHUNK_BYTES


class ChunkTimes:
    """Proves the times of the chunks of one file; opens few of them, so that a file of lies ends, too."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._left_bytes = _MOST_OPENED_BYTES

    def proved(self, place: ChunkPlace, index_end: int) -> ChunkPlace:
        """The place with the times of the chunk's messages.

        Where head and message index, which ends at `index_end`, agree, the chunk is not opened; otherwise the
        messages decide, and of a damaged chunk, of which nothing is used, the head.
        """
        if self._indexed(place.offset + place.length, index_end) == (place.start_ns, place.end_ns):
            return place
        self._file.seek(place.offset + HEAD.size)
        *_, unpacked_bytes, _, _ = CHUNK.unpack(self._file.read(CHUNK.size))
        self._left_bytes -= min(unpacked_bytes, LARGEST_CHUNK_BYTES)
        if self._left_bytes < 0:
            return place
        try:
            _, heads = message_heads(open_chunk(self._file, place))
        except ChunkDamage:
            return place
        if not len(heads):
            return place
        times_ns = heads["log_time_ns"]
        return place._replace(start_ns=int(times_ns.min()), end_ns=int(times_ns.max()))

    def _indexed(self, start: int, end: int) -> tuple[int, int] | None:
        """Earliest and latest of the first and the last entries of a chunk's message index.

        The messages of most topics are in order, so that these are the earliest and latest of all; where they
        are not, no more is lost than the time of opening the chunk.
        """
        self._file.seek(start)
        index = self._file.read(end - start)
        times: list[int] = []
        at = HEAD.size + MESSAGE_INDEX.size
        while at < len(index):
            (size,) = struct.unpack_from("<I", index, at - 4)
            last = at + size - INDEX_ENTRY_BYTES
            if at <= last <= len(index) - INDEX_ENTRY_BYTES:
                times += (_ENTRY.unpack_from(index, at)[0], _ENTRY.unpack_from(index, last)[0])
            at += size + HEAD.size + MESSAGE_INDEX.size
        return (min(times), max(times)) if times else None


_BLOCK_BYTES = 1024 * 1024
_KINDS = bytes(
    [
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.CHUNK,
        Opcode.MESSAGE_INDEX,
        Opcode.ATTACHMENT,
        Opcode.METADATA,
        Opcode.DATA_END,
    ]
)
# a record of the data section, shorter than 64 MiB
_LIKELY = re.compile(b"[" + re.escape(_KINDS) + rb"](?=.{3}[\x00-\x03]\x00{4})", re.DOTALL)
_WORK_PER_BYTE = 8
_LEAST_WORK_BYTES = 64 * 1024 * 1024


class RecordSearch:
    """Judges records by everything that can be verified about them.

    The work is bounded by a multiple of the file's size, so that a file made for the purpose ends, too.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)
        self._left_bytes = _LEAST_WORK_BYTES + _WORK_PER_BYTE * self._size

    def next_from(self, place: int) -> int | None:
        """Position of the first sound record at or after `place`; None without one."""
        while place + HEAD.size <= self._size and self._left_bytes > 0:
            self._file.seek(place)
            block = self._file.read(_BLOCK_BYTES + HEAD.size - 1)
            for found in _LIKELY.finditer(block):
                if self._left_bytes > 0 and self.is_sound(place + found.start(), followed=True):
                    return place + found.start()
            place += max(len(block) - HEAD.size + 1, 1)
        return None

    def is_sound(self, place: int, *, followed: bool = False) -> bool:
        """Whether there is a record whose checksum matches, or that is well formed where it has none.

        With `followed`, a record without a checksum must be followed by another one or by the file's end.
        """
        try:
            opcode, length = self._head(place)
            end = place + HEAD.size + length
            if end > self._size:
                return False
            self._left_bytes -= HEAD.size
            if opcode == Opcode.CHUNK:
                return self._is_sound_chunk(place, end)
            self._left_bytes -= length
            check_form(*read_record(self._file, place))
            if not followed or opcode == Opcode.ATTACHMENT or end == self._size:
                return True
            following, length = self._head(end)
        except (ValueError, struct.error):
            return False
        known = Opcode.HEADER <= following <= Opcode.DATA_END
        return known and end + HEAD.size + length <= self._size

    def _is_sound_chunk(self, place: int, end: int) -> bool:
        self._file.seek(place + HEAD.size)
        head = self._file.read(CHUNK.size)
        if len(head) < CHUNK.size:
            return False
        *_, unpacked_bytes, _, length_of_name = CHUNK.unpack(head)
        if unpacked_bytes > LARGEST_CHUNK_BYTES or length_of_name > len("zstd"):
            return False
        self._left_bytes -= end - place + unpacked_bytes
        try:
            open_chunk(self._file, ChunkPlace(place, end - place, 0, 0, frozenset()))
        except ChunkDamage:
            return False
        return True

    def _head(self, place: int) -> tuple[int, int]:
        self._file.seek(place)
        opcode, length = HEAD.unpack(self._file.read(HEAD.size))
        return opcode, length
