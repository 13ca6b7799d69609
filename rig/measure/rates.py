"""How fast a run's frames and bytes come."""

import time
from collections import deque

from rig.instrument import Snapshot


class Rates:
    """Frames and bytes per second over the last few seconds of the host's time."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque(maxlen=50)

    def take(self, snapshot: Snapshot) -> None:
        """Note the counts; fewer frames than before are those of another phase, which starts anew."""
        if self._points and snapshot.frames < self._points[-1][1]:
            self._points.clear()
        self._points.append((time.monotonic(), snapshot.frames, snapshot.record_bytes))

    @property
    def frames_hz(self) -> float:
        return self._rate(1)

    @property
    def bytes_per_s(self) -> float:
        return self._rate(2)

    def _rate(self, column: int) -> float:
        if len(self._points) < 2:
            return 0.0
        first, last = self._points[0], self._points[-1]
        return float(last[column] - first[column]) / max(last[0] - first[0], 1e-9)
