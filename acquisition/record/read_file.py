"""One MCAP file while it is read: its table of contents, and its chunks, proved by their checksums.

A complete file has a summary, whose checksum is verified. Without a valid one, as after a power failure or
while it is still written, the data section is walked through from record to record; only the heads of chunks
are read, so that a file of any size takes about a second.
"""

import errno
import io
import logging
import os
import stat
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, ChunkIndex, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

from acquisition.record import records_of
from processing.errors import RecordError

_log = logging.getLogger(__name__)
_Found = TypeVar("_Found", bound=Sized)
_HEAD = struct.Struct("<BQ")
"""Opcode and length of a record's content."""
_CHUNK_HEAD = struct.Struct("<BQQQQII")
"""Opcode, length, first and last log time, bytes without compression, their checksum, length of the
compression's name, which follows, then the bytes' number and the bytes.
"""
_INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode and length of a chunk's message index, channel, bytes of entries, which follow."""
_INDEX_ENTRY_BYTES = 16
_FOOTER = struct.Struct("<BQQQI")
_FOOTER_LENGTH = 20
_DATA_END = struct.Struct("<BQI")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time."""
_MESSAGE_HEAD_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("publish_time_ns", "<u8"),
    ]
)
"""The same as an array's row."""
_COMPRESSIONS = {0: b"", 4: b"zstd"}
"""Names of the compressions of a chunk by their lengths."""
_SMALL_RECORD_BYTES = 256 * 1024 * 1024
_BLOCK_BYTES = 256 * 1024
_CRC_BYTES = 4
_CLASSES: Mapping[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
}
_FAULTS = {errno.EIO, getattr(errno, "EUCLEAN", errno.EIO), getattr(errno, "EBADMSG", errno.EIO)}


class ChunkDamage(ValueError):
    """The chunk's bytes differ from what was written; the message describes how."""


class Damage(NamedTuple):
    """A damaged part of a record: topics and times (UTC) of the chunk, and a description."""

    start_ns: int
    end_ns: int
    topics: tuple[str, ...]
    what: str


class Message(NamedTuple):
    """An encoded message; `log_time_ns` is UTC."""

    channel: int
    sequence: int
    log_time_ns: int
    data: bytes


