"""An MCAP file that is being read: its table of contents, and its chunks, verified by their checksums.

A complete file has a summary, whose checksum is verified. Without a valid summary, as after a power failure
or while the file is still written, the data section is walked through from record to record; only the heads
of chunks are read, so that a file of any size takes about a second.
"""

import errno
import io
import json
import logging
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, ChunkIndex, Header, McapRecord, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC

from acquisition.record import records_of
from acquisition.record.chunk import (
    CHUNK_HEAD,
    HEAD,
    ChunkDamage,
    ChunkPlace,
    Contents,
    Damage,
    chunk_content,
    decompress_chunk,
)
from acquisition.record.topics import LIBRARY, METADATA_COPY, SCHEMA_VERSION
from processing.errors import RecordError, require_schema

_log = logging.getLogger(__name__)
_INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode and length of a chunk's message index, channel, bytes of entries, which follow."""
_INDEX_ENTRY_BYTES = 16
_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_SMALL_RECORD_BYTES = 256 * 1024 * 1024
_BLOCK_BYTES = 256 * 1024
_CRC_BYTES = 4
_FAULTS = {errno.EIO, getattr(errno, "EUCLEAN", errno.EIO), getattr(errno, "EBADMSG", errno.EIO)}


class ReadFile:
    """An MCAP file of a record whose chunks and attachments are verified as they are read.

    A chunk whose checksum is wrong is left out, listed in `damages` and logged; everything else is read. A
    file without an ending is read up to its last complete record; `update` reads what has been written since.

    Raises
    ------
    RecordError
        No such file, not an MCAP file, or it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damages: list[Damage] = []
        self._damaged: set[int] = set()
        self.file = open_mcap(path)
        self.contents = Contents()
        try:
            self.update()
        except OSError as error:
            self.file.close()
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def update(self) -> bool:
        """List what has been written since the last call; True if anything has."""
        size = self.file.seek(0, os.SEEK_END)
        if self.contents.whole or size == self.contents.size:
            return False
        summarised, contents = Contents(size), self.contents
        if _read_summary(self.file, summarised):
            summarised.channels = contents.channels or summarised.channels
            self.contents = summarised
            return True
        contents.size, contents.whole = size, summarised.whole
        contents.damage += summarised.damage
        end_before = contents.readable_bytes
        _walk(self.file, contents)
        return contents.readable_bytes > end_before

    def chunks_with(self, channel: int, from_ns: int = 0) -> Iterator[bytes]:
        """The decompressed messages of each intact chunk that may have some of this channel.

        Chunks that end before `from_ns` (UTC) are not read.
        """
        for place in self.contents.chunks:
            listed = self.contents.indexed and place.channels
            if place.end_ns < from_ns or (listed and channel not in place.channels):
                continue
            try:
                yield self.open_chunk(place)
            except ChunkDamage as damage:
                self.note_damage(place, str(damage))

    def open_chunk(self, place: ChunkPlace) -> bytes:
        """The decompressed messages of a chunk. Raises ChunkDamage."""
        return decompress_chunk(_read_at(self.file, place.offset, place.length), place.length)

    def attached(self, name: str) -> bytes | None:
        """The first intact copy of an attached file; None without any."""
        for place in self.contents.attachment_places.get(name, ()):
            try:
                return self.attachment_at(place)
            except ValueError as error:
                self._remember(place, Damage(0, 0, (), f"attachment {name}: {error}"))
        return None

    def attachment_at(self, place: int) -> bytes:
        """An attached file. Raises ValueError where its checksum does not match."""
        _, data = _content_at(self.file, place)
        if not _is_intact_attachment(data):
            raise ValueError("its checksum does not match: bytes have changed")
        record = _parsed(Opcode.ATTACHMENT, data)
        assert isinstance(record, Attachment)
        return record.data

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata, read from the attached copy, which has a checksum.

        Raises RecordError where the file is not a record of this program.
        """
        path, contents = self.path, self.contents
        copy = self.attached(METADATA_COPY)
        if copy is None:
            if METADATA_COPY in contents.attachment_places or (
                contents.damage and contents.library == LIBRARY
            ):
                raise RecordError(f"{path}: its own description is damaged")
            if not contents.whole and not len(contents.chunks):
                raise RecordError(f"{path}: was cut short before anything was recorded")
            topics = ", ".join(sorted(contents.channels.values()))
            raise RecordError(
                f"{path}: is an MCAP file of another program (topics: {topics or 'none'}); "
                "only records of rig run can be read"
            )
        metadata: dict[str, dict[str, str]] = json.loads(copy)
        identity = metadata.get("record", {})
        try:
            version = int(identity["schema_version"])
        except (KeyError, ValueError):
            raise RecordError(f"{path}: its own description is damaged: {identity}") from None
        require_schema(str(path), version, SCHEMA_VERSION, RecordError)
        return metadata

    def note_damage(self, place: ChunkPlace, what: str) -> None:
        """Add a damaged chunk to `damages`, once."""
        channels = self.contents.channels
        topics = tuple(sorted(channels[number] for number in place.channels if number in channels))
        self._remember(place.offset, Damage(place.start_ns, place.end_ns, topics, what))

    def _remember(self, offset: int, damage: Damage) -> None:
        if offset not in self._damaged:
            self._damaged.add(offset)
            self.damages.append(damage)
            _log.warning("%s: damaged at byte %d, not used: %s", self.path, offset, damage.description)

    def data_crc_matches(self) -> bool:
        """Whether the data section is as it was written; True for a file that was cut before its checksum."""
        contents = self.contents
        if not contents.data_end:
            return True
        crc, rest = 0, contents.data_end
        while rest > 0 and (block := _read_at(self.file, contents.data_end - rest, min(_BLOCK_BYTES, rest))):
            crc = zlib.crc32(block, crc)
            rest -= len(block)
        return not rest and crc == contents.data_crc

    def is_sound(self) -> bool:
        """Whether every byte is as it was written, by the checksums of summary and data section."""
        contents = self.contents
        return contents.whole and contents.indexed and not contents.damage and self.data_crc_matches()


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if path.exists() and not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = path.open("rb")
        head = _read_at(file, 0, len(MAGIC) + 1)
    except FileNotFoundError:
        raise RecordError(f"{path}: no such record{_records_beside(path)}") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if not _is_magic(head):
        file.close()
        what = "is empty, or cannot be read from its disk" if not head else "is not an MCAP file"
        raise RecordError(f"{path}: {what}; a record is made by rig run")
    return file


