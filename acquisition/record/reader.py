"""Reads a record, complete or truncated, chunk by chunk; memory does not grow with the file."""

import datetime
import logging
import math
from collections.abc import Callable, Collection, Iterator, Sized
from functools import partial
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple, Self, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from acquisition.frame import Frame
from acquisition.frame_losses import FrameLosses
from acquisition.record.balances import balances_of
from acquisition.record.chunk_places import ChunkPlace
from acquisition.record.chunk_reader import (
    ChunkDamage,
    OpenedChunk,
    PackedMessages,
    RawMessage,
    UnpackLimit,
    messages_in,
    open_chunk,
    packed_messages,
)
from acquisition.record.contents import Contents, read_contents
from acquisition.record.descriptions import own_texts
from acquisition.record.events import Event
from acquisition.record.foxglove import decode_log
from acquisition.record.pixels import decode_image, decode_window
from acquisition.record.records import MAGIC, intact_attachment, read_record
from acquisition.record.schemas import MessageType, message_type_of, parse_message_type
from acquisition.record.spots_and_swings import deflections_of, spot_table, swings_of
from acquisition.record.topics import (
    BALANCE,
    DEFLECTION_FIELDS,
    EVENT,
    IMAGE_TOPIC,
    LOG_TOPIC,
    LOSSES_TOPIC,
    METADATA_COPY,
    SCHEMA_VERSION,
    SPOT,
    SWING,
    WINDOW,
    RecordedLog,
    RecordedLosses,
    RecordedWindow,
)
from acquisition.record.utc import utc
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.swing import Swing

_log = logging.getLogger(__name__)
_Value = TypeVar("_Value")
_Found = TypeVar("_Found", bound=Sized)
_Decoded = TypeVar("_Decoded")
_ROWS_AT_ONCE = 4096
_SECTIONS = TypeAdapter(dict[str, dict[str, str]])


class Message(NamedTuple):
    """One encoded message; `log_time_ns` is UTC."""

    topic: str
    sequence: int
    log_time_ns: int
    data: bytes


class Damage(NamedTuple):
    """A damaged part of a record: topics and times (UTC) of the chunk, and a description."""

    start_ns: int
    end_ns: int
    topics: tuple[str, ...]
    what: str