class ChunkPlace(NamedTuple):
    """Position of a chunk in the file, its range of log times, and the channels in it, as far as known."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


class ChunkPlaces:
    """The chunks in the order of the file, 34 bytes each: a record of one day has 170,000."""

    def __init__(self) -> None:
        self._numbers = array("Q")
        self._sets = array("H")
        self._known: dict[frozenset[int], int] = {}

    def append(self, place: ChunkPlace) -> None:
        """Add the next chunk."""
        self._numbers.extend(place[:4])
        self._sets.append(self._known.setdefault(place.channels, len(self._known)))

    def __len__(self) -> int:
        return len(self._sets)

    def __iter__(self) -> Iterator[ChunkPlace]:
        return self.since(0)

    def since(self, first: int) -> Iterator[ChunkPlace]:
        """The chunks from this one on, counted from 0."""
        channels = list(self._known)
        rows = zip(*[iter(self._numbers[4 * first :])] * 4, self._sets[first:], strict=True)
        for offset, length, start_ns, end_ns, known in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[known])


@dataclass
class Contents:
    """Table of contents of a file.

    `whole` is False for a file without an ending; `readable_bytes` is the end of its last complete record.
    `indexed` is True if the chunks come from a summary with a correct checksum, so that their channels are
    reliable. `schemas` describe the topics, where a summary does. `counts` are the numbers of messages by
    channel. `attachments` are the sizes of attached files, `attachment_places` where their copies are.
    `damage` describes parts of the structure that could not be read.
    """

    size: int = 0
    library: str = ""
    whole: bool = False
    indexed: bool = False
    readable_bytes: int = len(MAGIC)
    channels: dict[int, str] = field(default_factory=dict)
    schemas: dict[str, Schema] = field(default_factory=dict)
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
        """Note what has been written since; whether anything has."""
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
        was = contents.readable_bytes
        _walk(self.file, contents)
        return contents.readable_bytes > was

    def by_chunk(
        self, take: Callable[[bytes, frozenset[int]], _Found], channel: int, from_ns: int = 0
    ) -> Iterator[_Found]:
        """What `take` returns for each chunk's bytes and the channel, if not empty.

        Chunks that end before `from_ns` (UTC) are not read.
        """
        wanted = frozenset({channel})
        for place in self.contents.chunks:
            listed = self.contents.indexed and place.channels
            if place.end_ns < from_ns or (listed and channel not in place.channels):
                continue
            try:
                found = take(self.open_chunk(place), wanted)
            except ChunkDamage as damage:
                self.note_damage(place, str(damage))
                continue
            if len(found):
                yield found

    def open_chunk(self, place: ChunkPlace) -> bytes:
        """The decompressed messages of a chunk. Raises ChunkDamage."""
        record = _read_at(self.file, place.offset, place.length)
        if len(record) < place.length:
            raise ChunkDamage("ends early, or its disk cannot give all of it")
        head = _chunk_head(record, place.length)
        if head is None:
            raise ChunkDamage("its head has changed")
        size, crc, compression, start = head
        data = record[start:]
        if compression:
            try:
                # one changed bit of either size would take gigabytes
                if zstandard.get_frame_parameters(data).content_size != size:
                    raise ChunkDamage("its head has changed: it and its data state different sizes")
                data = zstandard.ZstdDecompressor().decompress(data)
            except zstandard.ZstdError as error:
                raise ChunkDamage(f"cannot be decompressed ({error})") from None
        if len(data) != size or crc != zlib.crc32(data):
            raise ChunkDamage("its checksum does not match: bytes have changed")
        return data

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
        data = _read_record(self.file, place)[1]
        if not _is_intact_attachment(data):
            raise ValueError("its checksum does not match: bytes have changed")
        attachment: Attachment = _parse(Opcode.ATTACHMENT, data)
        return attachment.data

    def note_damage(self, place: ChunkPlace, what: str) -> None:
        """Add a damaged chunk to `damages`, once."""
        channels = self.contents.channels
        topics = tuple(sorted(channels[number] for number in place.channels if number in channels))
        self._remember(place.offset, Damage(place.start_ns, place.end_ns, topics, what))

    def _remember(self, offset: int, damage: Damage) -> None:
        if offset not in self._damaged:
            self._damaged.add(offset)
            self.damages.append(damage)
            _log.warning("%s: damaged at byte %d, not used: %s", self.path, offset, damage.what)

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


def messages_in(data: bytes, channels: frozenset[int] | None = None) -> list[Message]:
    """Messages of the given channels (None: all) in a chunk."""
    unpack, head_size = _MESSAGE_HEAD.unpack_from, _MESSAGE_HEAD.size
    found = []
    for place, size in zip(*_places(data, channels), strict=True):
        _, _, channel, sequence, log_time_ns, _ = unpack(data, place)
        content = data[place + head_size : place + head_size + size]
        found.append(Message(channel, sequence, log_time_ns, content))
    return found


def packed_messages(data: bytes, channels: frozenset[int]) -> NDArray[np.void]:
    """Contents of the messages of these channels, which are of equal length, as the items of an array."""
    places, sizes = _places(data, channels)
    contents = np.array(places, dtype=np.int64) + _MESSAGE_HEAD.size
    return _items(data, contents, sizes[0] if sizes else 0)


def message_heads(data: bytes) -> NDArray[np.void]:
    """Headers (n,) of the messages in a chunk: channel, sequence, log_time_ns and more."""
    places = np.array(_places(data)[0], dtype=np.int64)
    return _items(data, places, _MESSAGE_HEAD.size).view(_MESSAGE_HEAD_DTYPE)


def _items(data: bytes, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copies of `size` bytes each, from the given positions in `data`."""
    # a view of the overlapping items that begin at each byte
    every: NDArray[np.void] = np.ndarray(
        (max(len(data) - size + 1, 0),), dtype=f"V{size}", buffer=data, strides=(1,)
    )
    return every[places]


def _places(data: bytes, channels: frozenset[int] | None = None) -> tuple[list[int], list[int]]:
    """Positions of the messages of the given channels in a chunk, and the sizes of their contents."""
    places, sizes = [], []
    place, end = 0, len(data)
    unpack, head_size, of_message = (
        struct.Struct("<BQH").unpack_from,
        _MESSAGE_HEAD.size,
        Opcode.MESSAGE.value,
    )
    while place < end:
        opcode, length, channel = unpack(data, place)
        following = place + _HEAD.size + length
        # the first chunk also describes the topics
        if opcode == of_message and (channels is None or channel in channels):
            places.append(place)
            sizes.append(following - place - head_size)
        place = following
    return places, sizes


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if path.exists() and not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = path.open("rb")
        head = _read_at(file, 0, len(MAGIC) + 1)
    except FileNotFoundError:
        raise RecordError(f"{path}: no such record{_instead_of(path)}") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if not _is_magic(head):
        file.close()
        what = "is empty, or cannot be read from its disk" if not head else "is not an MCAP file"
        raise RecordError(f"{path}: {what}; a record is made by rig run")
    return file


