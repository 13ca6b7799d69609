"""Writes one run into one MCAP file; a crash or power failure loses at most the last second."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from acquisition.frame import Frame, Image
from acquisition.record.balances import encode_balance
from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.container import McapFile
from acquisition.record.events import Event, EventKind
from acquisition.record.foxglove import encode_camera_calibration, encode_log, foxglove_topics
from acquisition.record.pixels import encode_image, encode_window
from acquisition.record.schemas import MessageType, message_type_of
from acquisition.record.spots_and_swings import encode_swing, spot_rows
from acquisition.record.topics import (
    BALANCE,
    BALANCE_UNCALIBRATED,
    CAMERA_TOPIC,
    ENVIRONMENT,
    EVENT,
    IMAGE_TOPIC,
    LIBRARY,
    LOG_TOPIC,
    PACKAGE,
    SCHEMA_VERSION,
    SPOT,
    SPOT_UNCALIBRATED,
    SWING,
    SWING_UNCALIBRATED,
    WINDOW,
    Environment,
)
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot
from processing.swing import Swing

_CHUNK_BYTES = 1024 * 1024
_RESERVE_BYTES = 4 * 1024 * 1024
_FLUSH_INTERVAL_S = 0.8
_LEVEL_INFO, _LEVEL_WARNING = 2, 3
_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml"}


class RecordWriter:
    """One thread's writer of a record.

    The file is made anew under its final name and never overwrites one; as long as it has no
    footer it is a cut one. What was flushed survives a kill or a power cut. Every call that writes
    flushes by itself when `flush_interval_s` has gone by, and does not wait for the disk;
    `flush_if_due` is for the times when nothing is written. When the disk is full a reserve that
    was set aside at the opening is given back, what was handed over is written, and the file is
    closed with its footer.

    Parameters
    ----------
    path
        File to make.
    epoch_offset_ns
        What is added to the frames' clock to give UTC in ns; viewers show wall time.
    metadata, attachments
        By name; metadata are texts by key. The name "record" is the writer's own.
    deflection_unit
        "px" where the rig has no calibration: topics then carry px in their names.
    reserve_bytes
        Room set aside for closing the file on a full disk.
    clock
        Seconds, of the host; when to flush.

    Raises
    ------
    RecordError
        The file exists or cannot be made; later, that it cannot be written any more. The file is
        then closed already, and `close` does nothing. What the disk refuses after a call has
        returned is raised by the next one that flushes.
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
        try:
            self._file = McapFile(path, LIBRARY, reserve_bytes)
        except FileExistsError:
            raise RecordError(
                f"{path}: exists already and is never overwritten; choose another name"
            ) from None
        except OSError as error:
            raise RecordError(f"{path}: cannot be made: {error.strerror or error}") from None
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
        """Size of the file so far."""
        return self._file.size

    def write_spots(
        self,
        sequences: Sequence[int],
        device_times_ns: Sequence[int],
        host_times_ns: Sequence[int],
        spots: Sequence[Spot],
        deflections: Deflections,
    ) -> None:
        """Spots and deflections of some consecutive frames.

        Raises ValueError for deflections in another unit than the record's `deflection_unit`.
        """
        self._check_unit(deflections.unit)
        rows = spot_rows(self._spot, sequences, device_times_ns, host_times_ns, spots, deflections)
        self._ready()
        log_times_ns = deflections.times_ns + self._offset_ns
        self._numbers.add_rows(self._channels[SPOT.topic], sequences, log_times_ns, rows)
        self._added(self._numbers)

    def write_window(self, sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int) -> None:
        """Raw pixels around the spot of one frame. (x0, y0) is the first pixel's place on the sensor."""
        data = encode_window(sequence, time_ns, image, x0_px, y0_px)
        self._add(self._pixels, WINDOW.topic, time_ns, data, sequence=sequence)

    def write_image(self, frame: Frame) -> None:
        """A whole frame, as a foxglove.RawImage (mono8, mono16)."""
        parts = encode_image(frame, self._offset_ns + frame.time_ns)
        self._add(self._pixels, IMAGE_TOPIC, frame.time_ns, *parts, sequence=frame.sequence)

    def write_swing(self, swing: Swing) -> None:
        """One half-cycle; amplitude and centre in `deflection_unit`."""
        self._add(self._numbers, SWING.topic, swing.turn_time_ns, encode_swing(self._swing, swing))

    def write_balance(self, balance: Balance) -> None:
        """One balance. Raises ValueError for one in another unit than the record's `deflection_unit`."""
        self._check_unit(balance.unit)
        self._ready()
        self._declare(self._balance)
        self._add(self._numbers, BALANCE.topic, balance.time_ns, encode_balance(self._balance, balance))

    def write_event(self, time_ns: int, kind: str, text: str) -> None:
        """Something that happened; also a line of the log, which viewers show without being told."""
        event = Event(time_ns, kind, text)
        self._add(self._numbers, EVENT.topic, time_ns, EVENT.encode(*event))
        self.write_log(time_ns, _LEVEL_WARNING if event.is_warning else _LEVEL_INFO, "event", event.line)

    def write_log(self, time_ns: int, level: int, source: str, text: str) -> None:
        """A line for the viewers' log panels; `level` as in foxglove.Log (1 debug ... 5 fatal)."""
        data = encode_log(self._offset_ns + time_ns, level, source, text)
        self._add(self._numbers, LOG_TOPIC, time_ns, data)

    def write_environment(
        self,
        time_ns: int,
        temperature_c: float = np.nan,
        humidity_percent: float = np.nan,
        pressure_pa: float = np.nan,
    ) -> None:
        """What the sensors of the laboratory say; NaN for what is not measured."""
        self.write(
            ENVIRONMENT.topic, Environment(time_ns, temperature_c, humidity_percent, pressure_pa), time_ns
        )

    def write_camera_calibration(
        self,
        time_ns: int,
        sensor_shape: tuple[int, int],
        distance_px: float,
        reference_px: tuple[float, float],
    ) -> None:
        """The sensor as seen from the mirror, as a foxglove.CameraCalibration.

        The light lever is a pinhole camera whose pinhole is the mirror: `distance_px` is the arm over
        the pixel pitch, `reference_px` the spot (x, y) at zero tilt, `sensor_shape` (ny, nx).
        """
        data = encode_camera_calibration(self._offset_ns + time_ns, sensor_shape, distance_px, reference_px)
        self._add(self._numbers, CAMERA_TOPIC, time_ns, data)

    def write(self, topic: str, value: Any, time_ns: int) -> None:
        """Any flat dataclass or NamedTuple of int, float, bool and str, under any topic of its own."""
        self._ready()
        kind = self._types.get(topic)
        if kind is None:
            value_class = type(value)
            kind = message_type_of(value_class, f"{PACKAGE}.{value_class.__name__}", topic)
            self._declare(kind)
        data = kind.encode(*[getattr(value, name) for name in kind.names])
        self._add(self._numbers, topic, time_ns, data)

    def flush(self) -> None:
        """End the open chunks and force everything to the disk; returns when it is there."""
        if not self._closed:
            self._guarded(self._flush)

    def flush_if_due(self) -> None:
        """Flush without waiting for the disk, where `flush_interval_s` has gone by since the last time."""
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
        self._file.add_metadata("record", metadata["record"])
        for name, texts in metadata.items():
            if name != "record":
                self._file.add_metadata(name, texts)
        opened_ns = time.time_ns()
        for name, data in attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._file.add_attachment(name, media_type, data, opened_ns)
        for kind in (self._spot, self._swing, EVENT, WINDOW):
            about = metadata["record"] if kind is self._spot else None
            self._channel(kind.topic, kind.full_name, kind.descriptor, about)
        for topic, schema, descriptor in foxglove_topics():
            self._channel(topic, schema, descriptor)
        self._flush()

    def _channel(
        self, topic: str, schema: str, descriptor: bytes, about: Mapping[str, str] | None = None
    ) -> None:
        self._channels[topic] = self._file.add_channel(topic, schema, descriptor, about)

    def _declare(self, kind: MessageType) -> None:
        """Make the channel of a topic that only some records have, at its first message."""
        if kind.topic not in self._types:
            self._types[kind.topic] = kind
            self._guarded(lambda: self._channel(kind.topic, kind.full_name, kind.descriptor))

    def _check_unit(self, unit: DeflectionUnit) -> None:
        if unit is not self._unit:
            raise ValueError(
                f"{self.path}: its deflections are in {self._unit}; these, in {unit}, "
                "belong into another record"
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
            self._guarded(lambda: self._file.add_chunk(builder))
        self.flush_if_due()

    def _flush(self, wait: bool = True) -> None:
        self._file.raise_failure()
        self._file.add_chunk(self._numbers)
        self._file.add_chunk(self._pixels)
        self._file.sync(wait)
        self._flushed_s = self._clock()

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do something with the file; a failure closes it as well as it goes and raises RecordError."""
        try:
            action()
            failure = self._file.full
        except OSError as error:
            failure = error
        if failure is not None:
            raise self._end_after(failure) from failure

    def _end_after(self, failure: OSError) -> RecordError:
        """Close the file with what can still be written, and say how that went."""
        self._closed = True
        what = f"{self.path}: cannot be written: {failure.strerror or failure}"
        reason_ns = max(self._numbers.end_ns, self._pixels.end_ns, self._file.end_ns)
        if EVENT.topic in self._channels:
            reason = EVENT.encode(reason_ns - self._offset_ns, EventKind.RECORD, what)
            self._numbers.add(self._channels[EVENT.topic], self._sequence, reason_ns, reason)
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
        rest = f"; the last {lost} messages had no room" if lost else ""
        return RecordError(f"{what}; the record is closed and readable{rest}")

    def _not_closed(self, error: OSError) -> RecordError:
        return RecordError(
            f"{self.path}: could not be closed properly: {error.strerror or error}; "
            "rig recover makes a whole file of it"
        )
