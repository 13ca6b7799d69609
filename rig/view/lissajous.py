"""The trajectory (X, Y): its recent past, the present position, and axes that follow the amplitude."""

from collections import deque

import numpy as np
import rerun as rr

from rig.view import layout
from rig.view.gathering import Gathering
from rig.view.graticule import PLANE_REACH, faded, graticule_marks, reach_beyond, trajectory_graticule
from rig.view.values import Floats

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


BRIGHTNESS = {"recent": 1.0, "older": 0.5, "oldest": 0.22}
FOLLOWED_PERIODS = 2.0
"""Number of slow periods over which the largest deflection is taken."""
HYSTERESIS = 0.9
"""The axes are made smaller when the amplitude is below this fraction of the value at which they grow
again.
"""


class Lissajous:
    """Draws (X, Y) of one or several runs, which is shown at equal scales and with X stretched.

    Parameters
    ----------
    stream, gathered
        Static entities (axes, styles) are sent to `stream`, the trajectory to `gathered`.
    unit
        Unit of the deflections, for the labels.
    amplitude
        Expected at the start; sets the initial range of the axes.
    period_s
        Period of the slow mode. The range of the axes follows the largest deflection in the last two
        periods. None: it stays, because runs that are overlaid share one set of axes.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        gathered: Gathering,
        unit: str,
        amplitude: float,
        period_s: float | None,
    ) -> None:
        self._stream = stream
        self._gathered = gathered
        self._unit = unit
        self._period_s = period_s
        self._extents: deque[tuple[float, float]] = deque()
        self._reach = reach_beyond(amplitude)
        self._trails: dict[str, Trail] = {}
        stretch = rr.Transform3D(scale=[layout.X_STRETCH, 1.0, 1.0])
        stream.log(layout.EQUAL, stretch, static=True)
        if period_s is None:
            self._draw_axes(static=True)
        else:
            stream.set_time(layout.TIMELINE, duration=0.0)
            self._draw_axes(static=False)

    def draw(self, run: str, time_s: Floats, x: Floats, y: Floats, colour: str) -> None:
        """Continue the trajectory of a run with the points (x, y), each (n,); NaN interrupts the line."""
        # y points down in Rerun's spatial views.
        ends, pieces = self._trail(run, colour).pieces(time_s, np.column_stack((x, -y)))
        if not pieces:
            return
        for part in layout.TRAIL:
            self._gathered.strips(layout.trail_entity(run, part), ends, pieces)
        self._gathered.points(
            layout.trail_entity(run, layout.POSITION), ends, [piece[-1] for piece in pieces]
        )

    def follow(self, time_s: Floats, x: Floats, y: Floats) -> None:
        """Adapt the range of the axes to the largest recent deflection."""
        far = np.fmax(np.abs(x), np.abs(y))
        if self._period_s is None or not np.isfinite(far).any():
            return
        # a replay may have jumped back in time
        while self._extents and self._extents[-1][0] > time_s[-1]:
            self._extents.pop()
        self._extents.append((float(time_s[-1]), float(np.nanmax(far))))
        while self._extents[0][0] < time_s[0] - FOLLOWED_PERIODS * self._period_s:
            self._extents.popleft()
        extent = max(most for _, most in self._extents)
        # the axes are not made smaller before the deflections of two periods are known
        seen = time_s[-1] - self._extents[0][0] >= (FOLLOWED_PERIODS - 1) * self._period_s
        reach = reach_beyond(extent / HYSTERESIS)
        outgrown = 1.02 * extent > self._reach
        if not (outgrown or (seen and reach < self._reach)):
            return
        self._reach = reach
        self._stream.set_time(layout.TIMELINE, duration=float(time_s[0]))
        self._draw_axes(static=False)

    def _trail(self, run: str, colour: str) -> Trail:
        if run not in self._trails:
            self._trails[run] = Trail()
            for order, (part, brightness) in enumerate(BRIGHTNESS.items()):
                style = rr.LineStrips2D.from_fields(
                    colors=faded(colour, brightness),
                    radii=rr.Radius.ui_points(0.9),
                    draw_order=float(10 - order),
                )
                self._stream.log(layout.trail_entity(run, part), style, static=True)
            dot = rr.Points2D.from_fields(
                colors=(255, 255, 255), radii=rr.Radius.ui_points(4.0), draw_order=20.0
            )
            self._stream.log(layout.trail_entity(run, layout.POSITION), dot, static=True)
        return self._trails[run]

    def _draw_axes(self, *, static: bool) -> None:
        scale = PLANE_REACH / self._reach
        zoom = rr.Transform3D(scale=[scale, scale, 1.0])
        self._stream.log(layout.TRAJECTORY, zoom, static=static)
        for root, stretch in ((layout.EQUAL, 1.0), (layout.STRETCHED, layout.X_STRETCH)):
            graticule = trajectory_graticule(self._reach, self._unit, stretch)
            for name, mark in graticule_marks(graticule).items():
                self._stream.log(f"{root}/graticule/{name}", mark, static=static)
