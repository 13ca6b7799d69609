"""Reader of a record, complete, truncated or being written; it reads by chunks, in constant memory."""

import datetime
import time
from collections.abc import Collection, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from acquisition.frames.losses import FrameLosses
from acquisition.record import PIXELS_SUFFIX, is_pixel_file, pixels_path
from acquisition.record.chunk import MESSAGE_HEAD_BYTES, Message
from acquisition.record.chunk import Piece as Piece
from acquisition.record.codec import decode_window, preview_step
from acquisition.record.digest import is_being_written, utc
from acquisition.record.events import Event
from acquisition.record.read_file import ReadFile
from acquisition.record.schemas import MessageType
from acquisition.record.topics import (
    BALANCE,
    DEFLECTION_FIELDS,
    EVENT,
    HALF_CYCLE,
    IMAGE,
    KIND_OF,
    METADATA_COPY,
    PIXEL_TOPICS,
    PREVIEW_TOPIC,
    SPOT,
    WINDOW,
    RecordedLosses,
    RecordedNote,
    RecordedWindow,
    TimedMessage,
    number_topics,
)
from processing.balance import Balance, names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.swing import HalfCycle

_Value = TypeVar("_Value", bound=TimedMessage)

_ROWS_PER_TABLE = 4096
_FOLLOW_INTERVAL_S = 0.1


