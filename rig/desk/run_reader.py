"""Reads the record of the run that goes on, in a thread of its own, for the charts and the list of events."""

import math
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from acquisition.record.events import Event
from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import FITTED, SPOT, RecordedEstimate, RecordedFittedPoint
from processing.balance import Balance
from processing.deflections import Deflections
from processing.errors import RecordError
from processing.estimate import Estimate
from processing.units import NS_PER_S, seconds
from rig.desk.run_history import GroundNow, RunHistory, spectrum
from rig.instrument import advice_for, balance_failures, recorded_configuration, told_in
from rig.orders import PATH_S, thinned_path
from rig.settings import Configuration

_LOOK_S = 0.1
_EVENTS = 500


class RunReader:
    """Follows a record, which need not be there yet, until it is closed; one of the same name is the next.

    `began_s` is when the record began on the monotonic clock, NaN before; `balance` the last one, as news.
    """

    def __init__(self, record: Path) -> None:
        self.record = record
        self._lock = threading.Lock()
        self._one_spectrum = threading.Lock()
        self._over = threading.Event()
        self._begin(None)
        threading.Thread(target=self._follow, name="record", daemon=True).start()

    def close(self) -> None:
        """Read no more."""
        self._over.set()

    def _begin(self, config: Configuration | None) -> None:
        with self._lock:
            self._config = config
            self._start_ns: int | None = None
            self._path: deque[Deflections] = deque()
            self._history = RunHistory()
            self._ground = GroundNow(None if config is None else config.pendulum)
            self._events: deque[tuple[float, Event]] = deque(maxlen=_EVENTS)
            self.balance: dict[str, Any] | None = None
            self.began_s = math.nan

    # -- for who shows it ------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether the record has any frame."""
        return self._start_ns is not None

    def take_events(self) -> list[tuple[float, Event]]:
        """Events since the last call, each with its time in s since the record began."""
        with self._lock:
            taken, self._events = list(self._events), deque(maxlen=_EVENTS)
        return taken

    def path(self) -> dict[str, list[float | None]]:
        """The last seconds of the trajectory, in some hundred points, as they are shown."""
        with self._lock:
            path = list(self._path)
        return thinned_path(path)

    def history(self, *, spectra: bool) -> dict[str, Any]:
        """What charts show of the run since it began, decimated.

        With `spectra` also those of its last minutes, which take longer than all the rest.
        """
        with self._lock:
            told, path = self._history.told(), list(self._path)
            ground, parts = self._ground, self._ground.parts()
        if not spectra:
            return told
        with self._one_spectrum:
            return {**told, "spectrum": spectrum(path), "ground": ground.spectrum(*parts)}

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
            ago_s = time.time() - seconds(self._start_ns + reader.epoch_offset_ns)
            self.began_s = time.monotonic() - ago_s
        start_ns, size = self._start_ns, reader.deflection_unit.shown_size
        told = told_in(reader, piece, start_ns, start_ns)
        if told.balances and self._config is not None:
            self.balance = _told(self._config, told.balances[-1])
        with self._lock:
            if SPOT.topic in piece:
                deflections = reader.deflections(reader.rows(SPOT.topic, piece[SPOT.topic]))
                self._history.motion(start_ns, deflections)
                self._ground.take(deflections, told.swings)
                self._path.append(deflections)
                while deflections.times_ns[-1] - self._path[0].times_ns[-1] > PATH_S * NS_PER_S:
                    self._path.popleft()
            for swing in told.swings:
                if not swing.flags:
                    self._history.swing(start_ns, swing, size)
            for row in told.of(RecordedEstimate):
                one = Estimate(row.value, row.u_value)
                self._history.estimate(seconds(row.time_ns - start_ns), row.quantity, one)
            points = piece.get(FITTED.topic, ())
            self._history.fitted(reader.values(FITTED.topic, RecordedFittedPoint, points))
            self._events.extend((seconds(event.time_ns - start_ns), event) for event in told.events)


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


def newest_first(
    news: Mapping[str, Any], events: Iterable[Mapping[str, Any]]
) -> Sequence[tuple[float, Mapping[str, Any]]]:
    """Events as they were told, the newest first, each with its time since the present run's record began.

    That is negative before, and NaN while no record has begun: then they are in the order of their numbers.
    """
    timed = [(_since_record(news, event), event) for event in events]
    return sorted(
        timed, key=lambda one: (0.0 if math.isnan(one[0]) else one[0], one[1]["number"]), reverse=True
    )


def _since_record(news: Mapping[str, Any], event: Mapping[str, Any]) -> float:
    """An event of this run's record has its time. What was noted without one, and what belongs to an earlier
    run, whose own times count from another record, is placed by when it was noted.
    """
    began_s, elapsed_s = (
        math.nan if told is None else float(told) for told in (news.get("record_began_s"), event["elapsed_s"])
    )
    if event["run"] == news.get("run") and not math.isnan(began_s + elapsed_s):
        return elapsed_s
    return float(event["noted_s"]) - began_s