def _instead_of(path: Path) -> str:
    """What the folder of a missing record has."""
    there = [other.name for other in records_of(path.parent)][:5]
    return f"; {path.parent} has {', '.join(there)}" if there else ""


def _is_magic(head: bytes) -> bool:
    """Whether a file begins as MCAP files do, up to one changed byte, with the first record behind it."""
    alike = sum(byte == expected for byte, expected in zip(head, MAGIC, strict=False))
    return head[: len(MAGIC)] == MAGIC or (
        alike >= len(MAGIC) - 1 and head[len(MAGIC) :] == bytes([Opcode.HEADER])
    )


def _read_at(file: IO[bytes], place: int, count: int) -> bytes:
    """Bytes of a file; none where its disk cannot give some of them, as exFAT's after a power cut."""
    file.seek(place)
    try:
        return file.read(count)
    except OSError as error:
        # a disk that was pulled out is no damage
        if error.errno not in _FAULTS:
            raise
        return b""


def _read_record(file: IO[bytes], place: int) -> tuple[int, bytes]:
    """Opcode and content of the record at a position in the file. Raises ValueError if there is none."""
    head = _read_at(file, place, _HEAD.size)
    if len(head) < _HEAD.size:
        raise ValueError(f"no record at byte {place}")
    opcode, length = _HEAD.unpack(head)
    if length > _SMALL_RECORD_BYTES:
        raise ValueError(f"record at byte {place} claims {length} bytes")
    data = _read_at(file, place + _HEAD.size, length)
    if len(data) < length:
        raise ValueError(f"record at byte {place} ends early")
    return opcode, data


def _parse(opcode: int, data: bytes) -> Any:
    """A record of the mcap library from its bytes. Raises ValueError if they are not such a record."""
    stream = ReadDataStream(io.BytesIO(data))
    try:
        record = _CLASSES[opcode].read(stream)
    except (struct.error, UnicodeDecodeError, OverflowError, McapError) as error:
        raise ValueError(str(error) or type(error).__name__) from None
    if stream.count != len(data):
        raise ValueError("its lengths contradict each other")
    return record


def _is_intact_attachment(data: bytes) -> bool:
    return zlib.crc32(data[:-_CRC_BYTES]) == int.from_bytes(data[-_CRC_BYTES:], "little")


def _chunk_head(data: bytes, length: int) -> tuple[int, int, bytes, int] | None:
    """Size and checksum of a chunk's content, compression, where it starts; None where none of this length
    begins here.
    """
    if len(data) < _CHUNK_HEAD.size:
        return None
    opcode, stated, start_ns, end_ns, size, crc, of_name = _CHUNK_HEAD.unpack_from(data)
    start = _CHUNK_HEAD.size + of_name + 8
    if opcode != Opcode.CHUNK or start_ns > end_ns or of_name not in _COMPRESSIONS or len(data) < start:
        return None
    name = data[_CHUNK_HEAD.size : start - 8]
    content = int.from_bytes(data[start - 8 : start], "little")
    if name != _COMPRESSIONS[of_name] or _HEAD.size + stated != start + content:
        return None
    return None if start + content != (length or start + content) else (size, crc, name, start)


def _read_summary(file: IO[bytes], contents: Contents) -> bool:
    """Fill `contents` from the summary; False without a sound one, with the reason in `contents.damage`."""
    end = contents.size - _FOOTER.size - len(MAGIC)
    data = _read_at(file, max(end, 0), _FOOTER.size + len(MAGIC))
    if end < len(MAGIC) or len(data) < _FOOTER.size + len(MAGIC) or data[_FOOTER.size :] != MAGIC:
        return False
    opcode, length, start, _, crc = _FOOTER.unpack_from(data)
    contents.whole = (opcode, length) == (Opcode.FOOTER, _FOOTER_LENGTH)
    if not contents.whole or not start:
        return False
    if not len(MAGIC) <= start - _DATA_END.size <= end:
        contents.damage.append("the footer points outside the file")
        return False
    summary = _read_at(file, start, end - start)
    if crc != zlib.crc32(data[: _FOOTER.size - _CRC_BYTES], zlib.crc32(summary)):
        contents.damage.append("the summary's checksum does not match: bytes have changed")
        return False
    place, schemas = 0, dict[int, Schema]()
    while place < len(summary):
        opcode, length = _HEAD.unpack_from(summary, place)
        place += _HEAD.size
        # of a sound summary every record can be read
        if opcode in _CLASSES:
            record = _parse(opcode, summary[place : place + length])
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                contents.schemas[record.topic] = schemas[record.schema_id]
            _list_summarised(contents, record)
        place += length
    contents.data_end = start - _DATA_END.size
    *_, contents.data_crc = _DATA_END.unpack(_read_at(file, contents.data_end, _DATA_END.size))
    _list_or_note(file, contents, len(MAGIC))
    contents.readable_bytes = contents.size
    contents.indexed = True
    return True


