"""The last seconds of frames before a record begins, and the spots in them."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from processing.spot import Spot
from rig.devices import FrameStream
from rig.instrument import Deflector, Optics
from rig.measure.preflight import Look

_BLOCK_FRAMES = 16
_RING_BYTES = 256 * 1024 * 1024


class _Sample(NamedTuple):
    time_ns: int
    spot: Spot
    x: float
    y: float
    u_x: float
    u_y: float


class RecentFrames:
    """Takes frames as they come, tracks them, keeps samples of the last `window_s` seconds.

    The frames themselves are kept for `frames_s` seconds (less where they would need more than 256 MiB):
    a release is seen only after it has happened, and the record shall begin before it.
    """

    def __init__(
        self,
        stream: FrameStream,
        optics: Optics,
        frames_s: float,
        window_s: float,
    ) -> None:
        self._stream = stream
        self._optics = optics
        self._tracker = optics.tracker()
        self._deflector: Deflector | None = None
        self._frames: deque[Frame] = deque()
        self._samples: deque[_Sample] = deque()
        self._frames_ns = round(frames_s * 1e9)
        self._window_ns = round(window_s * 1e9)
        self.seen = 0

    def advance(self) -> bool:
        """Take in some frames; False when no more will come."""
        block = self._stream.take(_BLOCK_FRAMES, 0.1)
        if not block:
            return not self._stream.drained
        if self._deflector is None:
            self._deflector = self._optics.deflector((block[0].image.shape[0], block[0].image.shape[1]))
        spots = [self._tracker.track(frame.image) for frame in block]
        x, y, u_x, u_y = (column.tolist() for column in self._deflector(spots))
        for k, (frame, spot) in enumerate(zip(block, spots, strict=True)):
            self._frames.append(frame)
            self._samples.append(_Sample(frame.time_ns, spot, x[k], y[k], u_x[k], u_y[k]))
        self.seen += len(block)
        newest_ns = block[-1].time_ns
        most = max(8, _RING_BYTES // max(block[0].image.nbytes, 1))
        while newest_ns - self._frames[0].time_ns > self._frames_ns or len(self._frames) > most:
            self._frames.popleft()
        while newest_ns - self._samples[0].time_ns > self._window_ns:
            self._samples.popleft()
        return True

    @property
    def now_ns(self) -> int:
        """Time of the newest frame; 0 before the first."""
        return self._samples[-1].time_ns if self._samples else 0

    @property
    def frames(self) -> list[Frame]:
        """The frames that are kept, oldest first."""
        return list(self._frames)

    @property
    def newest(self) -> Sequence[float]:
        """(x, y) of the newest sample; NaN where the spot is lost."""
        return (self._samples[-1].x, self._samples[-1].y) if self._samples else (np.nan, np.nan)

    def since(self, time_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(times in s, x, y) of the samples from a time on."""
        rows = [(s.time_ns * 1e-9, s.x, s.y) for s in self._samples if s.time_ns >= time_ns]
        table = np.array(rows, dtype=np.float64).reshape(-1, 3)
        return table[:, 0], table[:, 1], table[:, 2]

    def look(self, resting: bool, duration_s: float) -> Look:
        """The last samples and frames, of so many seconds."""
        from_ns = self.now_ns - round(1e9 * duration_s)
        samples = [s for s in self._samples if s.time_ns >= from_ns]
        frames = [frame for frame in self._frames if frame.time_ns >= from_ns]
        table = np.array(
            [(s.time_ns * 1e-9, s.x, s.y, s.u_x, s.u_y) for s in samples], dtype=np.float64
        ).reshape(-1, 5)
        times, x, y, u_x, u_y = table.T
        return Look(frames, [s.spot for s in samples], times, x, y, u_x, u_y, resting)

    def window_bytes(self) -> float:
        """Mean size of what a record keeps of a frame."""
        if not self._frames or not self._samples:
            return 0.0
        image = self._frames[-1].image
        x0, y0, x1, y1 = self._tracker.record_window(self._samples[-1].spot, image.shape)
        return float((x1 - x0) * (y1 - y0) * image.itemsize)
