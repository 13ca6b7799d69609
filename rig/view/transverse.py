"""Preparation of curves: the two parts of X(t), decimation, gaps, the send buffer, the trajectory."""

import time
from bisect import bisect_right, insort
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from processing.arrays import Floats
from rig.terminal import palette
from rig.view import layout
from rig.view.graticule import PLANE_REACH, faded, graticule_marks, reach_beyond, trajectory_graticule
from rig.view.layout import TIMELINE

_MAX_WAIT_S = 20.0
"""Time for which samples wait for the first balance of a run."""
_MAX_BALANCE_AGE_S = 60.0
"""Largest time between a sample and the balance that separates it."""


class _Line(NamedTuple):
    """The line on which the slow mode moves, from one balance."""

    time_s: float
    angle_rad: float
    rotation_rad_per_s: float
    rest_x: float
    rest_y: float
    """The rest position in the unit of the samples."""


class TransverseCurves:
    """Separates X of one run into its two parts by the line of each balance.

    Samples before the first balance wait for it, at most `_MAX_WAIT_S`.
    """

    def __init__(self) -> None:
        self._lines: list[_Line] = []
        self._waiting: list[tuple[Floats, Floats, Floats]] = []

    def balance(self, time_s: float, numbers: Mapping[str, tuple[float, float]], shown_size: float) -> None:
        """Add a balance; `shown_size` is the size of the samples' unit in the unit of its rest position."""
        names = "line_angle_rad", "rotation_rad_per_s", "rest_x", "rest_y"
        angle_rad, rotation, x, y = (numbers.get(name, (np.nan, np.nan))[0] for name in names)
        line = _Line(time_s, angle_rad, float(np.nan_to_num(rotation)), x / shown_size, y / shown_size)
        if np.isfinite([line.angle_rad, line.rest_x, line.rest_y]).all():
            insort(self._lines, line)

    def samples(self, time_s: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats] | None:
        """Separate samples, and the waiting ones; None while no balance is known.

        Returns times, the fast mode and the leakage of the slow mode, (n,) in the unit of the samples.
        """
        if len(time_s):
            self._waiting.append((time_s, x, y))
        if not self._lines or not self._waiting:
            while self._waiting and len(time_s) and time_s[-1] - self._waiting[0][0][-1] > _MAX_WAIT_S:
                self._waiting.pop(0)
            return None
        blocks, self._waiting = self._waiting, []
        time_s, x, y = (np.concatenate(columns) for columns in zip(*blocks, strict=True))
        line = self._line_at(float(time_s[len(time_s) // 2]))
        angle_rad = line.angle_rad + line.rotation_rad_per_s * (time_s - line.time_s)
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        along = (x - line.rest_x) * sine + (y - line.rest_y) * cosine
        fast = (x - line.rest_x) * cosine - (y - line.rest_y) * sine
        is_near = np.abs(time_s - line.time_s) < _MAX_BALANCE_AGE_S
        return time_s, np.where(is_near, fast, np.nan), np.where(is_near, along * sine, np.nan)

    def _line_at(self, time_s: float) -> _Line:
        """The line nearest to a time."""
        index = bisect_right(self._lines, time_s, key=lambda line: line.time_s)
        neighbours = self._lines[max(index - 1, 0) : index + 1]
        return min(neighbours, key=lambda line: abs(line.time_s - time_s))


class Decimator:
    """Chooses the samples to be plotted: the first of each interval ``1 / rate_hz``, and all with a flag."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last_interval = -(2**62)

    def choose(self, time_s: Floats, flags: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of the samples (n,), in order of time, are plotted; intervals continue from call to call."""
        # Rounding must not move a sample at the beginning of an interval into the previous one.
        interval = np.floor(time_s * self._rate_hz + 1e-3).astype(np.int64)
        previous = np.concatenate(([self._last_interval], interval[:-1]))
        if len(interval):
            self._last_interval = int(interval[-1])
        chosen: NDArray[np.bool_] = (interval != previous) | (flags != 0)
        return chosen


class GapBreaker:
    """Inserts NaN into the gaps of curves, also between blocks of values."""

    def __init__(self) -> None:
        self._last_s: dict[str, float] = {}

    def break_at_gaps(
        self, path: str, max_gap_s: float, time_s: Floats, *columns: Floats
    ) -> tuple[Floats, ...]:
        """Times and columns (n,) of the curve at entity `path`, with NaN in gaps above `max_gap_s`."""
        steps_s = np.diff(time_s, prepend=self._last_s.get(path, np.nan))
        self._last_s[path] = float(time_s[-1])
        gaps = np.flatnonzero(steps_s > max_gap_s)
        if not len(gaps):
            return time_s, *columns
        middles_s = time_s[gaps] - 0.5 * steps_s[gaps]
        return np.insert(time_s, gaps, middles_s), *(np.insert(values, gaps, np.nan) for values in columns)


class SendBuffer:
    """Values that wait to be sent, until `limit_s` have passed or there are `limit_rows` of them."""

    def __init__(self, stream: rr.RecordingStream, limit_s: float, limit_rows: int) -> None:
        self._stream = stream
        self._limit_s, self._limit_rows = limit_s, limit_rows
        self._waiting: dict[str, tuple[Callable[..., Any], list[tuple[Any, ...]]]] = {}
        self._rows = 0
        self._last_sent_s = time.monotonic()

    def add(self, path: str, columns: Callable[..., Any], times_s: Floats, *values: Any) -> None:
        """Add values, one per time, which `columns` converts to Rerun's columns: arrays (n, ...) or lists."""
        self._waiting.setdefault(path, (columns, []))[1].append((times_s, *values))
        self._rows += len(times_s)

    def send(self, *, now: bool = False) -> None:
        """Send everything if a limit is reached, or in any case if `now`."""
        now_s = time.monotonic()
        if not now and self._rows < self._limit_rows and now_s - self._last_sent_s < self._limit_s:
            return
        self._last_sent_s, self._rows = now_s, 0
        waiting, self._waiting = self._waiting, {}
        for path, (columns, blocks) in waiting.items():
            times_s, *values = map(_joined, zip(*blocks, strict=True))
            self._stream.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times_s)], columns(*values))


