"""An MCAP file that is being read: what it holds, and its messages, verified by checksums.

A complete file has a summary, whose checksum is verified. Without a valid summary, as after a power failure
or while the file is still written, the data section is walked through from record to record; only the heads
of chunks are read, so that a file of any size takes about a second.
"""

import contextlib
import io
import json
import logging
import os
import stat
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import IO

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Header, McapRecord, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC

from acquisition.record import records_in_folder
from acquisition.record.chunk import (
    CHUNK_HEAD,
    HEAD,
    ChunkEntry,
    Piece,
    chunk_at,
    content_of,
    read_bytes,
)
from acquisition.record.digest import utc_text
from acquisition.record.topics import LIBRARY, METADATA_COPY, SCHEMA_VERSION
from processing.errors import RecordError, require_schema

_log = logging.getLogger(__name__)
_INDEX = struct.Struct("<BQHI")
"""Opcode and length of a chunk's message index, channel, bytes of its entries, which follow."""
_INDEX_ENTRY_BYTES = 16
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
"""Opcode and length of a chunk's entry in the summary, its times, offset, length, bytes of what follows."""
_CHANNEL_OFFSET = struct.Struct("<HQ")
"""A channel of the chunk, and the offset of its message index."""
_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
_CRC_BYTES = 4
_SMALL_RECORD_BYTES = 256 * 1024 * 1024
_BLOCK_BYTES = 256 * 1024


