"""The thread that writes a record, and the entries it writes."""

import contextlib
import logging
import math
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from acquisition.camera import Frame, Image
from acquisition.frames.queue import MAX_QUEUE_BYTES, BoundedQueue, take_all
from acquisition.record.events import Event
from acquisition.record.topics import TimedMessage
from acquisition.record.writer import RecordWriter
from rig.control import LightPermit, Stage
from rig.instrument import Block

_log = logging.getLogger(__name__)
_IDLE_S = 0.2
"""Interval between checks whether a flush is due, while no entries arrive."""
_FRAME_BYTES = 1024
"""Approximate memory of the numbers of one frame."""
_FREE_SPACE_INTERVAL_S = 1.0
MAX_WRITE_S = 2.0
"""Longest write that is no event; disks usually pause for less."""


@dataclass(slots=True)
class RecordEntry:
    """Data to be recorded for some consecutive frames."""

    sequences: Sequence[int] = ()
    """Numbers of the frames in the record."""
    device_times_ns: Sequence[int] = ()
    host_times_ns: Sequence[int] = ()
    block: Block | None = None
    """What was measured in the frames; None if there are none."""
    windows: Sequence[tuple[Image, int, int] | None] = ()
    """Copies of the pixels around the spots, each with the position (x0, y0) of its first pixel on the sensor
    in px; None for a frame without a spot."""
    images: Sequence[Frame] = ()
    """Frames that are recorded whole."""
    preview: Frame | None = None
    events: Sequence[Event] = ()
    messages: Sequence[TimedMessage] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    """Attachments of the record by name."""
    is_flushed: threading.Event | None = None
    """Set once every entry so far can be read in the file, or cannot be written."""

    @property
    def memory_bytes(self) -> int:
        """Approximate memory that the entry takes while it waits; never 0."""
        window_bytes = sum(window[0].nbytes for window in self.windows if window is not None)
        frames = self.images if self.preview is None else [*self.images, self.preview]
        image_bytes = sum(frame.image.nbytes for frame in frames)
        return _FRAME_BYTES * (1 + len(self.sequences)) + window_bytes + image_bytes


class Recorder:
    """Writes entries in order, flushes regularly, keeps the first error.

    `put` queues an entry. Entries wait in memory while the disk is slow or hangs; once they take
    `max_waiting_bytes`, `put` waits, so that frames are lost, and counted as lost, before they are
    processed. After an error (a full disk, a removed drive) further entries are discarded; the session has to
    check `error`. `permit` is notified while the thread runs: the laser may be lit only as long as it does.
    """

    def __init__(
        self,
        writer: RecordWriter,
        max_waiting_bytes: int = MAX_QUEUE_BYTES,
        permit: LightPermit | None = None,
    ) -> None:
        self._writer = writer
        self._permit = permit or LightPermit()
        self.entries = BoundedQueue[RecordEntry](math.inf, "wait", max_waiting_bytes)
        """The entries that are not yet written."""
        self.put = self.entries.put
        self._write_began_s = math.inf
        self._pauses_s: deque[float] = deque()
        self._free_space_read_s = -math.inf
        self.disk_free_bytes = math.nan
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self.error: Exception | None = None
        self._thread.start()

    @property
    def disk_silent_s(self) -> float:
        """Time for which the present write has hung, once it exceeds `MAX_WRITE_S`; else 0."""
        paused_s = time.monotonic() - self._write_began_s
        return paused_s if paused_s >= MAX_WRITE_S else 0.0

    @property
    def alarm(self) -> str:
        """Text that says that the disk hangs; empty while it does not."""
        if not (paused_s := self.disk_silent_s):
            return ""
        waiting = f"{self.entries.waiting_bytes / 1e6:.0f} of {self.entries.max_bytes / 1e6:.0f} MB"
        return f"the disk has not answered for {paused_s:.0f} s; {waiting} of memory wait for it"

    def take_pauses(self) -> list[float]:
        """Durations in s of the writes since the last call that took longer than `MAX_WRITE_S`."""
        return take_all(self._pauses_s)

    @property
    def bytes_written(self) -> int:
        return self._writer.bytes_written

    def flush(self) -> None:
        """Wait until every entry so far can be read in the file; see `error` afterwards."""
        is_flushed = threading.Event()
        self.put(RecordEntry(is_flushed=is_flushed))
        is_flushed.wait()

    def close(self) -> None:
        """Write the queued entries and close the file; see `error` afterwards."""
        self.entries.close()
        self._thread.join()

    def _work(self) -> None:
        try:
            while not self.entries.drained:
                self._permit.note_progress(Stage.RECORDER)
                self._write_next()
            with self._writing():
                self._writer.close()
        finally:
            self._permit.note_end(Stage.RECORDER)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Keep the first error of a write, and its duration if it is long."""
        began_s = self._write_began_s = time.monotonic()
        try:
            yield
        except Exception as error:
            if self.error is None:
                self.error = error
                _log.error("the record cannot be written: %s", error)
        finally:
            self._write_began_s = math.inf
            write_s = time.monotonic() - began_s
            if write_s > MAX_WRITE_S:
                self._pauses_s.append(write_s)

    def _write_next(self) -> None:
        """Write the next entry, or discard it after an error; flush the file if that is due."""
        # an empty entry is written, too, because a flush of earlier entries may be due
        (entry,) = self.entries.take(1, _IDLE_S) or [RecordEntry()]
        if self.error is None:
            with self._writing():
                writer, block = self._writer, entry.block
                if block is not None:
                    numbers, deflections = entry.sequences, block.deflections
                    clocks = entry.device_times_ns, entry.host_times_ns
                    writer.write_spots(numbers, *clocks, block.spots, deflections, block.references)
                    for half_cycle in block.half_cycles:
                        writer.write_half_cycle(half_cycle)
                    for balance in block.balances:
                        writer.write_balance(balance)
                    times_ns = deflections.times_ns.tolist()
                    windows = zip(numbers, times_ns, entry.windows, block.spots, strict=True)
                    for number, time_ns, window, spot in windows:
                        if window is not None:
                            writer.write_window(number, time_ns, *window, spot)
                for frame in entry.images:
                    writer.write_image(frame)
                if entry.preview is not None:
                    writer.write_preview(entry.preview)
                for message in entry.messages:
                    writer.write(message)
                for name, data in entry.attachments.items():
                    writer.attach(name, data)
                for event in entry.events:
                    writer.write_event(*event)
                writer.flush_if_due()
                if entry.is_flushed is not None:
                    writer.flush()
                self._read_free_space()
        if entry.is_flushed is not None:
            entry.is_flushed.set()

    def _read_free_space(self) -> None:
        """Read, at intervals, how much disk is free: in this thread, because a disk may hang at it, too."""
        now_s = time.monotonic()
        if now_s - self._free_space_read_s > _FREE_SPACE_INTERVAL_S:
            self._free_space_read_s = now_s
            with contextlib.suppress(OSError):
                self.disk_free_bytes = shutil.disk_usage(self._writer.path.parent).free
