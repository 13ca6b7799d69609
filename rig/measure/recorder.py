"""Writes the record in a thread of its own."""

import logging
import queue
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from acquisition.frame import Frame, Image
from acquisition.record.events import Event
from acquisition.record.topics import (
    CLOCK_TOPIC,
    ENVIRONMENT,
    LOSSES_TOPIC,
    ClockAnchor,
    Environment,
    RecordedLosses,
)
from acquisition.record.writer import RecordWriter
from processing.spot import Spot
from rig.control import LightPermit, Stage
from rig.instrument import Block
from rig.measure.camera_state import TEMPERATURE_TOPIC, CameraTemperature

_log = logging.getLogger(__name__)
_IDLE_S = 0.2
"""Interval of the check whether to flush, while no entries arrive."""


class Window(NamedTuple):
    """Raw pixels around the spot; (x0, y0) are the sensor coordinates of the first pixel."""

    image: Image
    x0_px: int
    y0_px: int


@dataclass(frozen=True, slots=True)
class Entry:
    """Data to be recorded for some consecutive frames."""

    sequences: Sequence[int] = ()
    device_times_ns: Sequence[int] = ()
    host_times_ns: Sequence[int] = ()
    block: Block | None = None
    windows: Sequence[Window | None] = ()
    images: Sequence[Frame] = ()
    events: Sequence[Event] = field(default=())
    environment: Environment | None = None
    losses: RecordedLosses | None = None
    clock: ClockAnchor | None = None
    temperature: CameraTemperature | None = None
    attachments: Mapping[str, bytes] = field(default_factory=dict)


class Recorder:
    """Writes entries in order, flushes regularly, keeps the first error.

    `put` waits if the disk is slow, so that no measured data are lost. After an error (a full disk, a
    removed drive) further entries are discarded; the session has to check `error`. `permit` learns that the
    writing goes on, on which the light of a laser depends.
    """

    def __init__(self, writer: RecordWriter, capacity: int = 16, permit: LightPermit | None = None) -> None:
        self._writer = writer
        self._permit = permit or LightPermit()
        self._entries: queue.Queue[Entry | None] = queue.Queue(capacity)
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self.error: Exception | None = None
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Entries not yet written."""
        return self._entries.qsize()

    @property
    def bytes_written(self) -> int:
        """Size of the record so far."""
        return self._writer.bytes_written

    def put(self, entry: Entry) -> None:
        """Queue an entry; waits while the queue is full."""
        self._entries.put(entry)

    def close(self) -> None:
        """Write the queued entries and close the file; see `error` afterwards."""
        self._entries.put(None)
        self._thread.join()

    def _work(self) -> None:
        try:
            self._write_all()
        finally:
            self._permit.ended(Stage.RECORDER)

    def _write_all(self) -> None:
        while True:
            self._permit.moved(Stage.RECORDER)
            try:
                entry = self._entries.get(timeout=_IDLE_S)
            except queue.Empty:
                entry = Entry()
            try:
                if entry is None:
                    self._writer.close()
                    return
                if self.error is None:
                    self._write(entry)
                    self._writer.flush_if_due()
            except Exception as error:
                if self.error is None:
                    self.error = error
                    _log.error("the record cannot be written: %s", error)
                if entry is None:
                    return

    def _write(self, entry: Entry) -> None:
        writer = self._writer
        block = entry.block
        if block is not None:
            writer.write_spots(
                entry.sequences,
                entry.device_times_ns,
                entry.host_times_ns,
                block.spots,
                block.deflections,
            )
            times_ns = block.deflections.times_ns
            frames = zip(entry.sequences, times_ns.tolist(), entry.windows, block.spots, strict=True)
            for sequence, time_ns, window, spot in frames:
                if window is not None:
                    writer.write_window(sequence, time_ns, *window, spot)
            for swing in block.swings:
                writer.write_swing(swing)
            for balance in block.balances:
                writer.write_balance(balance)
        for frame in entry.images:
            writer.write_image(frame)
        if entry.environment is not None:
            writer.write(ENVIRONMENT.topic, entry.environment, entry.environment.time_ns)
        if entry.losses is not None:
            writer.write(LOSSES_TOPIC, entry.losses, entry.losses.time_ns)
        if entry.clock is not None:
            writer.write(CLOCK_TOPIC, entry.clock, entry.clock.time_ns)
        if entry.temperature is not None:
            writer.write(TEMPERATURE_TOPIC, entry.temperature, entry.temperature.time_ns)
        for name, data in entry.attachments.items():
            writer.attach(name, data)
        for event in entry.events:
            writer.write_event(event.time_ns, event.kind, event.text)


def cut_window(frame: Frame, spot: Spot, bounds_px: tuple[int, int, int, int] | None) -> Window | None:
    """Copy of the pixels from which tracking can be repeated; None without a spot."""
    if bounds_px is None:
        return None
    x0, y0, x1, y1 = bounds_px
    return Window(frame.image[y0:y1, x0:x1].copy(), x0, y0)
