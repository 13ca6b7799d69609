"""Writes one run: numbers into one MCAP file, pixels into another beside it.

In a crash or a power failure at most the last second is lost.
"""

import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log

from acquisition.camera import Frame, Image
from acquisition.record import pixels_path
from acquisition.record.codec import encode_window as encode_window
from acquisition.record.codec import preview_step
from acquisition.record.events import Event, EventKind, Severity
from acquisition.record.mcap_file import McapFile
from acquisition.record.topics import (
    BALANCE,
    CAMERA_TOPIC,
    EVENT,
    HALF_CYCLE,
    IMAGE,
    KIND_OF,
    LOG_TOPIC,
    PIXEL_TOPICS,
    PREVIEW_TOPIC,
    SCHEMA_VERSION,
    SENSOR_FRAME,
    TYPES_BY_UNIT,
    WINDOW,
    RecordedNote,
    RecordedReference,
    TimedMessage,
    number_topics,
)
from processing.balance import Balance, names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD

_RESERVE_BYTES = 4 * 1024 * 1024
_FLUSH_INTERVAL_S = 0.25
"""A crash loses at most this and the time that the disk takes for one flush."""
_LOG_LEVELS = {Severity.INFORMATION: 2, Severity.WARNING: 3, Severity.ALARM: 4, Severity.TRIP: 5}
_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml", ".md": "text/markdown"}


