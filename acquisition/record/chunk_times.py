"""The times of chunks in a file without a summary, proved before anything relies on them.

They stand in the chunk's head, which no checksum covers, and once more in the message index behind it.
"""

import struct
from typing import IO

from acquisition.record.chunk_places import ChunkPlace
from acquisition.record.chunk_reader import LARGEST_CHUNK_BYTES, ChunkDamage, message_heads, open_chunk
from acquisition.record.records import CHUNK, HEAD, INDEX_ENTRY_BYTES, MESSAGE_INDEX

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
