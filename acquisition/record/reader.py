"""Reads a record, complete or truncated, chunk by chunk; memory does not grow with the file."""

import datetime
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.frame_losses import FrameLosses
from acquisition.record.chunk_reader import Message, messages_in, packed_messages
from acquisition.record.events import Event
from acquisition.record.foxglove import decode_log
from acquisition.record.pixels import decode_image, decode_window
from acquisition.record.proved_file import ProvedFile
from acquisition.record.schemas import MessageType, parse_message_type
from acquisition.record.spots_and_swings import balances_of, deflections_of, swings_of
from acquisition.record.topics import (
    BALANCE,
    EVENT,
    IMAGE_TOPIC,
    LOG_TOPIC,
    LOSSES,
    NOTE,
    SPOT,
    SPOT_UNCALIBRATED,
    SWING,
    SWING_UNCALIBRATED,
    WINDOW,
    RecordedLog,
    RecordedLosses,
    RecordedNote,
    RecordedWindow,
)
from acquisition.record.utc import utc
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.swing import Swing

_Value = TypeVar("_Value")
_ROWS_AT_ONCE = 4096


class RecordReader(ProvedFile):
    """Reads the messages of one record as values; a context manager (see `ProvedFile`)."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._types: dict[str, MessageType] = {}

    @property
    def full_scale_dn(self) -> int:
        """Largest grey value of the camera; 255 if the record does not state it."""
        return int(self.metadata.get("camera", {}).get("full_scale_dn", "255"))

    def utc(self, time_ns: int) -> datetime.datetime:
        """UTC of a time on the frames' clock."""
        return utc(time_ns + self.epoch_offset_ns)

    @property
    def deflection_unit(self) -> DeflectionUnit:
        """Unit of deflections and amplitudes: rad, or px without a calibrated lever."""
        return DeflectionUnit(self.metadata["record"]["deflection_unit"])

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of messages by topic as stated in the file, including damaged ones."""
        return {
            channel.topic: self.contents.counts[number] for number, channel in self.contents.channels.items()
        }

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """Messages of a topic in the order of the file, which is that of time.

        Those before `start_ns` (on the frames' clock) are left out, and chunks before it are not read.
        """
        from_ns = 0 if start_ns is None else start_ns + self.epoch_offset_ns
        for messages in self.by_chunk(messages_in, topic, start_ns):
            for message in messages:
                if message.log_time_ns >= from_ns:
                    yield message

    def table(self, topic: str) -> NDArray[Any]:
        """All messages of a topic of numbers as a structured array (n,).

        The names of the fields are those in the file, with units. Empty if the record has no such topic.
        """
        kind = self.message_type(topic)
        if kind is None:
            return np.empty(0, dtype=np.dtype([]))
        table = np.empty(self.counts[topic], dtype=kind.table_dtype)
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
        """All messages of a topic as values of the dataclass or NamedTuple with which they were written."""
        kind = self.message_type(topic)
        if kind is None:
            return []
        return [
            value_class(**dict(zip(kind.names, kind.decode(message.data), strict=True)))
            for message in self.messages(topic)
        ]

    def spots(self) -> NDArray[Any]:
        """All spots as a structured array (n,) with the fields of `topics.SPOT`, one row per frame.

        Without a lever (`deflection_unit` is px) the fields are those of `topics.SPOT_UNCALIBRATED`. NaN
        where the spot was lost.
        """
        if self.message_type(SPOT.topic) is None:
            # cut before anything was measured
            calibrated = self.deflection_unit is DeflectionUnit.RAD
            return np.empty(0, (SPOT if calibrated else SPOT_UNCALIBRATED).table_dtype)
        return self.table(SPOT.topic)

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
        kind = self._type_of(SPOT if self.deflection_unit is DeflectionUnit.RAD else SPOT_UNCALIBRATED)
        if kind is None:
            return
        wanted = None if fields is None else {"time_ns", *fields}
        for table in self._tables(kind, start_ns, wanted):
            if start_ns is not None:
                table = table[table["time_ns"] >= start_ns]
            if len(table):
                yield table

    def swings(self) -> list[Swing]:
        """All half-cycles, with amplitudes in `deflection_unit`."""
        self._type_of(SWING if self.deflection_unit is DeflectionUnit.RAD else SWING_UNCALIBRATED)
        return swings_of(self.table(SWING.topic))

    def balances(self) -> list[Balance]:
        """All balances, in `deflection_unit`."""
        return balances_of(self.table(BALANCE.topic), self.deflection_unit)

    def events(self) -> list[Event]:
        """All events."""
        return self.values(EVENT.topic, Event)

    def notes(self) -> list[RecordedNote]:
        """What operators have noted during the run."""
        return self.values(NOTE.topic, RecordedNote)

    def losses(self) -> FrameLosses | None:
        """Numbers of lost frames by cause; None in a record that was cut before they were written."""
        found = self.values(LOSSES.topic, RecordedLosses)
        return FrameLosses(*found[-1][1:]) if found else None

    def windows(self, start_ns: int | None = None) -> Iterator[RecordedWindow]:
        """Windows around the spot, in order of time, one at a time; `start_ns` as in `spot_blocks`."""
        kind = self.message_type(WINDOW.topic)
        if kind is None:
            return
        for message in self.messages(WINDOW.topic, start_ns):
            yield decode_window(kind, message.data)

    def images(self, start_ns: int | None = None) -> Iterator[Frame]:
        """Whole frames, in order of time, one at a time; `start_ns` as in `spot_blocks`.

        Their device time and host time are both the time of the frame: a record has no other time for them.
        """
        for message in self.messages(IMAGE_TOPIC, start_ns):
            time_ns = message.log_time_ns - self.epoch_offset_ns
            yield Frame(decode_image(message.data), message.sequence, time_ns, time_ns)

    def log(self) -> list[RecordedLog]:
        """Lines of the log."""
        offset_ns = self.epoch_offset_ns
        return [
            decode_log(message.log_time_ns - offset_ns, message.data) for message in self.messages(LOG_TOPIC)
        ]

    def _tables(
        self, kind: MessageType, start_ns: int | None = None, fields: Collection[str] | None = None
    ) -> Iterator[NDArray[Any]]:
        """The numbers of a topic, some thousand rows at a time: a chunk may hold only a few dozen."""
        held: list[NDArray[np.void]] = []
        count = 0
        for part in self.by_chunk(packed_messages, kind.topic, start_ns):
            held.append(part)
            count += len(part)
            if count >= _ROWS_AT_ONCE:
                yield kind.decode_table(np.concatenate(held), fields)
                held, count = [], 0
        if held:
            yield kind.decode_table(np.concatenate(held), fields)

    def _type_of(self, own: MessageType) -> MessageType | None:
        """Type of a topic's messages, which must have the fields of `own`; None without the topic."""
        found = self.message_type(own.topic)
        if found is not None and (found.numbers, found.tail) != (own.numbers, own.tail):
            raise RecordError(f"{self.path}: topic {own.topic} has other fields than this version writes")
        return found

    def message_type(self, topic: str) -> MessageType | None:
        """Message type of a topic as described in the file; None if the record has no such topic."""
        if topic not in self._types:
            for channel in self.contents.channels.values():
                if channel.topic == topic:
                    schema = self.contents.schemas.get(channel.schema_id)
                    if schema is None:
                        raise RecordError(f"{self.path}: the description of {topic} is damaged")
                    self._types[topic] = parse_message_type(schema.name, topic, schema.data)
        return self._types.get(topic)
