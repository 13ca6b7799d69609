"""Table of contents of an MCAP file: schemas, channels, and positions of chunks, attachments and metadata.

A complete file has a summary, which is read from its end and verified by its checksum. Without a valid
summary, as after a power failure, the data section is walked through from record to record. Only the headers
of chunks are read, so that a file of any size takes about a second.
"""

import os
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics

from acquisition.record.chunk_reader import ChunkPlace, ChunkPlaces
from acquisition.record.descriptions import Descriptions
from acquisition.record.records import (
    CHUNK,
    HEAD,
    INDEX_ENTRY_BYTES,
    MAGIC,
    MESSAGE_INDEX,
    check_form,
    parse,
    read_record,
)
from acquisition.record.without_index import ChunkTimes, RecordSearch

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_SUMMARY_OFFSET = struct.Struct("<BQQ")
_INDEX_OFFSET = struct.Struct("<HQ")
_FIRST_OPCODE, _LAST_OPCODE = int(Opcode.HEADER), int(Opcode.DATA_END)
_CHUNK_OPCODE, _MESSAGE_INDEX_OPCODE = int(Opcode.CHUNK), int(Opcode.MESSAGE_INDEX)
_LOOK_BYTES = 4096
_LARGEST_HEAD_BYTES = HEAD.size + CHUNK.size


@dataclass
class Contents:
    """Table of contents of a file.

    `whole` is False for a file without an ending; `readable_bytes` is the end of its last complete record.
    `indexed` is True if the chunks come from a summary with a correct checksum, so that their channels are
    reliable. `damage` describes parts of the structure that could not be read, `unproved` those that could,
    though nothing in the file proves them.
    """

    size: int
    library: str = ""
    whole: bool = False
    indexed: bool = False
    readable_bytes: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    attachment_places: dict[str, list[int]] = field(default_factory=dict)
    descriptions: Descriptions = field(default_factory=Descriptions)
    walked_chunks: ChunkPlaces = field(default_factory=ChunkPlaces)
    chunk_index: bytes = b""
    counts: Counter[int] = field(default_factory=Counter)
    statistics: Statistics | None = None
    data_end: int = 0
    data_crc: int = 0
    damage: list[str] = field(default_factory=list)
    unproved: list[str] = field(default_factory=list)

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


def read_contents(file: IO[bytes]) -> Contents:
    """Contents of a file that begins with MCAP's magic."""
    size = file.seek(0, os.SEEK_END)
    contents = Contents(size)
    footer = _footer(file, size)
    contents.whole = footer is not None
    if footer is None or not footer.summary_start or not _read_summary(file, contents, footer):
        contents = Contents(size, whole=contents.whole, damage=contents.damage)
        walk(file, contents)
    contents.schemas, contents.channels, changed, unproved = contents.descriptions.settled()
    contents.damage += [f"a copy of the description of {topic} has changed" for topic in changed]
    if not contents.indexed:
        contents.unproved += [f"description of {topic}" for topic in unproved]
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        contents.damage.append("the magic at its beginning has changed")
    return contents


def walk(file: IO[bytes], contents: Contents) -> None:
    """List the data section record by record, without decompression, up to its last complete record.

    Behind bytes that are no record, the next one whose content can be verified is looked for. The records
    between two chunks are read in one piece for speed: a record of one day has 200,000 chunks.
    """
    chunk: tuple[int, int, int, int] | None = None
    index_end = 0
    channels: tuple[int, ...] = ()
    of_chunk = cache(frozenset[int])  # one set for all chunks that hold the same channels
    search, times = RecordSearch(file), ChunkTimes(file)
    place, before, size, counts = len(MAGIC), 0, contents.size, contents.counts
    head, head_size = HEAD.unpack_from, HEAD.size
    data, base, readable = b"", 0, 0
    while place + head_size <= size:
        at = place - base
        if not 0 <= at <= readable:
            file.seek(place)
            data, base, at = file.read(_LOOK_BYTES), place, 0
            readable = len(data) - _LARGEST_HEAD_BYTES if place + len(data) < size else len(data)
        opcode, length = head(data, at)
        end = place + head_size + length
        fault = ""
        if end > size or not _FIRST_OPCODE <= opcode <= _LAST_OPCODE:
            fault = "there is no record"
        else:
            try:
                if opcode == _MESSAGE_INDEX_OPCODE:
                    channel, of_entries = MESSAGE_INDEX.unpack_from(data, at + head_size)
                    if of_entries % INDEX_ENTRY_BYTES or length != MESSAGE_INDEX.size + of_entries:
                        raise ValueError("its lengths contradict each other")
                    counts[channel] += of_entries // INDEX_ENTRY_BYTES
                    channels += (channel,)
                    index_end = end
                elif opcode == _CHUNK_OPCODE:
                    start_ns, end_ns, *_ = CHUNK.unpack_from(data, at + head_size)
                    if chunk is not None:
                        _list_chunk(contents, times, ChunkPlace(*chunk, of_chunk(channels)), index_end)
                    channels, index_end = (), end
                    chunk = (place, head_size + length, start_ns, end_ns)
                else:
                    _list_record(file, contents, opcode, place)
            except (struct.error, ValueError) as error:
                fault = str(error)
        if fault:
            # the length of the record before may be what has changed
            doubtful = place if not before or search.is_sound(before) else before
            found = search.next_from(doubtful + 1)
            if found is None:
                break
            contents.damage.append(f"bytes {doubtful} to {found} cannot be read: {fault}")
            place, before = found, 0
            continue
        before, place = place, end
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
    if chunk is not None:
        _list_chunk(contents, times, ChunkPlace(*chunk, of_chunk(channels)), index_end)
    contents.readable_bytes = place
    contents.data_end = contents.data_end or place