class RecordWriter:
    """Writes a record; only one thread may use it.

    `path` holds all numbers. The first pixels create the file of pixels beside it (`pixels_path`), which
    also holds the previews; deleting that file makes the record smaller, and nothing else.

    The files are created under their final names and never replace others; until it is closed, each is a
    truncated file, which can be read. Data that were flushed survive a crash and a power failure. Every
    method that writes messages also flushes if `flush_interval_s` has elapsed, without waiting for the disk;
    `flush_if_due` does the same while nothing is written. When the disk is full, the reserved space is
    released, the data received so far are written, and the files are closed with their endings.

    Parameters
    ----------
    path
        File to create.
    epoch_offset_ns
        Offset in ns that is added to the frames' clock to obtain UTC, in which log times are stored.
    metadata, attachments
        By name; metadata are texts by key. The name "record" is used by the writer itself.
        ``metadata["camera"]["full_scale_dn"]`` is the white of the previews.
    deflection_unit
        Unit of deflections and amplitudes; in px the names of the fields end in ``_px``.
    reserve_bytes
        Space that is reserved for closing the file on a full disk.
    flush_interval_s
        Longest time until data are flushed.
    clock
        Monotonic clock of the host in s, for the intervals of flushing.

    RecordError is raised where the file exists or cannot be created, and by methods that write if the file
    can no longer be written; the file is then already closed, and `close` does nothing. An error of the disk
    after a method has returned is raised by the next method that flushes.
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
        self._end_ns = 0
        self._flush_interval_s = flush_interval_s
        self._reserve_bytes = reserve_bytes
        self._clock = clock
        self._flushed_s = clock()
        self._unit = DeflectionUnit(deflection_unit)
        self._spot, self._swing, self._balance = TYPES_BY_UNIT[self._unit]
        self._full_scale_dn = int((metadata or {}).get("camera", {}).get("full_scale_dn", "255"))
        self._identity = {
            "schema_version": str(SCHEMA_VERSION),
            "epoch_offset_ns": str(epoch_offset_ns),
            "deflection_unit": str(self._unit),
            "record_id": secrets.token_hex(8),
        }
        if pixels_path(path).exists():
            raise RecordError(
                f"{pixels_path(path)}: exists already and is never overwritten; choose another name"
            )
        self._numbers = McapFile(path, number_topics(self._unit), reserve_bytes)
        self._pixels: McapFile | None = None
        with self._writing():
            self._numbers.add_metadata({**(metadata or {}), "record": self._identity}, time.time_ns())
        for name, data in (attachments or {}).items():
            self.attach(name, data)
        self.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def bytes_written(self) -> int:
        """Present size of both files."""
        return sum(file.disk.size for file in self._files)

    def write_spots(
        self,
        sequences: Sequence[int],
        device_times_ns: Sequence[int],
        host_times_ns: Sequence[int],
        spots: Sequence[Spot],
        deflections: Deflections,
        references: Sequence[Spot] = (),
    ) -> None:
        """Write spots and deflections of n consecutive frames; all arguments have the length n.

        `references` are the spots of the reference, where the frames have one. Raises ValueError if the unit
        of the deflections is not the record's `deflection_unit`.
        """
        self._check_unit(deflections.unit)
        if not spots:
            return
        times_ns = deflections.times_ns.tolist()
        columns = [sequences, times_ns, device_times_ns, host_times_ns, *zip(*spots, strict=True)]
        columns += [deflections.x, deflections.y, deflections.u_x, deflections.u_y]
        if self._unit is DeflectionUnit.RAD:
            columns += [deflections.x / ARCSEC_RAD, deflections.y / ARCSEC_RAD]
        # all messages at once, which takes less time than protobuf does
        messages = np.repeat(self._spot.encoded_zeros, len(spots))
        for name, column in zip(self._spot.names, columns, strict=True):
            messages[name] = column
        with self._writing():
            for sequence, time_ns, message in zip(sequences, times_ns, messages, strict=True):
                self._numbers.add(self._spot.topic, sequence, self._log_time_ns(time_ns), message.tobytes())
        for sequence, time_ns, spot in zip(sequences, times_ns, references, strict=bool(references)):
            position = spot.x_px, spot.y_px, spot.u_x_px, spot.u_y_px
            quality = spot.amplitude_dn, spot.chi2_per_dof, spot.flags
            self.write(RecordedReference(sequence, time_ns, *position, *quality))
        self.flush_if_due()

    def write_window(
        self, sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
    ) -> None:
        """Write the pixels (ny, nx) around the spot; (x0, y0) is the position of the first on the sensor.

        With the fitted `spot` about half the bytes are written; a wrong spot costs bytes and loses no pixel.
        """
        data = encode_window(sequence, time_ns, image, x0_px, y0_px, spot)
        self._add(WINDOW.topic, time_ns, data, sequence)

    def write_image(self, frame: Frame) -> None:
        """Write a whole frame."""
        data = encode_window(frame.sequence, frame.time_ns, frame.image, 0, 0)
        self._add(IMAGE.topic, frame.time_ns, data, frame.sequence)

    def write_preview(self, frame: Frame) -> None:
        """Write a preview of a whole frame, which is for viewers: JPEG, 8 bits, reduced in size."""
        step = preview_step((frame.image.shape[0], frame.image.shape[1]))
        small = frame.image[::step, ::step]
        if small.itemsize > 1:
            small = np.minimum(small * (255.0 / self._full_scale_dn), 255.0).astype(np.uint8)
        _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(small))
        message = CompressedImage(format="jpeg", data=jpeg.tobytes(), frame_id=SENSOR_FRAME)
        message.timestamp.FromNanoseconds(self._offset_ns + frame.time_ns)
        self._add(PREVIEW_TOPIC, frame.time_ns, message.SerializeToString(), frame.sequence)

    def _pixels_file(self) -> McapFile:
        """The file of pixels, which is created when the first pixels are written."""
        if self._pixels is None:
            try:
                self._pixels = McapFile(pixels_path(self.path), PIXEL_TOPICS, self._reserve_bytes)
            except RecordError as error:
                raise self._close_after_error(str(error)) from error
            self._pixels.add_metadata({"record": self._identity}, time.time_ns())
        return self._pixels

    def write_half_cycle(self, half_cycle: HalfCycle) -> None:
        """Write one half-cycle; amplitude and centre in `deflection_unit`."""
        values = [getattr(half_cycle, name) for name in HalfCycle.__dataclass_fields__]
        for_displays = [half_cycle.amplitude / ARCSEC_RAD] if self._unit is DeflectionUnit.RAD else []
        message = self._swing.encode(*values, *for_displays, 2.0 * half_cycle.half_period_s)
        self._add(HALF_CYCLE.topic, half_cycle.turn_time_ns, message)

    def write_balance(self, balance: Balance) -> None:
        """Write one balance. Raises ValueError if its unit is not the record's `deflection_unit`."""
        self._check_unit(balance.unit)
        values = [getattr(balance, name) for name in names_with_units(balance.unit)]
        self._add(BALANCE.topic, balance.time_ns, self._balance.encode(*values))

    def write_event(self, time_ns: int, kind: str, text: str) -> None:
        """Write an event, also as a line of the log, which viewers display."""
        event = Event(time_ns, kind, text)
        self._add(EVENT.topic, time_ns, EVENT.encode(*event, event.level))
        self._write_log(event, "event", event.line)

    def write_camera_calibration(
        self,
        time_ns: int,
        sensor_shape: tuple[int, int],
        distance_px: float,
        reference_px: tuple[float, float],
    ) -> None:
        """Write the geometry of the sensor, as a foxglove.CameraCalibration without distortion.

        The light lever corresponds to a pinhole camera with the mirror as pinhole. `distance_px` is the arm
        divided by the pixel pitch, `reference_px` the position (x, y) of the spot at zero tilt,
        `sensor_shape` (ny, nx).
        """
        x_px, y_px = reference_px
        message = CameraCalibration(
            frame_id=SENSOR_FRAME,
            width=sensor_shape[1],
            height=sensor_shape[0],
            K=[distance_px, 0.0, x_px, 0.0, distance_px, y_px, 0.0, 0.0, 1.0],
            R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            P=[distance_px, 0.0, x_px, 0.0, 0.0, distance_px, y_px, 0.0, 0.0, 0.0, 1.0, 0.0],
        )
        message.timestamp.FromNanoseconds(self._offset_ns + time_ns)
        self._add(CAMERA_TOPIC, time_ns, message.SerializeToString())

    def write(self, value: TimedMessage) -> None:
        """Write a value, of one of the classes in `KIND_OF`, as a message of its own.

        A note of an operator is also written as a line of the log, which viewers display.
        """
        kind = KIND_OF[type(value)]
        data = kind.encode(*[getattr(value, name) for name in kind.names])
        self._add(kind.topic, value.time_ns, data)
        if isinstance(value, RecordedNote):
            self._write_log(value.event, "note", value.event.text)

    def _write_log(self, event: Event, source: str, text: str) -> None:
        """Write a line of the log, which viewers display."""
        message = Log(level=_LOG_LEVELS[event.level], message=text, name=source)  # type: ignore[arg-type]
        message.timestamp.FromNanoseconds(self._offset_ns + event.time_ns)
        self._add(LOG_TOPIC, event.time_ns, message.SerializeToString())

    def attach(self, name: str, data: bytes) -> None:
        """Attach a further file to the record."""
        media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        with self._writing():
            self._numbers.add_attachment(name, media_type, data, time.time_ns())

    def flush(self, wait: bool = True) -> None:
        """End the open chunks and force everything to the disk; `wait` until that is done."""
        if not self._closed:
            with self._writing():
                for file in self._files:
                    file.flush(wait)
                self._flushed_s = self._clock()

    def flush_if_due(self) -> None:
        """Flush without waiting for the disk, if `flush_interval_s` has elapsed since the last time."""
        if self._clock() - self._flushed_s >= self._flush_interval_s:
            self.flush(wait=False)

    def close(self) -> None:
        """Write the summaries and close the files; a second call does nothing."""
        if self._closed:
            return
        self.flush()
        self._closed = True
        failure = self._finish()
        if failure is not None:
            raise self._close_error(failure) from failure

    def _finish(self) -> OSError | None:
        """Finish both files; returns the first error."""
        failure = None
        # the pixels first, because a closed file of numbers means that the whole record is closed
        for file in reversed(self._files):
            try:
                file.finish()
            except OSError as error:
                failure = failure or error
        return failure

    @property
    def _files(self) -> list[McapFile]:
        return [self._numbers] if self._pixels is None else [self._numbers, self._pixels]

    def _check_unit(self, unit: DeflectionUnit) -> None:
        if unit is not self._unit:
            raise ValueError(
                f"{self.path}: its deflections are in {self._unit}; values in {unit} "
                "must be written into another record"
            )

    def _add(self, topic: str, time_ns: int, data: bytes, sequence: int | None = None) -> None:
        if sequence is None:
            sequence = self._sequence
            self._sequence += 1
        with self._writing():
            file = self._pixels_file() if topic in PIXEL_TOPICS else self._numbers
            file.add(topic, sequence, self._log_time_ns(time_ns), data)
        self.flush_if_due()

    def _log_time_ns(self, time_ns: int) -> int:
        """The time of a message in its file, UTC."""
        log_time_ns = self._offset_ns + time_ns
        self._end_ns = max(self._end_ns, log_time_ns)
        return log_time_ns

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise RecordError for a closed record, and for an error or a full disk, after closing the files."""
        if self._closed:
            raise RecordError(f"{self.path}: is closed; nothing more can be written")
        try:
            yield
            failure = next((file.disk.full for file in self._files if file.disk.full is not None), None)
        except OSError as error:
            failure = error
        if failure is not None:
            raise self._close_after_error(failure.strerror or str(failure)) from failure

    def _close_after_error(self, reason: str) -> RecordError:
        """Close the files with the data that can still be written; return the error to be raised."""
        self._closed = True
        text = f"{self.path}: cannot be written: {reason}"
        lost = sum(file.waiting for file in self._files if file.disk.broken)
        failure = None
        try:
            # without an end event, readers could not tell why the run ended
            for kind in (EventKind.RECORD, EventKind.FAILED, EventKind.STOP):
                event = Event(self._end_ns - self._offset_ns, kind, text)
                encoded_event = EVENT.encode(*event, event.level)
                self._numbers.add(EVENT.topic, self._sequence, self._end_ns, encoded_event)
                self._sequence += 1
        except OSError as error:
            failure = error
        finish_failure = self._finish()
        if (failure := failure or finish_failure) is not None:
            return self._close_error(failure)
        remark = f"; the last {lost} messages could not be written" if lost else ""
        return RecordError(f"{text}; the record is closed and readable{remark}")

    def _close_error(self, error: OSError) -> RecordError:
        return RecordError(
            f"{self.path}: could not be closed properly: {error.strerror or error}; "
            "rig record recover makes a complete file of it"
        )
