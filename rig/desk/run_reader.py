"""Reads the record of the running run in a thread of its own, for the charts and the list of events."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import SPOT, RecordedFittedPoint
from processing.deflections import Deflections
from processing.errors import RecordError
from processing.units import ARCSEC_RAD, NS_PER_S, seconds
from rig.devices import PATH_S, thinned_path
from rig.instrument import balance_failures, piece_contents, recorded_configuration
from rig.settings import Configuration

_LOOK_INTERVAL_S = 0.1
_MAX_POINTS = 20_000
"""Most points of a curve in memory; the oldest are dropped."""
_MAX_DRAWN_POINTS = 800
_DECIMALS = 5
Point = tuple[float, ...]


class RecordFollower:
    """Follows a record, which need not exist yet, until it is closed; then the next record of this name.

    `on_event` is called with each event; its time is that of the day.
    """

    def __init__(self, record: Path, on_event: Callable[[dict[str, Any]], None]) -> None:
        self.record, self._on_event = record, on_event
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._begin(None)
        threading.Thread(target=self._follow, name="record", daemon=True).start()

    def close(self) -> None:
        self._stop.set()

    def _begin(self, config: Configuration | None) -> None:
        with self._lock:
            self.config = config
            """Configuration of the record; None before it begins, and if it cannot be read."""
            self._start_ns: int | None = None
            self._path: deque[Deflections] = deque()
            self._measured = deque[Point](maxlen=_MAX_POINTS)
            self._fitted: list[RecordedFittedPoint] = []
            self.balance: dict[str, Any] | None = None
            """The last balance, as news."""

    # -- for the desk ----------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether the record has any frame."""
        return self._start_ns is not None

    def path(self) -> dict[str, list[float | None]]:
        """The last seconds of the trajectory, as some hundred points in the shown unit."""
        with self._lock:
            path = list(self._path)
        return thinned_path(path)

    def history(self) -> dict[str, list[Point]]:
        """Amplitudes since the run began, measured and of the fit, in the shown unit, over time in s."""
        start_ns = self._start_ns or 0
        with self._lock:
            fitted = [
                (_elapsed_s(point.turn_time_ns, start_ns), round(point.amplitude_rad / ARCSEC_RAD, _DECIMALS))
                for point in self._fitted
                if math.isfinite(point.amplitude_rad)
            ]
            return {"measured": decimated(self._measured), "fit": decimated(fitted)}

    # -- in its thread -----------------------------------------------------------

    def _follow(self) -> None:
        last_id = ""
        while not self._stop.wait(_LOOK_INTERVAL_S):
            try:
                with RecordReader(self.record) as reader:
                    record_id = reader.metadata["record"]["record_id"]
                    if record_id == last_id:
                        continue
                    last_id = record_id
                    self._begin(_configuration_of(reader))
                    for _ in reader.follow(_LOOK_INTERVAL_S):
                        for piece in reader.unread():
                            self._take(reader, piece)
                            if self._stop.is_set():
                                return
            except (RecordError, OSError):
                # it does not exist yet, or was renamed after a rejected start
                continue

    def _take(self, reader: RecordReader, piece: Piece) -> None:
        if self._start_ns is None:
            if SPOT.topic not in piece:
                return
            self._start_ns = int(reader.table(SPOT.topic, piece)["time_ns"][0])
        start_ns, size = self._start_ns, reader.deflection_unit.shown_size
        contents = piece_contents(reader, piece, start_ns, start_ns)
        if contents.balances and self.config is not None:
            self.balance = {"failed_checks": balance_failures(contents.balances[-1], self.config.balance)}
        with self._lock:
            if SPOT.topic in piece:
                deflections = reader.deflections(reader.table(SPOT.topic, piece))
                self._path.append(deflections)
                while deflections.times_ns[-1] - self._path[0].times_ns[-1] > PATH_S * NS_PER_S:
                    self._path.popleft()
            for half_cycle in contents.half_cycles:
                if not half_cycle.flags:
                    elapsed_s = _elapsed_s(half_cycle.turn_time_ns, start_ns)
                    self._measured.append((elapsed_s, round(half_cycle.amplitude / size, _DECIMALS)))
            points = [*self._fitted, *reader.values(RecordedFittedPoint, piece)]
            # only the points of the last fit
            self._fitted = [point for point in points if point.time_ns == points[-1].time_ns]
        for event in contents.events:
            time_s = seconds(event.time_ns + reader.epoch_offset_ns)
            self._on_event({"kind": event.kind, "level": event.level, "text": event.text, "time_s": time_s})


def clock(time_s: float) -> str:
    """A time of day as text, in this computer's time zone."""
    return time.strftime("%H:%M:%S", time.localtime(time_s))


def decimated(points: Sequence[Point]) -> list[Point]:
    """At most some hundred points of a curve, evenly chosen, with the last point."""
    step = max(1, math.ceil(len(points) / _MAX_DRAWN_POINTS))
    return list(points)[::-1][::step][::-1]


def _elapsed_s(time_ns: int, start_ns: int) -> float:
    return round(seconds(time_ns - start_ns), 3)


def _configuration_of(reader: RecordReader) -> Configuration | None:
    try:
        return recorded_configuration(reader)
    except RecordError:
        return None
