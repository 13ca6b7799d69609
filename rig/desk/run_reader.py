"""Reads the record of the run that goes on, in a thread of its own, for the charts and the list of events."""

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from acquisition.frames.queue import taken_from
from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import KIND_OF, SPOT, RecordedFittedPoint
from processing.balance import Balance
from processing.deflections import Deflections
from processing.errors import RecordError
from processing.units import ARCSEC_RAD, NS_PER_S, seconds
from rig.devices import PATH_S, thinned_path
from rig.instrument import advice_for, balance_failures, piece_contents, recorded_configuration
from rig.settings import Configuration

_LOOK_S = 0.1
_EVENTS = 500
_KEPT, _POINTS = 20_000, 800
"""Points of a curve that are kept, the newest, and those that are drawn."""
_DIGITS = 5
Point = tuple[float, ...]


class RecordFollower:
    """Follows a record, which need not be there yet, until it is closed; one of the same name is the next.

    `balance` is the last one, as news; `config` its configuration, None before it begins and where it has
    none that can be read.
    """

    def __init__(self, record: Path) -> None:
        self.record = record
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._begin(None)
        threading.Thread(target=self._follow, name="record", daemon=True).start()

    def close(self) -> None:
        """Read no more."""
        self._over.set()

    def _begin(self, config: Configuration | None) -> None:
        with self._lock:
            self.config = config
            self._start_ns: int | None = None
            self._path: deque[Deflections] = deque()
            self._swings = {name: deque[Point](maxlen=_KEPT) for name in ("amplitude", "period")}
            self._fitted: list[RecordedFittedPoint] = []
            self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
            self.balance: dict[str, Any] | None = None

    # -- for who shows it ------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether the record has any frame."""
        return self._start_ns is not None

    def take_events(self) -> list[dict[str, Any]]:
        """Events since the last call; their times are in s since the record began, and of the day."""
        with self._lock:
            return taken_from(self._events)

    def path(self) -> dict[str, list[float | None]]:
        """The last seconds of the trajectory, in some hundred points, as they are shown."""
        with self._lock:
            path = list(self._path)
        return thinned_path(path)

    def history(self) -> dict[str, Any]:
        """What charts show of the run since it began: swings and fit, amplitudes as shown."""
        with self._lock:
            return {
                "swings": {name: decimated(points) for name, points in self._swings.items()},
                "fit": _drawn(self._fitted, self._start_ns or 0),
            }

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
            self._start_ns = int(reader.rows(SPOT.topic, piece[SPOT.topic][:1])["time_ns"][0])
        start_ns, size = self._start_ns, reader.deflection_unit.shown_size
        told = piece_contents(reader, piece, start_ns, start_ns)
        if told.balances and self.config is not None:
            self.balance = _told(self.config, told.balances[-1])
        with self._lock:
            if SPOT.topic in piece:
                deflections = reader.deflections(reader.rows(SPOT.topic, piece[SPOT.topic]))
                self._path.append(deflections)
                while deflections.times_ns[-1] - self._path[0].times_ns[-1] > PATH_S * NS_PER_S:
                    self._path.popleft()
            for swing in told.swings:
                if not swing.flags:
                    at_s = round(seconds(swing.turn_time_ns - start_ns), 3)
                    self._swings["amplitude"].append((at_s, round(swing.amplitude / size, _DIGITS)))
                    if math.isfinite(swing.half_period_s):
                        self._swings["period"].append((at_s, round(2.0 * swing.half_period_s, _DIGITS)))
            points = reader.values(RecordedFittedPoint, piece.get(KIND_OF[RecordedFittedPoint].topic, ()))
            if points:
                # those of an earlier fit are forgotten
                last_ns = points[-1].time_ns
                self._fitted = [one for one in (*self._fitted, *points) if one.time_ns == last_ns]
            for event in told.events:
                told_of = {
                    "elapsed_s": seconds(event.time_ns - start_ns),
                    "kind": event.kind,
                    "level": event.level,
                    "text": event.text,
                    "at": clock(seconds(event.time_ns + reader.epoch_offset_ns)),
                }
                self._events.append(told_of)


def clock(at_s: float) -> str:
    """Time of the day of this computer."""
    return time.strftime("%H:%M:%S", time.localtime(at_s))


def decimated(points: Sequence[Point]) -> list[Point]:
    """At most some hundred of the points of a curve, evenly; its last one is among them."""
    step = max(1, math.ceil(len(points) / _POINTS))
    return list(points)[::-1][::step][::-1]


def _drawn(points: Sequence[RecordedFittedPoint], start_ns: int) -> dict[str, list[Point]]:
    """The fit's curves and what it leaves over as they are shown; empty before the first fit."""
    at_s = [round(seconds(one.turn_time_ns - start_ns), 3) for one in points]
    curves = {
        "amplitude": [round(one.amplitude_rad / ARCSEC_RAD, _DIGITS) for one in points],
        "amplitude_residual": [round(one.amplitude_residual, 2) for one in points],
        "period": [one.period_s for one in points],
        "period_residual": [round(one.period_residual, 2) for one in points],
    }
    return {
        name: decimated([one for one in zip(at_s, values, strict=True) if math.isfinite(one[1])])
        for name, values in curves.items()
    }


def _told(config: Configuration, balance: Balance) -> dict[str, Any]:
    return {
        "next_step": advice_for(config, balance).next_step or None,
        "against": balance_failures(balance, config.balance),
    }


def _configuration_of(reader: RecordReader) -> Configuration | None:
    try:
        return recorded_configuration(reader)
    except RecordError:
        return None
