"""The losses that belong to one record: written when they change, and at its end."""

from acquisition.frame_losses import FrameLosses
from acquisition.record.topics import RecordedLosses
from rig.devices import FrameStream

_INTERVAL_NS = 1_000_000_000


class LossLog:
    """Losses of a stream since a record began; `from_start` counts also what was lost before."""

    def __init__(self, stream: FrameStream, *, from_start: bool) -> None:
        self._stream = stream
        self._before = FrameLosses() if from_start else stream.losses
        self._written = FrameLosses()
        self._due_ns = 0

    @property
    def now(self) -> FrameLosses:
        """Lost so far."""
        return self._stream.losses.since(self._before)

    def due(self, time_ns: int) -> RecordedLosses | None:
        """What is to be recorded now: changed losses, once a second of the frames' time."""
        now = self.now
        if now == self._written or time_ns < self._due_ns:
            return None
        self._due_ns = time_ns + _INTERVAL_NS
        return self.last(time_ns)

    def last(self, time_ns: int) -> RecordedLosses:
        """The losses as they stand, to be recorded whether they have changed or not."""
        self._written = self.now
        return RecordedLosses(time_ns, *self._written)