def _records_beside(path: Path) -> str:
    """The records beside a missing one, as the end of a message."""
    there = [other.name for other in records_of(path.parent)][:5]
    return f"; {path.parent} has {', '.join(there) or 'no record; give the path of one'}"


def _is_magic(head: bytes) -> bool:
    """Whether a file begins as MCAP files do, up to one changed byte, with the first record behind it."""
    alike = sum(byte == expected for byte, expected in zip(head, MAGIC, strict=False))
    return head[: len(MAGIC)] == MAGIC or (
        alike >= len(MAGIC) - 1 and head[len(MAGIC) :] == bytes([Opcode.HEADER])
    )


def _read_at(file: IO[bytes], place: int, count: int) -> bytes:
    """Bytes from a position on; none where the disk cannot read all of them, as exFAT after a power cut."""
    file.seek(place)
    try:
        return file.read(count)
    except OSError as error:
        # a disk that was pulled out does not mean that the record is damaged
        if error.errno not in _FAULTS:
            raise
        return b""


def _content_at(file: IO[bytes], place: int) -> tuple[int, bytes]:
    """Opcode and content of the record at a position in the file. Raises ValueError if there is none."""
    head = _read_at(file, place, HEAD.size)
    if len(head) < HEAD.size:
        raise ValueError(f"no record at byte {place}")
    opcode, length = HEAD.unpack(head)
    if length > _SMALL_RECORD_BYTES:
        raise ValueError(f"record at byte {place} claims {length} bytes")
    data = _read_at(file, place + HEAD.size, length)
    if len(data) < length:
        raise ValueError(f"record at byte {place} ends early")
    return opcode, data


def _parsed(opcode: int, data: bytes) -> McapRecord:
    """A record of the mcap library from its bytes. Raises ValueError if they are not such a record."""
    stream = StreamReader(io.BytesIO(HEAD.pack(opcode, len(data)) + data), skip_magic=True)
    try:
        return next(stream.records)
    except (struct.error, UnicodeDecodeError, OverflowError, McapError) as error:
        raise ValueError(str(error) or type(error).__name__) from None


def _is_intact_attachment(data: bytes) -> bool:
    return zlib.crc32(data[:-_CRC_BYTES]) == int.from_bytes(data[-_CRC_BYTES:], "little")


def _read_summary(file: IO[bytes], contents: Contents) -> bool:
    """Fill `contents` from the summary; False without a sound one, with the reason in `contents.damage`."""
    end = contents.size - _FOOTER.size - len(MAGIC)
    data = _read_at(file, max(end, 0), _FOOTER.size + len(MAGIC))
    if end < len(MAGIC) or len(data) < _FOOTER.size + len(MAGIC) or data[_FOOTER.size :] != MAGIC:
        return False
    opcode, length, start, _, crc = _FOOTER.unpack_from(data)
    contents.whole = (opcode, length) == (Opcode.FOOTER, _FOOTER.size - HEAD.size)
    if not contents.whole or not start:
        return False
    if not len(MAGIC) <= start - _DATA_END.size <= end:
        contents.damage.append("the footer points outside the file")
        return False
    summary = _read_at(file, start, end - start)
    if crc != zlib.crc32(data[: _FOOTER.size - _CRC_BYTES], zlib.crc32(summary)):
        contents.damage.append("the summary's checksum does not match: bytes have changed")
        return False
    # the checksum has shown that every record of the summary can be read
    for record in StreamReader(io.BytesIO(summary + data), skip_magic=True).records:
        match record:
            case Channel():
                contents.channels[record.id] = record.topic
            case Statistics():
                contents.counts.update(record.channel_message_counts)
            case AttachmentIndex():
                contents.add_attachment(record.name, record.data_size, record.offset)
            case ChunkIndex():
                place = (record.chunk_start_offset, record.chunk_length)
                times = (record.message_start_time, record.message_end_time)
                contents.add_chunk(ChunkPlace(*place, *times, frozenset(record.message_index_offsets)))
    contents.data_end = start - _DATA_END.size
    *_, contents.data_crc = _DATA_END.unpack(_read_at(file, contents.data_end, _DATA_END.size))
    _list_or_note_damage(file, contents, len(MAGIC))
    contents.readable_bytes = contents.size
    contents.indexed = True
    return True


