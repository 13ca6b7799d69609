"""Divides the trajectory into short pieces, so that the viewer can show any interval of time."""

import numpy as np

from rig.rerun.messages import Floats

PIECE_POINTS = 25


class Trail:
    """Connects points to line strips, also from call to call.

    The time of a strip is that of its last point. A lost spot (NaN) interrupts the line.
    """

    def __init__(self) -> None:
        self._last_time_s = np.empty(0)
        self._last_point = np.empty((0, 2))

    def pieces(self, time_s: Floats, points: Floats) -> tuple[Floats, list[Floats]]:
        """Times (k,) and k strips (m, 2) of the points (n, 2); each begins at the end of the one before."""
        times = np.concatenate((self._last_time_s, time_s))
        path = np.concatenate((self._last_point, points))
        ends: list[float] = []
        strips: list[Floats] = []
        good = np.isfinite(path[:, 0] + path[:, 1])
        edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
        for start, stop in edges.reshape(-1, 2):
            for first in range(start, stop - 1, PIECE_POINTS):
                last = min(first + PIECE_POINTS, stop - 1)
                ends.append(float(times[last]))
                strips.append(path[first : last + 1])
        keep = len(path) - 1 if len(path) and good[-1] else len(path)
        self._last_time_s, self._last_point = times[keep:], path[keep:]
        return np.array(ends), strips