def _joined(blocks: Sequence[Any]) -> Any:
    return list(chain(*blocks)) if isinstance(blocks[0], list) else np.concatenate(blocks)


def _strip_columns(strips: list[Floats]) -> Any:
    return rr.LineStrips2D.columns(strips=strips)


def _point_columns(points: Floats) -> Any:
    return rr.Points2D.columns(positions=points)


_MAX_STRIP_STEPS = 25
"""Largest number of steps between points in a strip."""


class Trail:
    """Connects points to line strips, also from call to call.

    The time of a strip is that of its last point. A lost spot (NaN) interrupts the line.
    """

    def __init__(self) -> None:
        self._last_time_s = np.empty(0)
        self._last_point = np.empty((0, 2))

    def strips(self, time_s: Floats, points: Floats) -> tuple[Floats, list[Floats]]:
        """Times (k,) and k strips (m, 2) of the points (n, 2); each begins at the end of the previous."""
        times = np.concatenate((self._last_time_s, time_s))
        path = np.concatenate((self._last_point, points))
        ends: list[float] = []
        strips: list[Floats] = []
        is_finite = np.isfinite(path[:, 0] + path[:, 1])
        edges = np.flatnonzero(np.diff(np.concatenate(([False], is_finite, [False])).astype(np.int8)))
        for start, stop in edges.reshape(-1, 2):
            for first in range(start, stop - 1, _MAX_STRIP_STEPS):
                last = min(first + _MAX_STRIP_STEPS, stop - 1)
                ends.append(float(times[last]))
                strips.append(path[first : last + 1])
        keep = len(path) - 1 if len(path) and is_finite[-1] else len(path)
        self._last_time_s, self._last_point = times[keep:], path[keep:]
        return np.array(ends), strips


