"""Thins values, breaks their curves in gaps and gathers them into blocks before they are sent to Rerun.

Rerun stores each call as a chunk of at least one or two kilobytes: one call per frame would make the file of
a run hundreds of megabytes large.
"""

import time

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rig.view.layout import TIMELINE
from rig.view.values import Floats


class Decimator:
    """Chooses the samples to be drawn: the first of each interval ``1 / rate_hz``, and all with a flag.

    This concerns the display only: the record contains every sample.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last_interval = -(2**62)

    def choose(self, time_s: Floats, flags: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of the samples (n,), in order of time, are drawn; intervals continue from call to call."""
        # Rounding must not move a sample at the beginning of an interval into the one before.
        interval = np.floor(time_s * self._rate_hz + 1e-3).astype(np.int64)
        before = np.concatenate(([self._last_interval], interval[:-1]))
        if len(interval):
            self._last_interval = int(interval[-1])
        chosen: NDArray[np.bool_] = (interval != before) | (flags != 0)
        return chosen


class Breaks:
    """Puts NaN into the gaps of curves, also between one block of values and the next."""

    def __init__(self) -> None:
        self._last_s: dict[str, float] = {}

    def in_gaps(self, path: str, most_s: float, time_s: Floats, *columns: Floats) -> tuple[Floats, ...]:
        """Times (n,) and columns (n,) of the curve at the entity `path`, NaN amid gaps above `most_s`."""
        steps_s = np.diff(time_s, prepend=self._last_s.get(path, np.nan))
        self._last_s[path] = float(time_s[-1])
        gaps = np.flatnonzero(steps_s > most_s)
        if not len(gaps):
            return time_s, *columns
        middles_s = time_s[gaps] - 0.5 * steps_s[gaps]
        return np.insert(time_s, gaps, middles_s), *(np.insert(values, gaps, np.nan) for values in columns)


class Gathering:
    """Scalars, line strips and points that wait to be sent to one stream.

    They are sent after `limit_s` seconds of real time, or when there are `limit_rows` scalars.
    """

    def __init__(self, stream: rr.RecordingStream, limit_s: float, limit_rows: int) -> None:
        self._stream = stream
        self._limit_s = limit_s
        self._limit_rows = limit_rows
        self._scalars: dict[str, list[tuple[Floats, Floats]]] = {}
        self._measurements: dict[str, list[tuple[Floats, Floats, Floats]]] = {}
        self._strips: dict[str, tuple[list[float], list[Floats]]] = {}
        self._points: dict[str, tuple[list[float], list[Floats]]] = {}
        self._rows = 0
        self._sent_at = time.monotonic()

    def scalars(self, path: str, times_s: Floats, values: Floats) -> None:
        """Add values (n,) of the curve at the entity `path`."""
        self._scalars.setdefault(path, []).append((times_s, values))
        self._rows += len(times_s)

    def measurements(self, path: str, times_s: Floats, values: Floats, u: Floats) -> None:
        """Add values (n,) with their standard uncertainties of the curve at the entity `path`."""
        self._measurements.setdefault(path, []).append((times_s, values, u))
        self._rows += len(times_s)

    def strips(self, path: str, times_s: Floats, pieces: list[Floats]) -> None:
        """Add line strips (n, 2), one per time."""
        times, known = self._strips.setdefault(path, ([], []))
        times.extend(times_s)
        known.extend(pieces)

    def points(self, path: str, times_s: Floats, points: list[Floats]) -> None:
        """Add single points (2,), one per time."""
        times, known = self._points.setdefault(path, ([], []))
        times.extend(times_s)
        known.extend(points)

    def send(self, *, now: bool = False) -> None:
        """Send everything if a limit is reached, or in any case if `now`."""
        waited_s = time.monotonic() - self._sent_at
        if not now and self._rows < self._limit_rows and waited_s < self._limit_s:
            return
        self._sent_at = time.monotonic()
        self._rows = 0
        scalars, self._scalars = self._scalars, {}
        measurements, self._measurements = self._measurements, {}
        strips, self._strips = self._strips, {}
        points, self._points = self._points, {}
        for path, parts in scalars.items():
            times_s, values = (np.concatenate(column) for column in zip(*parts, strict=True))
            self._stream.send_columns(path, [_column(times_s)], rr.Scalars.columns(scalars=values))
        for path, blocks in measurements.items():
            times_s, values, u = (np.concatenate(column) for column in zip(*blocks, strict=True))
            columns = rr.Measurements.columns(values=values, variances=u**2)
            self._stream.send_columns(path, [_column(times_s)], columns)
        for path, (times, pieces) in strips.items():
            self._stream.send_columns(path, [_column(times)], rr.LineStrips2D.columns(strips=pieces))
        for path, (times, known) in points.items():
            self._stream.send_columns(path, [_column(times)], rr.Points2D.columns(positions=np.array(known)))


def _column(times_s: Floats | list[float]) -> rr.TimeColumn:
    # Rerun converts a list of Python floats one by one, which takes ten times as long as an array.
    return rr.TimeColumn(TIMELINE, duration=np.asarray(times_s, dtype=np.float64))