class RecordReader:
    """Reads the messages of one record as values; a context manager.

    `path` is the file of numbers; the file of pixels beside it is opened, too, if it exists. A chunk whose
    checksum is wrong is left out, listed in `damages` and logged; everything else is read. A file without an
    ending, as after a crash or a power failure, is `truncated`; its complete chunks are read. While a record
    is still being written, `update` and `follow` list what has been flushed since. `numbers` is the file of
    numbers, with its table of contents, of which the last `kept_pieces` chunks stay in memory. Raises
    RecordError for a file that is missing, or is no record of this program and schema.
    """

    def __init__(self, path: Path, kept_pieces: int = 0) -> None:
        if is_pixel_file(path):
            record = path.name.removesuffix(PIXELS_SUFFIX)
            raise RecordError(f"{path}: has the pixels of a record; name the record beside it, {record}.mcap")
        self.path = path
        self.numbers = ReadFile(path, kept_pieces)
        self._pixels: ReadFile | None = None
        self._chunks_read, self._picture_chunks_read, self._picture_due_ns = 0, 0, 0
        try:
            self.metadata = self.numbers.metadata
            self._identity = self.metadata["record"]
            self.deflection_unit = DeflectionUnit(self._identity["deflection_unit"])
            self.epoch_offset_ns = int(self._identity["epoch_offset_ns"])
            topics = number_topics(self.deflection_unit)
            self._kinds = {topic: kind for topic, kind in topics.items() if isinstance(kind, MessageType)}
            self.numbers.channels = dict(enumerate(topics, start=1))
            self._open_pixels()
        except OSError as error:
            self.close()
            raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
        except BaseException:
            self.close()
            raise

    def _open_pixels(self) -> None:
        """Open the file of pixels, if it is there and belongs to this record."""
        path = pixels_path(self.path)
        if self._pixels is not None or not path.is_file():
            return
        try:
            pixels = ReadFile(path)
            try:
                if pixels.metadata["record"]["record_id"] != self._identity["record_id"]:
                    raise RecordError(f"{path}: has not the pixels of this record")
            except BaseException:
                pixels.close()
                raise
        except RecordError as error:
            # while a record is written, or where it was cut, its file of pixels may only have begun
            if self.numbers.is_complete:
                self.numbers.note_damage(0, str(error))
            return
        pixels.channels = dict(enumerate(PIXEL_TOPICS, start=1))
        self._pixels = pixels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in self.files:
            file.close()

    @property
    def files(self) -> tuple[ReadFile, ...]:
        """The file of numbers, and that of pixels where there is one."""
        return (self.numbers,) if self._pixels is None else (self.numbers, self._pixels)

    @property
    def damages(self) -> list[str]:
        """Damaged parts that were found so far, in words."""
        return [damage for file in self.files for damage in file.damages.values()]

    @property
    def truncated(self) -> bool:
        """Whether a file was cut short, so that it has no ending."""
        return not all(file.is_complete for file in self.files)

    @property
    def is_sound(self) -> bool:
        """Whether every byte is as it was written, by the checksums of summaries and data sections."""
        return all(file.is_sound() for file in self.files)

    @property
    def cut_notice(self) -> str:
        """One line for the user about a truncated record, with the remedy; empty if it is complete."""
        truncated = [file.path for file in self.files if not file.is_complete]
        if not truncated:
            return ""
        return (
            f"{truncated[0]}: was cut short (it has no ending); its complete part is used, "
            f"rig record recover {self.path} makes a complete file of it"
        )

    def doubts(self) -> list[str]:
        """Warnings, one line each, that belong to all data read so far: cut short, damaged or changed."""
        lines = [f"damaged, not used: {damage}" for damage in self.damages]
        return [self.cut_notice, *lines] if self.truncated else lines

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name, without those that have no intact copy; `damages` lists damaged copies."""
        copies = {name: next(self.numbers.copies(name), None) for name in self.numbers.attachments}
        return {name: data for name, data in copies.items() if name != METADATA_COPY and data is not None}

    def update(self) -> bool:
        """List what has been flushed since the last call; True if anything has."""
        self._open_pixels()
        has_new = [file.update() for file in self.files]
        return any(has_new)

    def follow(self, interval_s: float = _FOLLOW_INTERVAL_S) -> Iterator[None]:
        """Yield once at the beginning, and once after each flush of a record that is being written.

        The iteration ends when the record is closed or its writer is gone; it looks every `interval_s`.
        """
        yield None
        while not self.numbers.is_complete:
            # checked before `update`, so that the last flush of a writer that ends meanwhile is read
            has_writer = is_being_written(self.path)
            if self.update():
                yield None
            elif not has_writer:
                return
            else:
                time.sleep(interval_s)

    def unread(self) -> Iterator[Piece]:
        """Messages by topic of each chunk of numbers that this method has not yielded before.

        A chunk holds what was written between two flushes, so a growing record and a complete one yield
        the same pieces. A damaged chunk yields an empty piece, and is listed in `damages`.
        """
        while self._chunks_read < len(self.numbers.chunks):
            self._chunks_read += 1
            yield self.numbers.piece(self.numbers.chunks[self._chunks_read - 1])

    def unread_pictures(self, interval_ns: int, until_ns: int) -> Iterator[tuple[int, int, bytes]]:
        """Frame number, time and JPEG of previews that this method has not yielded before, in order of time.

        They are at least `interval_ns` apart; chunks that begin after `until_ns` are left for a later call.
        """
        # imported here: a fit, which reads no previews, would load Google's protobuf for nothing
        from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

        while self._pixels is not None and self._picture_chunks_read < len(self._pixels.chunks):
            chunk = self._pixels.chunks[self._picture_chunks_read]
            if chunk.start_ns - self.epoch_offset_ns > until_ns:
                return
            self._picture_chunks_read += 1
            if chunk.end_ns - self.epoch_offset_ns < self._picture_due_ns:
                continue
            for message in self._pixels.piece(chunk).messages(PREVIEW_TOPIC):
                time_ns = message.log_time_ns - self.epoch_offset_ns
                if time_ns >= self._picture_due_ns:
                    self._picture_due_ns = time_ns + interval_ns
                    yield message.sequence, time_ns, bytes(CompressedImage.FromString(message.data).data)

    @property
    def picture_shape(self) -> tuple[tuple[int, int], int]:
        """(ny, nx) of the previews, and the whole number by which they are smaller than a frame."""
        frame = self.metadata.get("frame", {})
        ny, nx = (int(frame.get(name, "1")) for name in ("height_px", "width_px"))
        step = preview_step((ny, nx))
        return (-(-ny // step), -(-nx // step)), step

    @property
    def full_scale_dn(self) -> int:
        """Largest grey value of the camera; 255 if the record does not state it."""
        return int(self.metadata.get("camera", {}).get("full_scale_dn", "255"))

    def utc(self, time_ns: int) -> datetime.datetime:
        """UTC of a time on the frames' clock."""
        return utc(time_ns + self.epoch_offset_ns)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of messages by topic as the files state them, damaged ones included; none is 0."""
        return {topic: count for file in self.files for topic, count in file.message_counts().items()}

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """Messages of a topic in the order of the file, which is that of time.

        Those before `start_ns` (on the frames' clock) are left out, and chunks before it are not read.
        """
        from_ns = self._utc_ns(start_ns)
        for file in self.files:
            for piece in file.pieces(topic, from_ns):
                yield from (message for message in piece.messages(topic) if message.log_time_ns >= from_ns)

    def _utc_ns(self, start_ns: int | None) -> int:
        """Log time of a time on the frames' clock; 0 for the record's beginning (None)."""
        return 0 if start_ns is None else start_ns + self.epoch_offset_ns

    def _decoded(self, kind: MessageType, piece: Piece | None) -> Iterator[tuple[Any, ...]]:
        """Fields of the messages of a type: of all, or of those in a piece."""
        messages = self.messages(kind.topic) if piece is None else piece.messages(kind.topic)
        return (kind.decode(message.data) for message in messages)

    def table(self, topic: str, piece: Piece | None = None) -> NDArray[Any]:
        """Messages of a topic of numbers, all or those in a piece, as a structured array (n,).

        The names of the fields are those in the file, with units.
        """
        kind = self._kinds[topic]
        tables = list(self._tables(kind, self.numbers.pieces(topic) if piece is None else [piece]))
        return np.concatenate(tables) if tables else np.empty(0, dtype=kind.table_dtype)

    def values(self, value_class: type[_Value], piece: Piece | None = None) -> list[_Value]:
        """All values of a class that were written, or those in a piece."""
        return [value_class(*fields) for fields in self._decoded(KIND_OF[value_class], piece)]

    def spots(self) -> NDArray[Any]:
        """All spots as a structured array (n,) with the fields of `topics.SPOT`, one row per frame.

        Without a lever (`deflection_unit` is px) the deflections are in px, see `topics.TYPES_BY_UNIT`. NaN
        where the spot was lost.
        """
        return self.table(SPOT.topic)

    def deflections(self, spots: NDArray[Any] | None = None) -> Deflections:
        """Deflections in rows returned by `spots` or `spot_blocks`; by default of the whole record."""
        spots, unit = self.spots() if spots is None else spots, self.deflection_unit
        # copies, so that the deflections do not keep the whole table in memory
        x, y, u_x, u_y = (np.array(spots[name], dtype=np.float64) for name in DEFLECTION_FIELDS[unit])
        return Deflections(np.array(spots["time_ns"], dtype=np.int64), x, y, u_x, u_y, unit)

    def spot_blocks(
        self, start_ns: int | None = None, fields: Collection[str] | None = None
    ) -> Iterator[NDArray[Any]]:
        """The same as `spots`, some thousand at a time, for records larger than memory.

        With `start_ns` (on the frames' clock), spots before that time are left out, and chunks before it are
        not read. With `fields`, only these fields (and `time_ns`) are decoded, which is faster.
        """
        names = None if fields is None else {"time_ns", *fields}
        pieces = self.numbers.pieces(SPOT.topic, self._utc_ns(start_ns))
        for table in self._tables(self._kinds[SPOT.topic], pieces, names):
            block = table if start_ns is None else table[table["time_ns"] >= start_ns]
            if len(block):
                yield block

    def half_cycles(self, piece: Piece | None = None) -> list[HalfCycle]:
        """All half-cycles, or those in a piece, with amplitudes in `deflection_unit`."""
        # the first fields of a row are those of `HalfCycle` in order
        count = len(HalfCycle.__dataclass_fields__)
        return [HalfCycle(*row[:count]) for row in self.table(HALF_CYCLE.topic, piece).tolist()]

    def balances(self, piece: Piece | None = None) -> list[Balance]:
        """All balances, or those in a piece, in `deflection_unit`."""
        names, unit = names_with_units(self.deflection_unit), self.deflection_unit
        rows = self.table(BALANCE.topic, piece).tolist()
        return [Balance(**dict(zip(names, row, strict=True)), unit=unit) for row in rows]

    def events(self, piece: Piece | None = None) -> list[Event]:
        """All events, or those in a piece."""
        return [Event(*fields[:3]) for fields in self._decoded(EVENT, piece)]

    def notes(self) -> list[RecordedNote]:
        """Notes of operators during the run."""
        return self.values(RecordedNote)

    def losses(self) -> FrameLosses | None:
        """Numbers of lost frames by cause; None in a record that was cut before they were written."""
        losses = self.values(RecordedLosses)
        return FrameLosses(*losses[-1][1:]) if losses else None

    def windows(self, start_ns: int | None = None) -> Iterator[RecordedWindow]:
        """Windows around the spot, in order of time, one at a time; `start_ns` as in `spot_blocks`."""
        for message in self.messages(WINDOW.topic, start_ns):
            yield decode_window(WINDOW, message.data)

    def images(self, start_ns: int | None = None, every: int = 1) -> Iterator[Frame]:
        """Every `every`-th whole frame, in order of time, one at a time; `start_ns` as in `spot_blocks`.

        Device time and host time of each are both the frame's time, because a record has no other for it.
        """
        for message in islice(self.messages(IMAGE.topic, start_ns), 0, None, every):
            sequence, time_ns, image, _ = decode_window(IMAGE, message.data)
            yield Frame(image, sequence, time_ns, time_ns)

    def _tables(
        self, kind: MessageType, pieces: Iterable[Piece], fields: Collection[str] | None = None
    ) -> Iterator[NDArray[Any]]:
        """Messages of numbers, some thousand rows at a time: a chunk may hold only a few dozen."""
        expected_bytes = MESSAGE_HEAD_BYTES + kind.wire_dtype.itemsize
        rows = bytearray()
        for piece in pieces:
            for row_bytes, run in piece.rows(kind.topic):
                if row_bytes != expected_bytes:
                    raise RecordError(f"{self.path}: {kind.topic} has other fields than this version writes")
                rows += run
            if len(rows) >= _ROWS_PER_TABLE * expected_bytes:
                yield kind.decode_table(rows, fields, MESSAGE_HEAD_BYTES)
                rows = bytearray()
        if rows:
            yield kind.decode_table(rows, fields, MESSAGE_HEAD_BYTES)