def _list_chunk(contents: Contents, times: ChunkTimes, place: ChunkPlace, index_end: int) -> None:
    proved = times.proved(place, index_end)
    if proved != place:
        contents.damage.append(f"the times in the head of the chunk at byte {place.offset} have changed")
    contents.walked_chunks.append(proved)


def _list_record(file: IO[bytes], contents: Contents, opcode: int, place: int) -> None:
    data = read_record(file, place)[1]
    if opcode == Opcode.ATTACHMENT:
        # its checksum is verified when it is read
        attachment = parse(opcode, data)
        contents.attachments[attachment.name] = len(attachment.data)
        contents.attachment_places.setdefault(attachment.name, []).append(place)
        return
    check_form(opcode, data)
    if opcode == Opcode.DATA_END:
        contents.data_end = place
        contents.data_crc = struct.unpack("<I", data)[0]
    elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
        _list_small(contents, opcode, data)


def _list_small(contents: Contents, opcode: int, data: bytes) -> None:
    record = parse(opcode, data)
    if isinstance(record, Header):
        contents.library = record.library
    elif isinstance(record, Schema | Channel):
        contents.descriptions.add(record)
    elif isinstance(record, Metadata):
        contents.metadata[record.name] = record.metadata
    elif isinstance(record, Statistics):
        contents.statistics = record
        contents.counts.update(record.channel_message_counts)


def _footer(file: IO[bytes], size: int) -> Footer | None:
    length = _FOOTER.size + len(MAGIC)
    if size < length + len(MAGIC):
        return None
    file.seek(size - length)
    data = file.read(length)
    opcode, record_length, start, offsets, crc = _FOOTER.unpack(data[: _FOOTER.size])
    if data[_FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or record_length != 20:
        return None
    return Footer(start, offsets, crc)


def _read_summary(file: IO[bytes], contents: Contents, footer: Footer) -> bool:
    """Fill `contents` from the summary; False if it is damaged, with the reason in `contents.damage`."""
    end = contents.size - _FOOTER.size - len(MAGIC)
    if not len(MAGIC) <= footer.summary_start <= end:
        contents.damage.append("the footer points outside the file")
        return False
    file.seek(footer.summary_start)
    summary = file.read(end - footer.summary_start)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
    if footer.summary_crc not in (0, zlib.crc32(head, zlib.crc32(summary))):
        contents.damage.append("the summary's checksum does not match: bytes have changed")
        return False
    try:
        _list_summary(file, contents, summary, footer)
        _list_or_note(file, contents, len(MAGIC), "the header")
        _, data = read_record(file, footer.summary_start - 13)
        contents.data_end = footer.summary_start - 13
        contents.data_crc = struct.unpack("<I", data)[0]
    except (struct.error, ValueError) as error:
        contents.damage.append(f"the summary cannot be read ({error})")
        return False
    contents.readable_bytes = contents.size
    contents.indexed = True
    return True


def _list_summary(file: IO[bytes], contents: Contents, summary: bytes, footer: Footer) -> None:
    groups = _groups(summary, footer)
    place = 0
    while place < len(summary):
        if (Opcode.CHUNK_INDEX, place) in groups:
            # The chunk indexes are by far the largest group; they are parsed only when needed.
            length = groups[Opcode.CHUNK_INDEX, place]
            contents.chunk_index += summary[place : place + length]
            place += length
            continue
        opcode, length = HEAD.unpack_from(summary, place)
        end = place + HEAD.size + length
        data = summary[place + HEAD.size : end]
        if opcode == Opcode.CHUNK_INDEX:
            contents.chunk_index += summary[place:end]
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            _list_small(contents, opcode, data)
        elif opcode == Opcode.METADATA_INDEX:
            index = parse(opcode, data)
            _list_or_note(file, contents, index.offset, f"metadata {index.name}")
        elif opcode == Opcode.ATTACHMENT_INDEX:
            index = parse(opcode, data)
            contents.attachments[index.name] = index.data_size
            contents.attachment_places.setdefault(index.name, []).append(index.offset)
        place = end


def _list_or_note(file: IO[bytes], contents: Contents, place: int, name: str) -> None:
    """List one record of the data section; if it is damaged, note that and keep the rest readable."""
    try:
        _list_small(contents, *read_record(file, place))
    except (struct.error, ValueError) as error:
        contents.damage.append(f"{name} cannot be read ({error})")


def _groups(summary: bytes, footer: Footer) -> dict[tuple[int, int], int]:
    """Length of each group of the summary, by kind and place within the summary."""
    if footer.summary_offset_start < footer.summary_start:
        return {}
    records = summary[footer.summary_offset_start - footer.summary_start :]
    size = HEAD.size + _SUMMARY_OFFSET.size
    return {
        (kind, start - footer.summary_start): length
        for kind, start, length in (
            _SUMMARY_OFFSET.unpack_from(records, place + HEAD.size)
            for place in range(0, len(records) - size + 1, size)
        )
        if length > 0
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