class ReadFile:
    """An MCAP file of a record whose chunks and attachments are verified as they are read.

    A chunk whose checksum is wrong is left out, listed in `damages` and logged; everything else is read. A
    file without an ending is read up to its last complete record; `update` reads what has been written since.
    The last `kept_pieces` chunks stay in memory. Raises RecordError for a file that is missing, is no MCAP
    file or cannot be read.

    Attributes
    ----------
    size, readable_bytes
        Length of the file, and end of its last complete record.
    is_complete
        Whether the file has an ending.
    has_summary
        Whether its contents are listed from a summary with a correct checksum.
    library
        Program that wrote the file.
    channels, counts
        Topics and numbers of messages by channel.
    chunks, start_ns, end_ns
        Chunks in the order of the file, and the times (UTC) of their first and last message.
    attachments
        Offsets of the copies of each attached file.
    damages
        What was found damaged so far, in words, by its offset: chunks, attachments, parts of the structure.
    """

    def __init__(self, path: Path, kept_pieces: int = 0) -> None:
        self.path = path
        self.piece = lru_cache(kept_pieces)(self._piece)
        self.size, self.readable_bytes = 0, len(MAGIC)
        self.is_complete = self.has_summary = False
        self.library = ""
        self.channels: dict[int, str] = {}
        self.counts: Counter[int] = Counter()
        self._last_chunk_counts: Counter[int] = Counter()
        self.chunks: list[ChunkEntry] = []
        self.start_ns = self.end_ns = 0
        self.attachments: dict[str, list[int]] = {}
        self.damages: dict[int, str] = {}
        self._data_end = self._data_crc = 0
        self.file = _open_mcap(path)
        try:
            self.update()
        except OSError as error:
            self.file.close()
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None

    def close(self) -> None:
        """Close the file, and forget the messages that were read."""
        self.file.close()
        self.piece.cache_clear()

    def update(self) -> bool:
        """List what has been written since the last call; True if anything has."""
        size = self.file.seek(0, os.SEEK_END)
        if self.is_complete or size == self.size:
            return False
        old_end, self.size = self.readable_bytes, size
        self._read_ending()
        if not self.has_summary:
            self._walk()
        return self.readable_bytes > old_end

    def _piece(self, chunk: ChunkEntry) -> Piece:
        """The messages of a chunk; none of a damaged one, which is listed."""
        try:
            content = content_of(self._read(chunk.offset, chunk.length), chunk)
        except ValueError as error:
            topics = sorted(name for number, name in self.channels.items() if chunk.channels >> number & 1)
            listed = " ".join(topics) or "topics unknown"
            span = f"{utc_text(chunk.start_ns)} to {utc_text(chunk.end_ns)}"
            self.note_damage(chunk.offset, str(error), f"chunk at byte {chunk.offset} ({listed}, {span})")
            content = b""
        return Piece(content, self.channels)

    def message_counts(self) -> dict[str, int]:
        """Numbers of messages by topic, damaged ones included, also of a last chunk whose index is cut."""
        counts = Counter(self.counts)
        if self.chunks and not self.has_summary and not self._data_end:
            last = self.piece(self.chunks[-1])
            for number, topic in self.channels.items():
                counts[number] += max(0, last.count(topic) - self._last_chunk_counts[number])
        return {topic: counts[number] for number, topic in self.channels.items() if counts[number]}

    def pieces(self, topic: str, from_ns: int = 0) -> Iterator[Piece]:
        """The chunks that may have messages of a topic; those that end before `from_ns` are not read."""
        channel_bits = sum(1 << number for number, name in self.channels.items() if name == topic)
        for chunk in self.chunks if channel_bits else ():
            if chunk.end_ns >= from_ns and (chunk.channels & channel_bits or not chunk.channels):
                yield self.piece(chunk)

    def copies(self, name: str) -> Iterator[bytes]:
        """The intact copies of an attached file; damaged ones are listed."""
        for offset in self.attachments.get(name, ()):
            try:
                record = self._small_record(offset)
            except ValueError as error:
                self.note_damage(offset, f"attachment {name}: {error}")
                continue
            assert isinstance(record, Attachment)
            yield record.data

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata, read from the attached copy, which has a checksum.

        Raises RecordError where the file is not a record of this program.
        """
        copy = next(self.copies(METADATA_COPY), None)
        if copy is None:
            if METADATA_COPY in self.attachments or (self.damages and self.library == LIBRARY):
                raise RecordError(f"{self.path}: its own description is damaged")
            if not self.is_complete and not self.chunks:
                raise RecordError(f"{self.path}: was cut short before anything was recorded")
            topics = ", ".join(sorted(self.channels.values()))
            raise RecordError(
                f"{self.path}: is an MCAP file of another program (topics: {topics or 'none'}); "
                "only records of rig run can be read"
            )
        metadata: dict[str, dict[str, str]] = json.loads(copy)
        identity = metadata.get("record", {})
        try:
            version = int(identity["schema_version"])
        except (KeyError, ValueError):
            raise RecordError(f"{self.path}: its own description is damaged: {identity}") from None
        require_schema(str(self.path), version, SCHEMA_VERSION, RecordError)
        return metadata

    def data_crc_matches(self) -> bool:
        """Whether the data section is as it was written; True for a file that was cut before its checksum."""
        if not self._data_end:
            return True
        crc, rest = 0, self._data_end
        while rest > 0 and (block := self._read(self._data_end - rest, min(_BLOCK_BYTES, rest))):
            crc = zlib.crc32(block, crc)
            rest -= len(block)
        return not rest and crc == self._data_crc

    def is_sound(self) -> bool:
        """Whether every byte is as it was written, by the checksums of summary and data section."""
        return self.is_complete and self.has_summary and not self.damages and self.data_crc_matches()

    def note_damage(self, offset: int, fault: str, where: str = "") -> None:
        """Add a fault to `damages` and to the log, once for each offset; `where` is by default the byte."""
        if offset not in self.damages:
            self.damages[offset] = f"{where or f'byte {offset}'}: {fault}"
            _log.warning("%s: damaged, not used: %s", self.path, self.damages[offset])

    def _read(self, offset: int, count: int) -> bytes:
        return read_bytes(self.file, offset, count)

    def _small_record(self, offset: int, *, verify: bool = True) -> McapRecord:
        """The header, or an attachment, verified by its checksum. Raises ValueError for any other bytes."""
        opcode, length = HEAD.unpack(self._read(offset, HEAD.size).ljust(HEAD.size, b"\0"))
        if length > _SMALL_RECORD_BYTES:
            raise ValueError(f"it claims {length} bytes")
        data = self._read(offset, HEAD.size + length)
        if len(data) < HEAD.size + length:
            raise ValueError("it ends early")
        crc = int.from_bytes(data[-_CRC_BYTES:], "little")
        if verify and opcode == Opcode.ATTACHMENT and crc != zlib.crc32(data[HEAD.size : -_CRC_BYTES]):
            raise ValueError("its checksum does not match: bytes have changed")
        try:
            record = _parsed(data)
        except (struct.error, UnicodeDecodeError, OverflowError, McapError) as error:
            raise ValueError(str(error) or type(error).__name__) from None
        if not isinstance(record, Header | Attachment):
            raise ValueError("it is another one")
        return record

    def _read_ending(self) -> None:
        """Note whether the file has an ending; list what a valid summary states, if nothing is listed yet."""
        end = self.size - _FOOTER.size - len(MAGIC)
        data = self._read(max(end, 0), _FOOTER.size + len(MAGIC))
        if end < len(MAGIC) or data[_FOOTER.size :] != MAGIC:
            return
        opcode, length, start, _, crc = _FOOTER.unpack_from(data)
        self.is_complete = (opcode, length) == (Opcode.FOOTER, _FOOTER.size - HEAD.size)
        if not self.is_complete or not start or self.readable_bytes > len(MAGIC):
            return
        if not len(MAGIC) <= start - _DATA_END.size <= end:
            self.note_damage(end, "the footer points outside the file")
            return
        summary = self._read(start, end - start)
        if crc != zlib.crc32(data[: _FOOTER.size - _CRC_BYTES], zlib.crc32(summary)):
            self.note_damage(start, "the summary's checksum does not match: bytes have changed")
            return
        # the checksum has shown that every record of the summary can be read
        i = 0
        while i < len(summary):
            opcode, length = HEAD.unpack_from(summary, i)
            if opcode == Opcode.CHUNK_INDEX:
                # not by the library, which takes ten times as long for the chunks of a day
                _, _, start_ns, end_ns, offset, size, index_bytes = _CHUNK_INDEX.unpack_from(summary, i)
                index = summary[i + _CHUNK_INDEX.size : i + _CHUNK_INDEX.size + index_bytes]
                channels = sum(1 << channel for channel, _ in _CHANNEL_OFFSET.iter_unpack(index))
                self._add_chunk(ChunkEntry(offset, size, start_ns, end_ns, channels))
            else:
                match _parsed(summary[i : i + HEAD.size + length]):
                    case Channel() as channel:
                        self.channels[channel.id] = channel.topic
                    case Statistics() as statistics:
                        self.counts.update(statistics.channel_message_counts)
                    case AttachmentIndex() as attachment:
                        self.attachments.setdefault(attachment.name, []).append(attachment.offset)
            i += HEAD.size + length
        self._data_end = start - _DATA_END.size
        *head, self._data_crc = _DATA_END.unpack(self._read(self._data_end, _DATA_END.size))
        if head != [Opcode.DATA_END, _CRC_BYTES]:
            # neither the summary's checksum nor its own covers the head of this record
            self.note_damage(self._data_end, "the record that ends the data has changed")
        self._list_small_record(len(MAGIC))
        self.readable_bytes, self.has_summary = self.size, True

    def _walk(self) -> None:
        """List the data section up to its last complete record, without decompression; after bytes that are
        no record, from the next intact chunk or attachment on.
        """
        offset = last_offset = self.readable_bytes
        while offset + HEAD.size <= self.size and not self._data_end:
            end = self._list_record(offset)
            if end is not None:
                last_offset, offset = offset, end
                continue
            # the changed bytes may be the length of the last record, so the search begins inside it
            next_offset = self._next_intact_record(last_offset + 1)
            if next_offset is None or self._note_another_file(last_offset, next_offset):
                break
            self.note_damage(offset, f"between bytes {last_offset} and {next_offset}: there is no record")
            offset = last_offset = next_offset
        self.readable_bytes = offset
        if self._data_end:
            self._note_another_file(offset, self.size)

    def _note_another_file(self, begin: int, end: int) -> bool:
        """Note a file that was appended to this one, complete or cut, and begins between two offsets."""
        for offset in range(begin, end, _BLOCK_BYTES):
            i = self._read(offset, min(_BLOCK_BYTES + len(MAGIC) - 1, end - offset)).find(MAGIC)
            if i < 0:
                continue
            # files begin and end with the same bytes; at the end a footer precedes them
            footer = self._read(max(offset + i - _FOOTER.size, 0), HEAD.size)
            ends = HEAD.unpack(footer.ljust(HEAD.size, b"\0")) == (Opcode.FOOTER, _FOOTER.size - HEAD.size)
            other = offset + i + (len(MAGIC) if ends else 0)
            if other < self.size:
                self.is_complete = ends
                extra = f"{self.size - other} bytes from byte {other} on are of another file and not read: "
                self.note_damage(other, f"{extra}was it appended? Cut it off into a file of its own")
            return other < self.size
        return False

    def _list_record(self, offset: int) -> int | None:
        """List the record at `offset` in the data section; returns its end, None where it is no record."""
        data = self._read(offset, CHUNK_HEAD.size)
        opcode, length = HEAD.unpack_from(data) if len(data) >= HEAD.size else (0, self.size)
        end: int = offset + HEAD.size + length
        if end > self.size:
            return None
        if opcode == Opcode.CHUNK:
            chunk = chunk_at(offset, data)
            if chunk is None:
                return None
            self._add_chunk(chunk)
            self._last_chunk_counts.clear()
        elif opcode == Opcode.MESSAGE_INDEX:
            if len(data) < _INDEX.size:
                return None
            _, _, channel, entries_bytes = _INDEX.unpack_from(data)
            if entries_bytes % _INDEX_ENTRY_BYTES or end != offset + _INDEX.size + entries_bytes:
                return None
            self.counts[channel] += entries_bytes // _INDEX_ENTRY_BYTES
            self._last_chunk_counts[channel] += entries_bytes // _INDEX_ENTRY_BYTES
        elif opcode == Opcode.DATA_END and end == offset + _DATA_END.size:
            self._data_end = offset
            *_, self._data_crc = _DATA_END.unpack_from(data)
        elif opcode in (Opcode.HEADER, Opcode.ATTACHMENT):
            self._list_small_record(offset)
        elif opcode not in (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.FOOTER):
            # metadata have no checksum, so they are read from their attached copy instead
            return None
        return end

    def _add_chunk(self, chunk: ChunkEntry) -> None:
        self.start_ns = min(self.start_ns, chunk.start_ns) if self.chunks else chunk.start_ns
        self.end_ns = max(self.end_ns, chunk.end_ns)
        self.chunks.append(chunk)

    def _list_small_record(self, offset: int) -> None:
        """List the header or an attachment, which is verified when it is read; the rest stays readable."""
        try:
            record = self._small_record(offset, verify=False)
        except ValueError as error:
            self.note_damage(offset, f"the record cannot be read ({error})")
            return
        if isinstance(record, Header):
            self.library = record.library
        elif isinstance(record, Attachment):
            self.attachments.setdefault(record.name, []).append(offset)

    def _next_intact_record(self, begin: int) -> int | None:
        """Offset of the next chunk whose lengths agree, or attachment whose checksum matches."""
        while len(block := self._read(begin, _BLOCK_BYTES)) > CHUNK_HEAD.size:
            values = np.frombuffer(block, dtype=np.uint8, count=len(block) - CHUNK_HEAD.size)
            for i in np.flatnonzero((values == Opcode.CHUNK) | (values == Opcode.ATTACHMENT)).tolist():
                offset, (opcode, length) = begin + i, HEAD.unpack_from(block, i)
                if offset + HEAD.size + length > self.size:
                    continue
                if opcode == Opcode.CHUNK:
                    if chunk_at(offset, block[i : i + CHUNK_HEAD.size]) is not None:
                        return offset
                elif length < _BLOCK_BYTES:
                    with contextlib.suppress(ValueError):
                        self._small_record(offset)
                        return offset
            begin += len(values)
        return None


def _parsed(record: bytes) -> McapRecord:
    return next(StreamReader(io.BytesIO(record), skip_magic=True).records)


def _open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if path.exists() and not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = path.open("rb")
        head = read_bytes(file, 0, len(MAGIC) + 1)
    except FileNotFoundError:
        names = [record.name for record in records_in_folder(path.parent)][:5]
        present = ", ".join(names) or "no record; give the path of one"
        raise RecordError(f"{path}: no such record; {path.parent} has {present}") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    # a file begins as MCAP files do, up to one changed byte, with the first record behind it
    matching = sum(byte == expected for byte, expected in zip(head, MAGIC, strict=False))
    if matching < len(MAGIC) - 1 or (matching < len(MAGIC) and head[len(MAGIC) :] != bytes([Opcode.HEADER])):
        file.close()
        fault = "is not an MCAP file" if head else "is empty, or cannot be read from its disk"
        raise RecordError(f"{path}: {fault}; a record is made by rig run")
    return file
