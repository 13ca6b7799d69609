"""Writes the record in a thread of its own."""

import contextlib
import logging
import math
import queue
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from acquisition.camera import Frame, Image
from acquisition.record.events import Event
from acquisition.record.topics import REFERENCE, RecordedNote, RecordedReference, TypedMessage
from acquisition.record.writer import RecordWriter
from rig.control import LightPermit, Stage
from rig.instrument import Block

_log = logging.getLogger(__name__)
_IDLE_S = 0.2
"""Interval of the check whether to flush, while no entries arrive."""
MOST_WAITING_BYTES = 256 * 1024 * 1024
"""What waits for a slow disk: half a minute of 800 frames/s with windows of 100 x 100 pixels."""
_FRAME_BYTES = 1024
_FREE_SPACE_INTERVAL_S = 1.0
SLOW_S = 2.0
"""A write that takes longer is an event; usual disks pause for less."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Data to be recorded for some consecutive frames; `messages` are values, each with its kind.

    `windows` are copies of the pixels around the spots, each with (x0, y0), where on the sensor its
    first pixel is, in px; None without a spot.
    """

    sequences: Sequence[int] = ()
    device_times_ns: Sequence[int] = ()
    host_times_ns: Sequence[int] = ()
    block: Block | None = None
    windows: Sequence[tuple[Image, int, int] | None] = ()
    images: Sequence[Frame] = ()
    preview: Frame | None = None
    events: Sequence[Event] = field(default=())
    messages: Sequence[TypedMessage] = ()
    notes: Sequence[RecordedNote] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def memory_bytes(self) -> int:
        """About what the entry takes while it waits; never 0."""
        windows = sum(window[0].nbytes for window in self.windows if window is not None)
        frames = self.images if self.preview is None else [*self.images, self.preview]
        images = sum(frame.image.nbytes for frame in frames)
        return _FRAME_BYTES * (1 + len(self.sequences)) + windows + images

    def write(self, writer: RecordWriter) -> None:
        """Write all of it."""
        block = self.block
        if block is not None:
            writer.write_spots(
                self.sequences,
                self.device_times_ns,
                self.host_times_ns,
                block.spots,
                block.deflections,
            )
            times_ns = block.deflections.times_ns
            frames = zip(self.sequences, times_ns.tolist(), self.windows, block.spots, strict=True)
            for sequence, time_ns, window, spot in frames:
                if window is not None:
                    writer.write_window(sequence, time_ns, *window, spot)
            for sequence, time_ns, spot in zip(
                self.sequences, times_ns.tolist(), block.references, strict=bool(block.references)
            ):
                writer.write(REFERENCE, RecordedReference.from_spot(sequence, time_ns, spot), time_ns)
            for swing in block.swings:
                writer.write_swing(swing)
            for balance in block.balances:
                writer.write_balance(balance)
        for frame in self.images:
            writer.write_image(frame)
        if self.preview is not None:
            writer.write_preview(self.preview)
        for kind, value in self.messages:
            writer.write(kind, value, value.time_ns)
        for note in self.notes:
            writer.write_note(note)
        for name, data in self.attachments.items():
            writer.attach(name, data)
        for event in self.events:
            writer.write_event(event.time_ns, event.kind, event.text)


class _EntryQueue(queue.Queue[Entry | None]):
    """A queue whose size and limit are bytes of memory; None is the end."""

    def _init(self, maxsize: int) -> None:
        super()._init(maxsize)
        self._bytes = 0

    def _qsize(self) -> int:
        return self._bytes

    def _put(self, item: Entry | None) -> None:
        super()._put(item)
        self._bytes += _memory_bytes(item)

    def _get(self) -> Entry | None:
        item = super()._get()
        self._bytes -= _memory_bytes(item)
        return item


def _memory_bytes(item: Entry | None) -> int:
    return 1 if item is None else item.memory_bytes


class Recorder:
    """Writes entries in order, flushes regularly, keeps the first error.

    Entries wait in memory while the disk is slow or hangs; once they take `most_waiting_bytes`, `put`
    waits, too, so that what is lost then is lost, and counted, before it was processed. After an error (a
    full disk, a removed drive) further entries are discarded; the session has to check `error`. `permit`
    learns that the writing goes on, on which the light of a laser depends.
    """

    def __init__(
        self,
        writer: RecordWriter,
        most_waiting_bytes: int = MOST_WAITING_BYTES,
        permit: LightPermit | None = None,
    ) -> None:
        self._writer = writer
        self._permit = permit or LightPermit()
        self._entries = _EntryQueue(most_waiting_bytes)
        self._writing_since_s = math.inf
        self._pauses_s: queue.SimpleQueue[float] = queue.SimpleQueue()
        self._looked_s = -math.inf
        self.disk_free_bytes = math.nan
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self.error: Exception | None = None
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """Memory that entries take that are not yet written."""
        return self._entries.qsize()

    @property
    def disk_silent_s(self) -> float:
        """For how long a write has hung that takes longer than usual; 0 while none does."""
        paused_s = time.monotonic() - self._writing_since_s
        return paused_s if paused_s >= SLOW_S else 0.0

    @property
    def alarm(self) -> str:
        """That the disk hangs; empty while it does not."""
        if not (paused_s := self.disk_silent_s):
            return ""
        waiting = f"{self.waiting_bytes / 1e6:.0f} of {self._entries.maxsize / 1e6:.0f} MB"
        return f"the disk has not answered for {paused_s:.0f} s; {waiting} of memory wait for it"

    def take_pauses(self) -> list[float]:
        """Of every write since the last call that was slower than `SLOW_S`, how long it took in s."""
        found = []
        while not self._pauses_s.empty():
            found.append(self._pauses_s.get())
        return found

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
            ended = False
            while not ended:
                self._permit.moved(Stage.RECORDER)
                try:
                    entry = self._entries.get(timeout=_IDLE_S)
                except queue.Empty:
                    entry = Entry()
                ended = entry is None
                try:
                    if entry is None:
                        self._writer.close()
                    elif self.error is None:
                        self._write(entry)
                except Exception as error:
                    if self.error is None:
                        self.error = error
                        _log.error("the record cannot be written: %s", error)
        finally:
            self._permit.ended(Stage.RECORDER)

    def _write(self, entry: Entry) -> None:
        began_s = self._writing_since_s = time.monotonic()
        try:
            entry.write(self._writer)
            self._writer.flush_if_due()
            # asked here, because a disk that hangs does not answer this either
            if began_s - self._looked_s > _FREE_SPACE_INTERVAL_S:
                self._looked_s = began_s
                with contextlib.suppress(OSError):
                    self.disk_free_bytes = shutil.disk_usage(self._writer.path.parent).free
        finally:
            self._writing_since_s = math.inf
            took_s = time.monotonic() - began_s
            if took_s > SLOW_S:
                self._pauses_s.put(took_s)
