"""Writes one run into one MCAP file; in a crash or a power failure at most the last second is lost."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from acquisition.frame import Frame, Image
from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.container import create_record
from acquisition.record.events import Event, EventKind
from acquisition.record.foxglove import encode_camera_calibration, encode_log, foxglove_topics
from acquisition.record.pixels import encode_image, encode_window
from acquisition.record.schemas import MessageType
from acquisition.record.spots_and_swings import encode_balance, encode_swing, spot_rows
from acquisition.record.topics import (
    BALANCE,
    BALANCE_UNCALIBRATED,
    CAMERA_TOPIC,
    EVENT,
    IMAGE_TOPIC,
    LOG_TOPIC,
    NOTE,
    SCHEMA_VERSION,
    SPOT,
    SPOT_UNCALIBRATED,
    SWING,
    SWING_UNCALIBRATED,
    WINDOW,
    RecordedNote,
)
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot
from processing.swing import Swing

_CHUNK_BYTES = 1024 * 1024
_RESERVE_BYTES = 4 * 1024 * 1024
_FLUSH_INTERVAL_S = 0.6
"""What is lost is at most this and what the disk takes to force it down: 0.6 s are left to it of 1.2 s."""
_LOG_LEVELS = {"info": 2, "warning": 3, "error": 4}
_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml", ".md": "text/markdown"}


class RecordWriter:
    """Writes a record; only one thread may use it.

    The file is created under its final name and never replaces another one; until it is closed it is a
    truncated file, which can be read. Data that were flushed survive a crash and a power failure. Every
    method that writes also flushes if `flush_interval_s` has elapsed, without waiting for the disk;
    `flush_if_due` does the same while nothing is written. When the disk is full, the reserved space is
    released, the data received so far are written, and the file is closed with its ending.

    Parameters
    ----------
    path
        File to create.
    epoch_offset_ns
        Offset in ns that is added to the frames' clock to obtain UTC, in which log times are stored.
    metadata, attachments
        By name; metadata are texts by key. The name "record" is used by the writer itself.
    deflection_unit
        Unit of deflections and amplitudes; in px the names of the fields end in ``_px``.
    reserve_bytes
        Space that is reserved for closing the file on a full disk.
    flush_interval_s
        Longest time until data are flushed.
    clock
        Monotonic clock of the host in s, for the intervals of flushing.

    Raises
    ------
    RecordError
        The file exists or cannot be created. Methods that write raise it if the file can no longer be
        written; the file is then already closed, and `close` does nothing. An error of the disk after a
        method has returned is raised by the next method that flushes.
    """

    def __init__(
        self,
        path: Path,
        epoch_offset_ns: int,
        *,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        deflection_unit: DeflectionUnit = DeflectionUnit.RAD,
        reserve_bytes: int = _RESERVE_BYTES,
        flush_interval_s: float = _FLUSH_INTERVAL_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = path
        self.hurried = False
        """Compress pixels less, in less time; for an owner who sees that data come faster than they go."""
        self._offset_ns = epoch_offset_ns
        self._closed = False
        self._sequence = 0
        self._flush_interval_s = flush_interval_s
        self._clock = clock
        self._flushed_s = clock()
        self._numbers = ChunkBuilder()
        self._pixels = ChunkBuilder()
        self._channels: dict[str, int] = {}
        self._types: dict[str, MessageType] = {}
        self._unit = DeflectionUnit(deflection_unit)
        calibrated = self._unit is DeflectionUnit.RAD
        self._spot = SPOT if calibrated else SPOT_UNCALIBRATED
        self._swing = SWING if calibrated else SWING_UNCALIBRATED
        self._balance = BALANCE if calibrated else BALANCE_UNCALIBRATED
        self._file = create_record(path, reserve_bytes)
        own = {
            "schema_version": str(SCHEMA_VERSION),
            "epoch_offset_ns": str(epoch_offset_ns),
            "deflection_unit": str(self._unit),
        }
        self._guarded(lambda: self._write_head({**(metadata or {}), "record": own}, attachments or {}))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def bytes_written(self) -> int:
        """Present size of the file."""
        return self._file.size

    def write_spots(
        self,
        sequences: Sequence[int],
        device_times_ns: Sequence[int],
        host_times_ns: Sequence[int],
        spots: Sequence[Spot],
        deflections: Deflections,
    ) -> None:
        """Write spots and deflections of n consecutive frames; all arguments have the length n.

        Raises ValueError if the unit of the deflections is not the record's `deflection_unit`.
        """
        self._check_unit(deflections.unit)
        rows = spot_rows(self._spot, sequences, device_times_ns, host_times_ns, spots, deflections)
        self._ready()
        log_times_ns = deflections.times_ns + self._offset_ns
        self._numbers.add_rows(self._channels[SPOT.topic], sequences, log_times_ns, rows)
        self._added(self._numbers)

    def write_window(
        self, sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
    ) -> None:
        """Write the raw pixels (ny, nx) around the spot; (x0, y0) is the first pixel's position on the
        sensor.

        With the fitted `spot` about half the bytes are written. It need not be correct.
        """
        data = encode_window(sequence, time_ns, image, x0_px, y0_px, spot)
        self._add(self._pixels, WINDOW.topic, time_ns, data, sequence=sequence)

    def write_image(self, frame: Frame) -> None:
        """Write a whole frame, as a foxglove.RawImage (mono8, mono16)."""
        parts = encode_image(frame, self._offset_ns + frame.time_ns)
        self._add(self._pixels, IMAGE_TOPIC, frame.time_ns, *parts, sequence=frame.sequence)

    def write_swing(self, swing: Swing) -> None:
        """Write one half-cycle; amplitude and centre in `deflection_unit`."""
        self._add(self._numbers, SWING.topic, swing.turn_time_ns, encode_swing(self._swing, swing))

    def write_balance(self, balance: Balance) -> None:
        """Write one balance. Raises ValueError if its unit is not the record's `deflection_unit`."""
        self._check_unit(balance.unit)
        self._ready()
        self._declare(self._balance)
        self._add(self._numbers, BALANCE.topic, balance.time_ns, encode_balance(self._balance, balance))

    def write_event(self, time_ns: int, kind: str, text: str) -> None:
        """Write an event, also as a line of the log, which viewers display."""
        event = Event(time_ns, kind, text)
        self._add(self._numbers, EVENT.topic, time_ns, EVENT.encode(*event))
        self.write_log(time_ns, _LOG_LEVELS[event.level], "event", event.line)

    def write_note(self, note: RecordedNote) -> None:
        """Write what an operator has noted, also as a line of the log, which viewers display."""
        self.write(NOTE, note, note.time_ns)
        self.write_log(note.time_ns, _LOG_LEVELS[note.event.level], "note", note.event.text)

    def write_log(self, time_ns: int, level: int, source: str, text: str) -> None:
        """Write a line of the log; `level` as in foxglove.Log (1 debug ... 5 fatal)."""
        data = encode_log(self._offset_ns + time_ns, level, source, text)
        self._add(self._numbers, LOG_TOPIC, time_ns, data)

    def write_camera_calibration(
        self,
        time_ns: int,
        sensor_shape: tuple[int, int],
        distance_px: float,
        reference_px: tuple[float, float],
    ) -> None:
        """Write the geometry of the sensor, as a foxglove.CameraCalibration.

        The light lever corresponds to a pinhole camera with the mirror as pinhole. `distance_px` is the arm
        divided by the pixel pitch, `reference_px` the position (x, y) of the spot at zero tilt,
        `sensor_shape` (ny, nx).
        """
        data = encode_camera_calibration(self._offset_ns + time_ns, sensor_shape, distance_px, reference_px)
        self._add(self._numbers, CAMERA_TOPIC, time_ns, data)

    def write(self, kind: MessageType, value: Any, time_ns: int) -> None:
        """Write a value with the fields of its kind; each topic has one kind."""
        self._ready()
        self._declare(kind)
        data = kind.encode(*[getattr(value, name) for name in kind.names])
        self._add(self._numbers, kind.topic, time_ns, data)

    def attach(self, name: str, data: bytes) -> None:
        """Add a file to the record, beside those that it began with."""
        self._ready()
        self._guarded(lambda: self._attach(name, data, time.time_ns()))

    def flush(self) -> None:
        """End the open chunks, force everything to the disk, and wait until that is done."""
        if not self._closed:
            self._guarded(self._flush)

    def flush_if_due(self) -> None:
        """Flush without waiting for the disk, if `flush_interval_s` has elapsed since the last time."""
        if not self._closed and self._clock() - self._flushed_s >= self._flush_interval_s:
            self._guarded(lambda: self._flush(wait=False))

    def close(self) -> None:
        """Write the summary and close the file; a second call does nothing."""
        if self._closed:
            return
        self._guarded(self._flush)
        self._closed = True
        try:
            self._file.finish()
        except OSError as error:
            raise self._not_closed(error) from error

    def _write_head(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
    ) -> None:
        opened_ns = time.time_ns()
        self._file.add_metadata({"record": metadata["record"], **metadata}, opened_ns)
        for name, data in attachments.items():
            self._attach(name, data, opened_ns)
        for kind in (self._spot, self._swing, EVENT, WINDOW):
            self._channel(kind.topic, kind.full_name, kind.descriptor)
        for topic, schema, descriptor in foxglove_topics():
            self._channel(topic, schema, descriptor)
        self._flush()

    def _attach(self, name: str, data: bytes, time_ns: int) -> None:
        media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        self._file.add_attachment(name, media_type, data, time_ns)

    def _channel(self, topic: str, schema: str, descriptor: bytes) -> None:
        self._channels[topic] = self._file.add_channel(topic, schema, descriptor)

    def _declare(self, kind: MessageType) -> None:
        """Add the channel of a topic that only some records have, at its first message."""
        if kind.topic not in self._types:
            self._types[kind.topic] = kind
            self._guarded(lambda: self._channel(kind.topic, kind.full_name, kind.descriptor))

    def _check_unit(self, unit: DeflectionUnit) -> None:
        if unit is not self._unit:
            raise ValueError(
                f"{self.path}: its deflections are in {self._unit}; values in {unit} "
                "must be written into another record"
            )

    def _ready(self) -> None:
        if self._closed:
            raise RecordError(f"{self.path}: is closed; nothing more can be written")

    def _add(
        self,
        builder: ChunkBuilder,
        topic: str,
        time_ns: int,
        *parts: bytes | memoryview,
        sequence: int | None = None,
    ) -> None:
        self._ready()
        if sequence is None:
            sequence = self._sequence
            self._sequence += 1
        builder.add(self._channels[topic], sequence, self._offset_ns + time_ns, *parts)
        self._added(builder)

    def _added(self, builder: ChunkBuilder) -> None:
        if len(builder.data) >= _CHUNK_BYTES:
            self._guarded(lambda: self._file.add_chunk(builder, hurried=self.hurried))
        self.flush_if_due()

    def _flush(self, wait: bool = True) -> None:
        self._file.raise_failure()
        self._file.add_chunk(self._numbers)
        self._file.add_chunk(self._pixels, hurried=self.hurried)
        self._file.sync(wait)
        self._flushed_s = self._clock()

    def _guarded(self, action: Callable[[], None]) -> None:
        """Perform an action on the file; if it fails, close the file as far as possible and raise
        RecordError.
        """
        try:
            action()
            failure = self._file.full
        except OSError as error:
            failure = error
        if failure is not None:
            raise self._end_after(failure) from failure

    def _end_after(self, failure: OSError) -> RecordError:
        """Close the file with the data that can still be written; return the error to be raised."""
        self._closed = True
        what = f"{self.path}: cannot be written: {failure.strerror or failure}"
        reason_ns = max(self._numbers.end_ns, self._pixels.end_ns, self._file.end_ns)
        if EVENT.topic in self._channels:
            # what has no end looks as if nobody knew why
            for kind in (EventKind.RECORD, EventKind.FAILED, EventKind.STOP):
                reason = EVENT.encode(reason_ns - self._offset_ns, kind, what)
                self._numbers.add(self._channels[EVENT.topic], self._sequence, reason_ns, reason)
                self._sequence += 1
        lost = 0
        for builder in (self._numbers, self._pixels):
            try:
                self._file.add_chunk(builder)
            except OSError:
                lost += sum(builder.counts.values())
        try:
            self._file.finish()
        except OSError as error:
            return self._not_closed(error)
        rest = f"; the last {lost} messages could not be written" if lost else ""
        return RecordError(f"{what}; the record is closed and readable{rest}")

    def _not_closed(self, error: OSError) -> RecordError:
        return RecordError(
            f"{self.path}: could not be closed properly: {error.strerror or error}; "
            "rig recover makes a complete file of it"
        )


def compile_window(image: Image, spot: Spot) -> None:
    """Compile what `RecordWriter.write_window` needs for images of this pixel type."""
    encode_window(0, 0, image, 0, 0, spot)
