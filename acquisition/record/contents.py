"""Table of contents of an MCAP file: schemas, channels, and positions of chunks and attachments.

A complete file has a summary, which is read from its end and verified by its checksum. Without a valid
summary, as after a power failure, the data section is walked through from record to record. Only the headers
of chunks are read, so that a file of any size takes about a second.
"""

import os
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Schema, Statistics

from acquisition.record.chunk_reader import ChunkPlace, ChunkPlaces
from acquisition.record.records import (
    CHUNK_HEAD,
    HEAD,
    INDEX_ENTRY_BYTES,
    INDEX_HEAD,
    MAGIC,
    OWN_SHA256,
    ZSTD,
    parse,
    read_at,
    read_record,
    sha256_of_description,
)

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_SUMMARY_OFFSET = struct.Struct("<BQQ")
_INDEX_OFFSET = struct.Struct("<HQ")
_DATA_END = struct.Struct("<BQI")
_CHUNK_OPCODE, _MESSAGE_INDEX_OPCODE, _DATA_END_OPCODE = map(
    int, (Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END)
)
_SMALL_RECORDS = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT}
_PROVED = {Opcode.ATTACHMENT, Opcode.SCHEMA, Opcode.CHANNEL}
"""Those of which every copy is proved by a sum of its own."""
_BLOCK_BYTES = 256 * 1024
_END_OF_CHUNK_HEAD = struct.pack("<I", len(ZSTD)) + ZSTD
_BEFORE_END = CHUNK_HEAD.size - 8 - len(_END_OF_CHUNK_HEAD)