def _list_summarised(contents: Contents, record: Any) -> None:
    if isinstance(record, Channel):
        contents.channels[record.id] = record.topic
    elif isinstance(record, Statistics):
        contents.counts.update(record.channel_message_counts)
    elif isinstance(record, AttachmentIndex):
        contents.add_attachment(record.name, record.data_size, record.offset)
    elif isinstance(record, ChunkIndex):
        place = (record.chunk_start_offset, record.chunk_length)
        times = (record.message_start_time, record.message_end_time)
        contents.add_chunk(ChunkPlace(*place, *times, frozenset(record.message_index_offsets)))


def _walk(file: IO[bytes], contents: Contents) -> None:
    """List the data section record by record, without decompression, up to its last complete record.

    Behind bytes that are no record it goes on at the next chunk or attached file whose lengths agree.
    """
    place = before = contents.readable_bytes
    while place + _HEAD.size <= contents.size:
        data = _read_at(file, place, _CHUNK_HEAD.size + 16)
        opcode, length = _HEAD.unpack_from(data) if len(data) >= _HEAD.size else (0, contents.size)
        end = place + _HEAD.size + length
        if end > contents.size or not _list_record(file, contents, place, data):
            # the length of the record before may be what has changed
            found = _next_whole(file, before + 1, contents.size)
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
    """List the record of the data section whose first bytes these are; False where there is none."""
    opcode, length = _HEAD.unpack_from(data)
    if opcode == Opcode.CHUNK:
        if _chunk_head(data, _HEAD.size + length) is None:
            return False
        _, _, start_ns, end_ns, *_ = _CHUNK_HEAD.unpack_from(data)
        contents.add_chunk(ChunkPlace(place, _HEAD.size + length, start_ns, end_ns, frozenset()))
    elif opcode == Opcode.MESSAGE_INDEX:
        if len(data) < _INDEX_HEAD.size:
            return False
        _, _, channel, of_entries = _INDEX_HEAD.unpack_from(data)
        if of_entries % _INDEX_ENTRY_BYTES or _HEAD.size + length != _INDEX_HEAD.size + of_entries:
            return False
        contents.counts[channel] += of_entries // _INDEX_ENTRY_BYTES
    elif opcode == Opcode.DATA_END and _HEAD.size + length == _DATA_END.size:
        contents.data_end = place
        *_, contents.data_crc = _DATA_END.unpack_from(data)
    elif opcode in (Opcode.HEADER, Opcode.ATTACHMENT):
        _list_or_note(file, contents, place)
    else:
        # nothing proves metadata: they are read from an attached file
        return opcode in (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.FOOTER)
    return True


def _list_or_note(file: IO[bytes], contents: Contents, place: int) -> None:
    """List header or attached file; if it is damaged, note that and keep the rest readable."""
    try:
        record = _parse(*_read_record(file, place))
        if isinstance(record, Header):
            contents.library = record.library
        else:
            contents.add_attachment(record.name, len(record.data), place)
    except (ValueError, KeyError, AttributeError) as error:
        contents.damage.append(f"the record at byte {place} cannot be read ({error})")


def _next_whole(file: IO[bytes], place: int, size: int) -> int | None:
    """Position of the next chunk whose lengths agree, or attached file whose checksum does."""
    while len(block := _read_at(file, place, _BLOCK_BYTES)) > _CHUNK_HEAD.size + 16:
        values = np.frombuffer(block, dtype=np.uint8, count=len(block) - _CHUNK_HEAD.size - 16)
        for at in np.flatnonzero((values == Opcode.CHUNK) | (values == Opcode.ATTACHMENT)).tolist():
            opcode, length = _HEAD.unpack_from(block, at)
            if place + at + _HEAD.size + length > size:
                continue
            if opcode == Opcode.CHUNK:
                if _chunk_head(block[at : at + _CHUNK_HEAD.size + 16], _HEAD.size + length) is not None:
                    return place + at
            elif length < _BLOCK_BYTES:
                content = _read_at(file, place + at + _HEAD.size, length)
                if len(content) > _CRC_BYTES and _is_intact_attachment(content):
                    return place + at
        place += len(values)
    return None
