"""Reads the record of the run that goes on, in a thread of its own, for the charts and the list of events."""

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

_LOOK_S = 0.1
_KEPT, _POINTS = 20_000, 800
"""Points of a curve that are kept, the newest, and those that are drawn."""
_DIGITS = 5
Point = tuple[float, ...]


class RecordFollower:
    """Follows a record, which need not be there yet, until it is closed; one of the same name is the next.

    `balance` is the last one, as news; `config` its configuration, None before it begins and where it has
    none that can be read. `on_event` is called with each event; its time is that of the day.
    """

    def __init__(self, record: Path, on_event: Callable[[dict[str, Any]], None]) -> None:
        self.record, self._on_event = record, on_event
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._begin(None)
        threading.Thread(target=self._follow, name="record", daemon=True).start()

    def close(self) -> None:
        """Stop reading."""
        self._over.set()

    def _begin(self, config: Configuration | None) -> None:
        with self._lock:
            self.config = config
            self._start_ns: int | None = None
            self._path: deque[Deflections] = deque()
            self._measured = deque[Point](maxlen=_KEPT)
            self._fitted: list[RecordedFittedPoint] = []
            self.balance: dict[str, Any] | None = None

    # -- for who shows it ------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether the record has any frame."""
        return self._start_ns is not None

    def path(self) -> dict[str, list[float | None]]:
        """The last seconds of the trajectory, in some hundred points, as they are shown."""
        with self._lock:
            path = list(self._path)
        return thinned_path(path)

    def history(self) -> dict[str, list[Point]]:
        """Amplitudes since the run began, measured and of the fit, in the shown unit, over time in s."""
        start_ns = self._start_ns or 0
        with self._lock:
            fitted = [
                (_after_s(one.turn_time_ns, start_ns), round(one.amplitude_rad / ARCSEC_RAD, _DIGITS))
                for one in self._fitted
                if math.isfinite(one.amplitude_rad)
            ]
            return {"measured": decimated(self._measured), "fit": decimated(fitted)}

    # -- in its thread -----------------------------------------------------------

    def _follow(self) -> None:
        last = ""
        while not self._over.wait(_LOOK_S):
            try:
                with RecordReader(self.record) as reader:
                    own = reader.metadata["record"]["record_id"]
                    if own == last:
                        continue
                    last = own
                    self._begin(_configuration_of(reader))
                    for _ in reader.follow(_LOOK_S):
                        for piece in reader.unread():
                            self._take(reader, piece)
                            if self._over.is_set():
                                return
            except (RecordError, OSError):
                # not there yet, or set aside
                continue

    def _take(self, reader: RecordReader, piece: Piece) -> None:
        if self._start_ns is None:
            if SPOT.topic not in piece:
                return
            self._start_ns = int(reader.table(SPOT.topic, piece)["time_ns"][0])
        start_ns, size = self._start_ns, reader.deflection_unit.shown_size
        new = piece_contents(reader, piece, start_ns, start_ns)
        if new.balances and self.config is not None:
            self.balance = {"failed_checks": balance_failures(new.balances[-1], self.config.balance)}
        with self._lock:
            if SPOT.topic in piece:
                deflections = reader.deflections(reader.table(SPOT.topic, piece))
                self._path.append(deflections)
                while deflections.times_ns[-1] - self._path[0].times_ns[-1] > PATH_S * NS_PER_S:
                    self._path.popleft()
            for swing in new.half_cycles:
                if not swing.flags:
                    at_s = _after_s(swing.turn_time_ns, start_ns)
                    self._measured.append((at_s, round(swing.amplitude / size, _DIGITS)))
            points = reader.values(RecordedFittedPoint, piece)
            if points:
                # those of an earlier fit are forgotten
                last_ns = points[-1].time_ns
                self._fitted = [one for one in (*self._fitted, *points) if one.time_ns == last_ns]
        for event in new.events:
            event_values = {
                "kind": event.kind,
                "level": event.level,
                "text": event.text,
                "at_s": seconds(event.time_ns + reader.epoch_offset_ns),
            }
            self._on_event(event_values)


def clock(at_s: float) -> str:
    """Time of the day of this computer."""
    return time.strftime("%H:%M:%S", time.localtime(at_s))


def decimated(points: Sequence[Point]) -> list[Point]:
    """Some hundred points of a curve at most, evenly chosen, with the last one."""
    step = max(1, math.ceil(len(points) / _POINTS))
    return list(points)[::-1][::step][::-1]


def _after_s(time_ns: int, start_ns: int) -> float:
    return round(seconds(time_ns - start_ns), 3)


def _configuration_of(reader: RecordReader) -> Configuration | None:
    try:
        return recorded_configuration(reader)
    except RecordError:
        return None
