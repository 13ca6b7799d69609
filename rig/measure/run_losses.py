"""Losses to be written to a record: whenever they change, and at its end."""

from dataclasses import astuple

from acquisition.frame_losses import FrameLosses
from acquisition.record.topics import RecordedLosses
from rig.devices import FrameStream

_INTERVAL_NS = 1_000_000_000


class LossLog:
    """Losses of a stream since a record began; with `from_start` also those before the record."""

    def __init__(self, stream: FrameStream, *, from_start: bool) -> None:
        self._stream = stream
        self._before = FrameLosses() if from_start else stream.losses
        self._written = FrameLosses()
        self._due_ns = 0

    @property
    def now(self) -> FrameLosses:
        """Losses so far."""
        return self._stream.losses.since(self._before)

    def due(self, time_ns: int) -> RecordedLosses | None:
        """The losses to be recorded now, if they have changed; at most once per second of frame time."""
        now = self.now
        if now == self._written or time_ns < self._due_ns:
            return None
        self._due_ns = time_ns + _INTERVAL_NS
        return self.last(time_ns)

    def last(self, time_ns: int) -> RecordedLosses:
        """The present losses, to be recorded in any case."""
        self._written = self.now
        return RecordedLosses(time_ns, *astuple(self._written))