_BRIGHTNESS = {"recent": 1.0, "older": 0.5, "oldest": 0.22}
"""Brightness of the parts of the trajectory (`layout.TRAIL`)."""
_EXTENT_PERIODS = 2.0
"""Number of slow periods over which the largest deflection is determined."""
_HYSTERESIS = 0.9
"""Amplitude below which the axes shrink, as a fraction of the amplitude at which they grow again."""


class Lissajous:
    """Plots the trajectory (X, Y), shown at equal scales and with X stretched.

    Axes and styles are sent to `stream`, the trajectory to `buffer`. The range of the axes is set for the
    expected `amplitude` at first, then follows the largest deflection in `_EXTENT_PERIODS` slow periods.
    """

    def __init__(
        self, stream: rr.RecordingStream, buffer: SendBuffer, unit: str, amplitude: float, period_s: float
    ) -> None:
        self._stream = stream
        self._buffer = buffer
        self._unit = unit
        self._period_s = period_s
        self._extents: deque[tuple[float, float]] = deque()
        self._reach = reach_beyond(amplitude)
        self._trail = Trail()
        stretch = rr.Transform3D(scale=[layout.X_STRETCH, 1.0, 1.0])
        stream.log(layout.EQUAL, stretch, static=True)
        for order, (name, brightness) in enumerate(_BRIGHTNESS.items()):
            style = rr.LineStrips2D.from_fields(
                colors=faded(palette.TRAJECTORY_COLOUR, brightness),
                radii=rr.Radius.ui_points(0.9),
                draw_order=float(10 - order),
            )
            stream.log(f"{layout.TRAJECTORY}/{name}", style, static=True)
        dot = rr.Points2D.from_fields(colors=(255, 255, 255), radii=rr.Radius.ui_points(4.0), draw_order=20.0)
        stream.log(f"{layout.TRAJECTORY}/{layout.POSITION}", dot, static=True)
        stream.set_time(layout.TIMELINE, duration=0.0)
        self._plot_axes()

    def plot(self, time_s: Floats, x: Floats, y: Floats) -> None:
        """Continue the trajectory with the points (x, y), each (n,); NaN interrupts the line."""
        # y points down in Rerun's spatial views.
        ends_s, strips = self._trail.strips(time_s, np.column_stack((x, -y)))
        if not strips:
            return
        for name in layout.TRAIL:
            self._buffer.add(f"{layout.TRAJECTORY}/{name}", _strip_columns, ends_s, strips)
        newest = np.array([strip[-1] for strip in strips])
        self._buffer.add(f"{layout.TRAJECTORY}/{layout.POSITION}", _point_columns, ends_s, newest)

    def follow(self, time_s: Floats, x: Floats, y: Floats) -> None:
        """Adapt the range of the axes to the largest recent deflection."""
        deflection = np.fmax(np.abs(x), np.abs(y))
        if not np.isfinite(deflection).any():
            return
        self._extents.append((float(time_s[-1]), float(np.nanmax(deflection))))
        while self._extents[0][0] < time_s[0] - _EXTENT_PERIODS * self._period_s:
            self._extents.popleft()
        extent = max(largest for _, largest in self._extents)
        # the axes do not shrink before the deflections of a whole period are known
        may_shrink = time_s[-1] - self._extents[0][0] >= (_EXTENT_PERIODS - 1) * self._period_s
        reach = reach_beyond(extent / _HYSTERESIS)
        must_grow = 1.02 * extent > self._reach
        if not (must_grow or (may_shrink and reach < self._reach)):
            return
        self._reach = reach
        self._stream.set_time(layout.TIMELINE, duration=float(time_s[0]))
        self._plot_axes()

    def _plot_axes(self) -> None:
        scale = PLANE_REACH / self._reach
        self._stream.log(layout.TRAJECTORY, rr.Transform3D(scale=[scale, scale, 1.0]))
        for root, stretch in ((layout.EQUAL, 1.0), (layout.STRETCHED, layout.X_STRETCH)):
            graticule = trajectory_graticule(self._reach, self._unit, stretch)
            for name, mark in graticule_marks(graticule).items():
                self._stream.log(f"{root}/graticule/{name}", mark)