def _walk(file: IO[bytes], contents: Contents) -> None:
    """List the data section record by record, without decompression, up to its last complete record.

    After bytes that are no record, the walk continues at the next intact chunk or attachment.
    """
    place = before = contents.readable_bytes
    while place + HEAD.size <= contents.size:
        data = _read_at(file, place, CHUNK_HEAD.size + 16)
        opcode, length = HEAD.unpack_from(data) if len(data) >= HEAD.size else (0, contents.size)
        end = place + HEAD.size + length
        if end > contents.size or not _list_record(file, contents, place, data):
            # the changed bytes may be the length of the record before, so the search begins inside it
            found = _next_intact_record(file, before + 1, contents.size)
            if found is None:
                break
            contents.damage.append(f"between bytes {before} and {found}: there is no record")
            place = before = found
            continue
        before, place = place, end
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
    contents.readable_bytes = place


def _list_record(file: IO[bytes], contents: Contents, place: int, data: bytes) -> bool:
    """List the record that begins with `data` at `place` in the data section; False where it is no record."""
    opcode, length = HEAD.unpack_from(data)
    if opcode == Opcode.CHUNK:
        if chunk_content(data, HEAD.size + length) is None:
            return False
        _, _, start_ns, end_ns, *_ = CHUNK_HEAD.unpack_from(data)
        contents.add_chunk(ChunkPlace(place, HEAD.size + length, start_ns, end_ns, frozenset()))
    elif opcode == Opcode.MESSAGE_INDEX:
        if len(data) < _INDEX_HEAD.size:
            return False
        _, _, channel, entries_bytes = _INDEX_HEAD.unpack_from(data)
        if entries_bytes % _INDEX_ENTRY_BYTES or HEAD.size + length != _INDEX_HEAD.size + entries_bytes:
            return False
        contents.counts[channel] += entries_bytes // _INDEX_ENTRY_BYTES
    elif opcode == Opcode.DATA_END and HEAD.size + length == _DATA_END.size:
        contents.data_end = place
        *_, contents.data_crc = _DATA_END.unpack_from(data)
    elif opcode in (Opcode.HEADER, Opcode.ATTACHMENT):
        _list_or_note_damage(file, contents, place)
    else:
        # metadata have no checksum, so they are read from their attached copy instead
        return opcode in (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.FOOTER)
    return True


def _list_or_note_damage(file: IO[bytes], contents: Contents, place: int) -> None:
    """List a header or an attachment; damage is noted in `contents.damage`, and the rest stays readable."""
    try:
        record = _parsed(*_content_at(file, place))
    except ValueError as error:
        contents.damage.append(f"the record at byte {place} cannot be read ({error})")
        return
    if isinstance(record, Header):
        contents.library = record.library
    elif isinstance(record, Attachment):
        contents.add_attachment(record.name, len(record.data), place)
    else:
        contents.damage.append(f"the record at byte {place} cannot be read (it is another one)")


def _next_intact_record(file: IO[bytes], place: int, size: int) -> int | None:
    """Position of the next chunk whose lengths agree, or of the next attachment whose checksum matches."""
    while len(block := _read_at(file, place, _BLOCK_BYTES)) > CHUNK_HEAD.size + 16:
        values = np.frombuffer(block, dtype=np.uint8, count=len(block) - CHUNK_HEAD.size - 16)
        for at in np.flatnonzero((values == Opcode.CHUNK) | (values == Opcode.ATTACHMENT)).tolist():
            opcode, length = HEAD.unpack_from(block, at)
            if place + at + HEAD.size + length > size:
                continue
            if opcode == Opcode.CHUNK:
                if chunk_content(block[at : at + CHUNK_HEAD.size + 16], HEAD.size + length) is not None:
                    return place + at
            elif length < _BLOCK_BYTES:
                content = _read_at(file, place + at + HEAD.size, length)
                if len(content) > _CRC_BYTES and _is_intact_attachment(content):
                    return place + at
        place += len(values)
    return None