class RecordReader:
    """Reads one record; a context manager.

    A chunk whose checksum is wrong is left out, listed in `damages` and logged; everything else is read. A
    file without an ending, as after a crash or a power failure, is `truncated`; its complete chunks are read.

    Parameters
    ----------
    path
        The record.
    validate_crcs
        Whether the checksums of chunks are verified.

    Raises
    ------
    RecordError
        No such file, not an MCAP file, not a record of this program, or a record of a newer version.
    """

    def __init__(self, path: Path, *, validate_crcs: bool = True) -> None:
        self.path = path
        self.damages: list[Damage] = []
        self._validate_crcs = validate_crcs
        self._damaged: set[int] = set()
        self._types: dict[str, MessageType] = {}
        self.file = open_mcap(path)
        try:
            self.contents: Contents = read_contents(self.file)
            self._prove_metadata()
            self._check_ours()
        except OSError as error:
            self.file.close()
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
        except BaseException:
            self.file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    @property
    def truncated(self) -> bool:
        """Whether the file was cut short, so that it has no ending."""
        return not self.contents.whole

    @property
    def cut_notice(self) -> str:
        """One line for the user about a truncated file, with the remedy; empty if the file is complete."""
        if not self.truncated:
            return ""
        return (
            f"{self.path}: was cut short (it has no ending); its complete part is used, "
            f"rig recover {self.path} makes a complete file of it"
        )

    def doubts(self) -> list[str]:
        """What has to be said with everything that was read so far: cut short, damaged, changed; one line
        each.
        """
        lines = [self.cut_notice] if self.truncated else []
        lines += [f"damaged, not used: {damage.what}" for damage in self.damages]
        return lines + [f"the record's structure: {text}" for text in self.contents.damage]

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata: texts by key, by name (session, camera, environment, versions, record)."""
        return self.contents.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name; one of which no copy is intact is left out, every damaged copy listed in
        `damages`.
        """
        found = {name: self._attached(name) for name in self.contents.attachment_places}
        return {name: data for name, data in found.items() if name != METADATA_COPY and data is not None}

    def _attached(self, name: str) -> bytes | None:
        """The first intact copy of an attachment."""
        for place in self.contents.attachment_places.get(name, ()):
            try:
                return intact_attachment(read_record(self.file, place)[1])
            except ValueError as error:
                self._remember(place, Damage(0, 0, (), f"attachment {name}: {error}"))
        return None

    @property
    def epoch_offset_ns(self) -> int:
        """Offset in ns that is added to the frames' clock to obtain UTC."""
        return int(self.metadata["record"]["epoch_offset_ns"])

    @property
    def full_scale_dn(self) -> int:
        """Largest grey value of the camera; 255 if an older record does not state it."""
        return int(self.metadata.get("camera", {}).get("full_scale_dn", "255"))

    def utc(self, time_ns: int) -> datetime.datetime:
        """UTC of a time on the frames' clock."""
        return utc(time_ns + self.epoch_offset_ns)

    @property
    def deflection_unit(self) -> DeflectionUnit:
        """Unit of deflections and amplitudes: rad, or px without a calibrated lever."""
        stated = self.metadata["record"].get("deflection_unit")
        return DeflectionUnit.PX if stated == "px" else DeflectionUnit.RAD

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of messages by topic as stated in the file, including damaged ones."""
        return {
            channel.topic: self.contents.counts[number] for number, channel in self.contents.channels.items()
        }

    def messages(self, *topics: str) -> Iterator[Message]:
        """Messages of the given topics (without any: of all), in the order of the file.

        Numbers and pixels are in different chunks: messages of one topic are in order of time, those of
        different topics only within a chunk.
        """
        names = {number: channel.topic for number, channel in self.contents.channels.items()}
        for raw in chain.from_iterable(self._by_chunk(_messages, frozenset(topics))):
            yield Message(names.get(raw.channel, ""), raw.sequence, raw.log_time_ns, raw.data)

    def table(self, topic: str) -> NDArray[Any]:
        """The numbers of all messages of a topic as a structured array (n,), without texts and bytes.

        The names of the fields are those in the file, with units. Empty if the record has no such topic.
        """
        kind = self._type(topic)
        if kind is None:
            return np.empty(0, dtype=np.dtype([]))
        # what is stated may be a lie: a message takes more than a byte of the file
        table = np.empty(min(self.counts[topic], self.contents.size), dtype=kind.table_dtype)
        filled = 0
        for part in self._tables(kind):
            if filled + len(part) > len(table):
                # the last chunk of a truncated file may lack the index from which messages are counted
                table = np.concatenate([table[:filled], part])
            else:
                table[filled : filled + len(part)] = part
            filled += len(part)
        return table[:filled]

    def values(self, topic: str, value_class: type[_Value]) -> list[_Value]:
        """All messages of a topic as values of the dataclass or NamedTuple with which they were written.

        Fields that an older record does not contain are NaN (float), 0 (int) or empty (str).
        """
        kind = self._type(topic)
        if kind is None:
            return []
        wanted = message_type_of(value_class, kind.full_name, topic)
        absent: dict[str, Any] = {name: math.nan if sort == "double" else 0 for name, sort in wanted.numbers}
        absent |= {name: "" for name, _ in wanted.tail}
        found = []
        for message in self.messages(topic):
            fields = dict(zip(kind.names, self._decoded(topic, message, kind.decode), strict=True))
            found.append(value_class(**{name: fields.get(name, absent[name]) for name in wanted.names}))
        return found

    def spots(self) -> NDArray[Any]:
        """All spots as a structured array (n,) with the fields of `topics.SPOT`, one row per frame.

        Without a lever (`deflection_unit` is px) the fields are those of `topics.SPOT_UNCALIBRATED`. NaN
        where the spot was lost.
        """
        return spot_table(self.table(SPOT.topic), self.deflection_unit)

    def deflections(self, spots: NDArray[Any] | None = None) -> Deflections:
        """Deflections in rows returned by `spots` or `spot_blocks`; without any, those of the whole
        record.
        """
        return deflections_of(self.spots() if spots is None else spots, self.deflection_unit)

    def spot_blocks(
        self, start_ns: int | None = None, fields: Collection[str] | None = None
    ) -> Iterator[NDArray[Any]]:
        """The same as `spots`, some thousand at a time, for records larger than memory.

        With `start_ns` (on the frames' clock), spots before that time are left out, and chunks before it are
        not read. With `fields`, only these fields (and `time_ns`) are decoded, which is faster.
        """
        kind = self._type(SPOT.topic)
        if kind is None:
            return
        wanted = None if fields is None else {"time_ns", *fields}
        for part in self._tables(kind, start_ns, wanted):
            table = spot_table(part, self.deflection_unit, wanted)
            if start_ns is not None:
                table = table[table["time_ns"] >= start_ns]
            if len(table):
                yield table

    def deflection_blocks(self) -> Iterator[Deflections]:
        """The deflections of the whole record, some thousand at a time."""
        for table in self.spot_blocks(fields=DEFLECTION_FIELDS[self.deflection_unit]):
            yield self.deflections(table)

    def swings(self) -> list[Swing]:
        """All half-cycles, with amplitudes in `deflection_unit`."""
        return swings_of(self.table(SWING.topic))

    def balances(self) -> list[Balance]:
        """All balances, in `deflection_unit`; NaN for numbers that an older record does not contain."""
        return balances_of(self.table(BALANCE.topic), self.deflection_unit)

    def events(self) -> list[Event]:
        """All events."""
        return self.values(EVENT.topic, Event)

    def losses(self) -> FrameLosses | None:
        """Numbers of lost frames by cause; None if an older record does not contain them."""
        found = self.values(LOSSES_TOPIC, RecordedLosses)
        return FrameLosses(*found[-1][1:]) if found else None

    def windows(self, start_ns: int | None = None) -> Iterator[RecordedWindow]:
        """Windows around the spot, in order of time, one at a time; `start_ns` as in `spot_blocks`."""
        kind = self._type(WINDOW.topic)
        if kind is None:
            return
        for message in self._since(WINDOW.topic, start_ns):
            yield self._decoded(WINDOW.topic, message, lambda data: decode_window(kind, data))

    def images(self, start_ns: int | None = None) -> Iterator[Frame]:
        """Whole frames, in order of time, one at a time; `start_ns` as in `spot_blocks`.

        Their device time and host time are both the time of the frame: a record has no other time for them.
        """
        for message in self._since(IMAGE_TOPIC, start_ns):
            time_ns = message.log_time_ns - self.epoch_offset_ns
            image = self._decoded(IMAGE_TOPIC, message, decode_image)
            yield Frame(image, message.sequence, time_ns, time_ns)

    def log(self) -> list[RecordedLog]:
        """Lines of the log."""
        offset_ns = self.epoch_offset_ns
        return [
            self._decoded(LOG_TOPIC, message, partial(decode_log, message.log_time_ns - offset_ns))
            for message in self.messages(LOG_TOPIC)
        ]

    def _decoded(
        self, topic: str, message: Message | RawMessage, decode: Callable[[bytes], _Decoded]
    ) -> _Decoded:
        """One message decoded. Raises RecordError if its bytes are sound and yet no such message."""
        try:
            return decode(message.data)
        except (ValueError, DecodeError) as error:
            what = f"message {message.sequence} of {topic} cannot be read ({error})"
            raise RecordError(f"{self.path}: {what}; it was not written by rig run") from None

    def _since(self, topic: str, start_ns: int | None) -> Iterator[RawMessage]:
        """Messages of one topic from a time on the frames' clock on."""
        from_ns = None if start_ns is None else start_ns + self.epoch_offset_ns
        for messages in self._by_chunk(_messages, frozenset([topic]), start_ns):
            for message in messages:
                if from_ns is None or message.log_time_ns >= from_ns:
                    yield message

    def _tables(
        self, kind: MessageType, start_ns: int | None = None, fields: Collection[str] | None = None
    ) -> Iterator[NDArray[Any]]:
        """The numbers of a topic, some thousand rows at a time: a chunk may hold only a few dozen."""
        held: list[NDArray[np.void]] = []
        count = 0
        for part in self._by_chunk(packed_messages, frozenset([kind.topic]), start_ns):
            alike = isinstance(part, np.ndarray) and (not held or part.dtype == held[0].dtype)
            if held and (not alike or count >= _ROWS_AT_ONCE):
                yield self._table_of(kind, np.concatenate(held), fields)
                held, count = [], 0
            if isinstance(part, np.ndarray):
                held.append(part)
                count += len(part)
            else:
                yield self._table_of(kind, part, fields)
        if held:
            yield self._table_of(kind, np.concatenate(held), fields)

    def _table_of(
        self, kind: MessageType, messages: PackedMessages, fields: Collection[str] | None
    ) -> NDArray[Any]:
        try:
            return kind.decode_table(messages, fields)
        except ValueError as error:
            raise RecordError(f"{self.path}: {error}; it was not written by rig run") from None

    def _by_chunk(
        self,
        take: Callable[[OpenedChunk, frozenset[int] | None], _Found],
        topics: frozenset[str],
        start_ns: int | None = None,
    ) -> Iterator[_Found]:
        """What `take` returns for each chunk's bytes and the topics' channels (None: all), if not empty.

        Chunks that end before `start_ns` (on the frames' clock) are not read.
        """
        from_ns = None if start_ns is None else start_ns + self.epoch_offset_ns
        wanted = None
        if topics:
            channels = self.contents.channels.items()
            wanted = frozenset(number for number, channel in channels if channel.topic in topics)
        opened = self.chunk_opener()
        for place in self.contents.chunks:
            if from_ns is not None and place.end_ns < from_ns:
                continue
            listed = self.contents.indexed and place.channels
            if wanted is not None and listed and not wanted & place.channels:
                continue
            try:
                found = take(opened(place), wanted)
            except ChunkDamage as damage:
                self.note_damage(place, str(damage))
                continue
            if len(found):
                yield found

    def chunk_opener(self) -> Callable[[ChunkPlace], OpenedChunk]:
        """What opens the chunks in one pass through them.

        It raises ChunkDamage, and RecordError where they unpack to more than a measurement can.
        """
        limit = UnpackLimit(self.contents.size)

        def opened(place: ChunkPlace) -> OpenedChunk:
            chunk = open_chunk(self.file, place, validate_crc=self._validate_crcs)
            if not limit.allows(max(len(chunk.data), place.length)):
                raise RecordError(
                    f"{self.path}: its chunks unpack to more than can have been measured; "
                    "it was not written by rig run"
                )
            return chunk

        return opened

    def _type(self, topic: str) -> MessageType | None:
        """Message type of a topic as described in the file; None if the record has no such topic."""
        if topic not in self._types:
            for channel in self.contents.channels.values():
                if channel.topic == topic:
                    schema = self.contents.schemas.get(channel.schema_id)
                    if schema is None:
                        raise RecordError(f"{self.path}: the description of {topic} is damaged")
                    try:
                        self._types[topic] = parse_message_type(schema.name, topic, schema.data)
                    except ValueError as error:
                        raise RecordError(f"{self.path}: topic {topic}: {error}") from None
        return self._types.get(topic)

    def note_damage(self, place: ChunkPlace, what: str) -> None:
        """Add a damaged chunk to `damages`, once."""
        channels = self.contents.channels
        topics = tuple(sorted(channels[number].topic for number in place.channels if number in channels))
        self._remember(place.offset, Damage(place.start_ns, place.end_ns, topics, what))

    def _remember(self, offset: int, damage: Damage) -> None:
        if offset not in self._damaged:
            self._damaged.add(offset)
            self.damages.append(damage)
            _log.warning("%s: damaged at byte %d, not used: %s", self.path, offset, damage.what)

    def _prove_metadata(self) -> None:
        """Take the metadata from their copy, which has a checksum."""
        contents = self.contents
        copy = self._attached(METADATA_COPY)
        if copy is None:
            contents.unproved += [f"metadata {name}" for name in contents.metadata]
            return
        try:
            proved = _SECTIONS.validate_json(copy)
        except ValidationError:
            raise RecordError(f"{self.path}: {METADATA_COPY} in it was not written by this program") from None
        changed = [name for name, texts in proved.items() if contents.metadata.get(name) != texts]
        if changed:
            contents.damage.append(f"metadata {', '.join(changed)}: bytes have changed; a copy is taken")
        contents.metadata = proved

    def _check_ours(self) -> None:
        """Check the metadata "record", of which the channel of spots contains a copy.

        The copy is taken if both exist: it is repeated in the summary, which has a checksum.
        """
        metadata = self.metadata.get("record", {})
        spots = (c for c in self.contents.channels.values() if c.topic == SPOT.topic)
        beside = next(map(own_texts, spots), {})
        if metadata and beside and metadata != beside:
            self.contents.damage.append("metadata record differs from its copy: bytes have changed")
        head = {**metadata, **beside}
        if not head:
            topics = ", ".join(sorted(channel.topic for channel in self.contents.channels.values()))
            if not topics and self.truncated:
                raise RecordError(f"{self.path}: was cut short before anything was recorded")
            raise RecordError(
                f"{self.path}: is an MCAP file of another program (topics: {topics or 'none'}); "
                "only records of rig run can be read"
            )
        try:
            version = int(head["schema_version"])
            int(head["epoch_offset_ns"])
        except (KeyError, ValueError):
            raise RecordError(f"{self.path}: its own description is damaged: {head}") from None
        if version > SCHEMA_VERSION:
            raise RecordError(
                f"{self.path}: has schema version {version}, this program reads up to {SCHEMA_VERSION}; "
                "update optical-pendulum-rig"
            )
        self.metadata["record"] = head


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises RecordError if it is missing, cannot be read, or is another kind of file."""
    try:
        if not path.is_dir() and path.exists() and not path.is_file():
            raise RecordError(f"{path}: is not a file but a pipe or device; copy the record into a file")
        file = path.open("rb")
        head = file.read(len(MAGIC) + 1)
    except FileNotFoundError:
        raise RecordError(f"{path}: no such record") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if not _is_magic(head):
        file.close()
        what = "is empty" if not head else "is not an MCAP file"
        raise RecordError(f"{path}: {what}; a record is made by rig run")
    return file


def _is_magic(head: bytes) -> bool:
    """Whether a file begins as MCAP files do, up to one changed byte, with the first record behind it."""
    alike = sum(byte == expected for byte, expected in zip(head, MAGIC, strict=False))
    return head[: len(MAGIC)] == MAGIC or (
        alike >= len(MAGIC) - 1 and head[len(MAGIC) :] == bytes([Opcode.HEADER])
    )


def _messages(chunk: OpenedChunk, channels: frozenset[int] | None) -> list[RawMessage]:
    return list(messages_in(chunk, channels))
