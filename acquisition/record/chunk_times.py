"""The times of a chunk in a file without a summary, proved before anything relies on them.

They stand in the chunk's head, which no checksum covers, and once more in the message index behind it.
"""

import struct
from typing import IO

from acquisition.record.chunk_places import ChunkPlace
from acquisition.record.chunk_reader import ChunkDamage, message_heads, open_chunk
from acquisition.record.records import HEAD, INDEX_ENTRY_BYTES, MESSAGE_INDEX

_ENTRY = struct.Struct("<QQ")


def proved_times(file: IO[bytes], place: ChunkPlace, index_end: int) -> ChunkPlace:
    """The place with the times of the chunk's messages.

    Where head and message index, which ends at `index_end`, agree, the chunk is not opened; otherwise the
    messages decide, and of a damaged chunk, of which nothing is used, the head.
    """
    stated = place.start_ns, place.end_ns
    if _indexed_times(file, place.offset + place.length, index_end) == stated:
        return place
    try:
        _, heads = message_heads(open_chunk(file, place))
    except ChunkDamage:
        return place
    if not len(heads):
        return place
    times_ns = heads["log_time_ns"]
    return place._replace(start_ns=int(times_ns.min()), end_ns=int(times_ns.max()))


def _indexed_times(file: IO[bytes], start: int, end: int) -> tuple[int, int] | None:
    """Earliest and latest of the first and the last entries of a chunk's message index.

    The messages of most topics are in order, so that these are the earliest and latest of all; where they are
    not, no more is lost than the time of opening the chunk.
    """
    file.seek(start)
    index = file.read(end - start)
    times: list[int] = []
    at = HEAD.size + MESSAGE_INDEX.size
    while at < len(index):
        (size,) = struct.unpack_from("<I", index, at - 4)
        if size >= INDEX_ENTRY_BYTES and at + size <= len(index):
            times += (_ENTRY.unpack_from(index, at)[0], _ENTRY.unpack_from(index, at + size - 16)[0])
        at += size + HEAD.size + MESSAGE_INDEX.size
    return (min(times), max(times)) if times else None