@dataclass
class Contents:
    """Table of contents of a file.

    `whole` is False for a file without an ending; `readable_bytes` is the end of its last complete record.
    `indexed` is True if the chunks come from a summary with a correct checksum, so that their channels are
    reliable. `schemas` and `channels` are those that agree with their SHA-256, of all `read_schemas`.
    `attachments` are their sizes, `attachment_places` where their copies are. `damage` describes
    parts of the structure that could not be read.
    """

    size: int
    library: str = ""
    whole: bool = False
    indexed: bool = False
    readable_bytes: int = 0
    read_schemas: dict[int, Schema] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    attachment_places: dict[str, list[int]] = field(default_factory=dict)
    walked_chunks: ChunkPlaces = field(default_factory=ChunkPlaces)
    chunk_index: bytes = b""
    counts: Counter[int] = field(default_factory=Counter)
    statistics: Statistics | None = None
    data_end: int = 0
    data_crc: int = 0
    damage: list[str] = field(default_factory=list)

    @cached_property
    def chunks(self) -> ChunkPlaces:
        """All chunks in the order of the file."""
        index, self.chunk_index = self.chunk_index, b""
        return self.walked_chunks or _chunk_places(index)

    @property
    def chunk_count(self) -> int:
        """How many chunks there are."""
        return len(self.chunks) if self.statistics is None else self.statistics.chunk_count

    @property
    def start_ns(self) -> int:
        """Earliest log time; 0 without messages."""
        if self.statistics is not None:
            return self.statistics.message_start_time
        return min((chunk.start_ns for chunk in self.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Latest log time; 0 without messages."""
        if self.statistics is not None:
            return self.statistics.message_end_time
        return max((chunk.end_ns for chunk in self.chunks), default=0)

    def data_crc_matches(self, file: IO[bytes]) -> bool:
        """Whether the data section is as it was written; True for a file that was cut before its checksum."""
        if not self.whole:
            return True
        crc, rest = 0, self.data_end
        while rest > 0 and (block := read_at(file, self.data_end - rest, min(_BLOCK_BYTES, rest))):
            crc = zlib.crc32(block, crc)
            rest -= len(block)
        return not rest and crc == self.data_crc

    def is_sound(self, file: IO[bytes]) -> bool:
        """Whether every byte is as it was written, by the checksums of summary and data section."""
        return self.whole and self.indexed and not self.damage and self.data_crc_matches(file)


def read_contents(file: IO[bytes]) -> Contents:
    """Contents of a file that begins with MCAP's magic."""
    size = file.seek(0, os.SEEK_END)
    contents = Contents(size)
    footer = _footer(file, size)
    contents.whole = footer is not None
    if footer is None or not footer.summary_start or not _read_summary(file, contents, footer):
        contents = Contents(size, whole=contents.whole, damage=contents.damage)
        _walk(file, contents)
    return contents


def _walk(file: IO[bytes], contents: Contents) -> None:
    """List the data section record by record, without decompression, up to its last complete record.

    Behind bytes that are no record it goes on at the next chunk, or what stands before the first.
    """
    chunk: tuple[int, int, int, int] | None = None
    channels: tuple[int, ...] = ()
    of_chunk = cache(frozenset[int])  # one set for all chunks that hold the same channels
    place, before, size = len(MAGIC), 0, contents.size
    head, head_size = HEAD.unpack_from, HEAD.size
    while place + head_size <= size:
        data = read_at(file, place, CHUNK_HEAD.size)
        try:
            opcode, length = head(data)
            end = place + head_size + length
            if end > size:
                raise ValueError("there is no record")
            if opcode == _MESSAGE_INDEX_OPCODE:
                _, _, channel, of_entries = INDEX_HEAD.unpack_from(data)
                if of_entries % INDEX_ENTRY_BYTES or head_size + length != INDEX_HEAD.size + of_entries:
                    raise ValueError("the lengths of an index contradict each other")
                contents.counts[channel] += of_entries // INDEX_ENTRY_BYTES
                channels += (channel,)
            elif opcode == _CHUNK_OPCODE:
                _, _, start_ns, end_ns, *_ = CHUNK_HEAD.unpack_from(data)
                if chunk is not None:
                    contents.walked_chunks.append(ChunkPlace(*chunk, of_chunk(channels)))
                channels = ()
                chunk = (place, head_size + length, start_ns, end_ns)
            elif opcode == Opcode.METADATA:
                # nothing proves them: they are read from an attachment
                pass
            elif opcode in _SMALL_RECORDS:
                _list_or_note(file, contents, place)
            elif opcode == _DATA_END_OPCODE and head_size + length == _DATA_END.size:
                contents.data_end = place
                *_, contents.data_crc = _DATA_END.unpack_from(data)
            else:
                raise ValueError("there is no record")
        except (struct.error, ValueError) as error:
            # the length of the record before may be what has changed
            found = _next_chunk(file, before + 1, size)
            if chunk is None:
                found = _next_proved(file, before + 1, found or size) or found
            if found is None:
                break
            contents.damage.append(f"between bytes {before} and {found}: {error}")
            place = before = found
            continue
        before, place = place, end
        if opcode == _DATA_END_OPCODE:
            break
    if chunk is not None:
        contents.walked_chunks.append(ChunkPlace(*chunk, of_chunk(channels)))
    contents.readable_bytes = place
    contents.data_end = contents.data_end or place


def _next_chunk(file: IO[bytes], place: int, size: int) -> int | None:
    """Position of the next whole chunk that begins at or after `place`, by what all their heads end with."""
    while True:
        block = read_at(file, place, _BLOCK_BYTES)
        if len(block) < CHUNK_HEAD.size:
            return None
        at = block.find(_END_OF_CHUNK_HEAD, _BEFORE_END) - _BEFORE_END
        if at < 0:
            place += len(block) - CHUNK_HEAD.size + 1
            continue
        opcode, length = HEAD.unpack_from(block, at)
        place += at
        if opcode == _CHUNK_OPCODE and CHUNK_HEAD.size <= HEAD.size + length <= size - place:
            return place
        place += 1


def _next_proved(file: IO[bytes], place: int, end: int) -> int | None:
    """Position of the next attachment or description of a topic before the first chunk, which the next of
    these follow.
    """
    data = read_at(file, place, min(end - place, _BLOCK_BYTES))
    for at in range(len(data) - HEAD.size):
        opcode, length = HEAD.unpack_from(data, at)
        following = at + HEAD.size + length
        if opcode in _PROVED and following < len(data) and data[following] in _PROVED:
            return place + at
    return None


def _list_or_note(file: IO[bytes], contents: Contents, place: int) -> None:
    """List one record of the data section; if it is damaged, note that and keep the rest readable."""
    try:
        _list_small(contents, place, *read_record(file, place))
    except (ValueError, KeyError) as error:
        contents.damage.append(f"the record at byte {place} cannot be read ({error})")


def _list_small(contents: Contents, place: int, opcode: int, data: bytes) -> None:
    record = parse(opcode, data)
    if isinstance(record, Header):
        contents.library = record.library
    elif isinstance(record, Schema):
        contents.read_schemas[record.id] = record
    elif isinstance(record, Channel):
        schema = contents.read_schemas.get(record.schema_id)
        if schema is not None and record.metadata.get(OWN_SHA256) == sha256_of_description(record, schema):
            contents.schemas[schema.id], contents.channels[record.id] = schema, record
        else:
            contents.damage.append(f"a description of {record.topic} has changed")
            # without an intact copy its messages cannot be read
            contents.channels.setdefault(record.id, replace(record, schema_id=0))
    elif isinstance(record, Statistics):
        contents.statistics = record
        contents.counts.update(record.channel_message_counts)
    else:
        _list_attachment(contents, record.name, len(record.data), place)


def _list_attachment(contents: Contents, name: str, size: int, place: int) -> None:
    """Its checksum is verified when it is read."""
    contents.attachments[name] = size
    contents.attachment_places.setdefault(name, []).append(place)


def _footer(file: IO[bytes], size: int) -> Footer | None:
    length = _FOOTER.size + len(MAGIC)
    if size < length + len(MAGIC):
        return None
    data = read_at(file, size - length, length)
    if len(data) < length:
        return None
    opcode, record_length, start, offsets, crc = _FOOTER.unpack(data[: _FOOTER.size])
    if data[_FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or record_length != 20:
        return None
    return Footer(start, offsets, crc)


def _read_summary(file: IO[bytes], contents: Contents, footer: Footer) -> bool:
    """Fill `contents` from the summary; False if it is damaged, with the reason in `contents.damage`."""
    end = contents.size - _FOOTER.size - len(MAGIC)
    contents.data_end = footer.summary_start - _DATA_END.size
    if not len(MAGIC) <= contents.data_end <= footer.summary_start <= end:
        contents.damage.append("the footer points outside the file")
        return False
    summary = read_at(file, footer.summary_start, end - footer.summary_start)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
    if footer.summary_crc != zlib.crc32(head, zlib.crc32(summary)):
        contents.damage.append("the summary's checksum does not match: bytes have changed")
        return False
    try:
        _list_summary(contents, summary, footer)
    except (struct.error, ValueError, KeyError) as error:
        contents.damage.append(f"the summary cannot be read ({error})")
        return False
    _list_or_note(file, contents, len(MAGIC))
    *_, contents.data_crc = _DATA_END.unpack(read_at(file, contents.data_end, _DATA_END.size))
    contents.readable_bytes = contents.size
    contents.indexed = True
    return True


def _list_summary(contents: Contents, summary: bytes, footer: Footer) -> None:
    groups = _groups(summary, footer)
    place = 0
    while place < len(summary):
        opcode, length = HEAD.unpack_from(summary, place)
        end = place + HEAD.size + length
        data = summary[place + HEAD.size : end]
        if opcode == Opcode.CHUNK_INDEX:
            # by far the largest group; it is parsed only when needed
            end = place + groups[Opcode.CHUNK_INDEX, place]
            contents.chunk_index = summary[place:end]
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            _list_small(contents, 0, opcode, data)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            index = parse(opcode, data)
            _list_attachment(contents, index.name, index.data_size, index.offset)
        place = end


def _groups(summary: bytes, footer: Footer) -> dict[tuple[int, int], int]:
    """Length of each group of the summary, by kind and place within the summary."""
    records = summary[footer.summary_offset_start - footer.summary_start :]
    size = HEAD.size + _SUMMARY_OFFSET.size
    return {
        (kind, start - footer.summary_start): length
        for kind, start, length in (
            _SUMMARY_OFFSET.unpack_from(records, place + HEAD.size)
            for place in range(0, len(records) - size + 1, size)
        )
    }


def _chunk_places(index: bytes) -> ChunkPlaces:
    found = ChunkPlaces()
    place = 0
    while place < len(index):
        _, record_length = HEAD.unpack_from(index, place)
        start_ns, end_ns, offset, length, bytes_of_offsets = _CHUNK_INDEX.unpack_from(
            index, place + HEAD.size
        )
        at = place + HEAD.size + _CHUNK_INDEX.size
        channels = frozenset(
            channel for channel, _ in _INDEX_OFFSET.iter_unpack(index[at : at + bytes_of_offsets])
        )
        found.append(ChunkPlace(offset, length, start_ns, end_ns, channels))
        place += HEAD.size + record_length
    return found
