"""Keeps the last seconds of frames before a record begins, and tracks the spots in them."""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from acquisition.frame import Frame
from processing.deflections import Deflections, joined
from processing.spot import Spot
from processing.ticks import nanoseconds, seconds
from rig.devices import FrameStream
from rig.instrument import Deflector, Optics
from rig.measure.preflight import TrialFrames

_BLOCK_FRAMES = 16
_RING_BYTES = 256 * 1024 * 1024
Watch = Callable[[Sequence[Frame], Sequence[Spot], Deflections], None]


class RecentFrames:
    """Takes frames, tracks the spot, and keeps the deflections of the last `window_s` seconds.

    The frames themselves are kept for `frames_s` seconds (fewer if they would need more than 256 MiB),
    because a release is detected only afterwards, and the record must begin before it. `watch` is shown every
    block of frames, with its spots and deflections.
    """

    def __init__(
        self,
        stream: FrameStream,
        optics: Optics,
        frames_s: float,
        window_s: float,
        watch: Watch | None = None,
    ) -> None:
        self._stream = stream
        self._watch = watch
        self._optics = optics
        self._tracker = optics.tracker()
        self._deflector: Deflector | None = None
        self._frames: deque[Frame] = deque()
        self._blocks: deque[tuple[list[Spot], Deflections]] = deque()
        self._frames_ns = nanoseconds(frames_s)
        self._window_ns = nanoseconds(window_s)
        self._found_ns = 0
        self.seen = 0

    def advance(self) -> bool:
        """Take some frames; False if the stream has ended."""
        block = self._stream.take(_BLOCK_FRAMES, 0.1)
        if not block:
            return not self._stream.drained
        if self._deflector is None:
            self._deflector = self._optics.deflector((block[0].image.shape[0], block[0].image.shape[1]))
        spots = [self._tracker.track(frame.image) for frame in block]
        times_ns = np.array([frame.time_ns for frame in block], dtype=np.int64)
        deflections = self._deflector(times_ns, spots)
        self._blocks.append((spots, deflections))
        found_ns = times_ns[deflections.found]
        self._found_ns = int(found_ns[-1]) if len(found_ns) else self._found_ns or int(times_ns[0])
        self._frames.extend(block)
        if self._watch is not None:
            self._watch(block, spots, deflections)
        self.seen += len(block)
        newest_ns = block[-1].time_ns
        most = max(8, _RING_BYTES // max(block[0].image.nbytes, 1))
        while newest_ns - self._frames[0].time_ns > self._frames_ns or len(self._frames) > most:
            self._frames.popleft()
        while newest_ns - self._blocks[0][1].times_ns[-1] > self._window_ns:
            self._blocks.popleft()
        return True

    @property
    def spotless_s(self) -> float:
        """Time since a spot was last found, or since the first frame."""
        return seconds(self.now_ns - self._found_ns) if self._blocks else 0.0

    @property
    def now_ns(self) -> int:
        """Time of the newest frame; 0 before the first."""
        return int(self._blocks[-1][1].times_ns[-1]) if self._blocks else 0

    @property
    def frames(self) -> list[Frame]:
        """The kept frames, oldest first."""
        return list(self._frames)

    @property
    def newest(self) -> tuple[float, float]:
        """Deflection (x, y) of the newest frame; NaN if the spot is lost."""
        if not self._blocks:
            return np.nan, np.nan
        deflections = self._blocks[-1][1]
        return float(deflections.x[-1]), float(deflections.y[-1])

    def since(self, time_ns: int) -> Deflections:
        """Deflections from a time on."""
        return joined((at for _, at in self._blocks), self._optics.unit).since(time_ns)

    def look(self, resting: bool, duration_s: float) -> TrialFrames:
        """Frames, spots and deflections of the last `duration_s` seconds."""
        from_ns = self.now_ns - nanoseconds(duration_s)
        deflections = self.since(from_ns)
        spots = [spot for block, _ in self._blocks for spot in block]
        frames = [frame for frame in self._frames if frame.time_ns >= from_ns]
        return TrialFrames(
            frames, spots[len(spots) - len(deflections) :], deflections, resting, self._tracker.model
        )

    def window_bytes(self) -> float:
        """Mean number of bytes that a record needs per frame."""
        if not self._frames:
            return 0.0
        image = self._frames[-1].image
        x0, y0, x1, y1 = self._tracker.record_window(self._blocks[-1][0][-1], image.shape)
        return float((x1 - x0) * (y1 - y0) * image.itemsize)
