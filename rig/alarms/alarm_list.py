"""The states of alarms: active, cleared, acknowledged, with the times of each."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from time import time

from processing.errors import RigError
from rig.alarms.catalogue import CATALOGUE, Alarm, AlarmKey, Grade


class AlarmState(StrEnum):
    """How an alarm stands."""

    ACTIVE = "active"
    """Nobody has acknowledged it."""
    CLEARED = "cleared"
    """Its cause is gone, and nobody has acknowledged it."""
    ACKNOWLEDGED = "acknowledged"
    """Somebody has seen it, and its cause is still there."""


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One alarm of the list; times are the computer's clock of the day in s, None for what has not happened.

    `times` is how often it was raised since it came into the list, `earlier` whether it was left over when a
    session began.
    """

    key: AlarmKey
    cause: str
    raised_s: float
    cleared_s: float | None = None
    acknowledged_s: float | None = None
    times: int = 1
    earlier: bool = False

    @property
    def alarm(self) -> Alarm:
        """What the catalogue says of it."""
        return CATALOGUE[self.key]

    @property
    def state(self) -> AlarmState:
        """How it stands."""
        if self.acknowledged_s is not None:
            return AlarmState.ACKNOWLEDGED
        return AlarmState.ACTIVE if self.cleared_s is None else AlarmState.CLEARED

    @property
    def cries(self) -> bool:
        """Whether it is to be heard: it is there, matters, and nobody has seen it yet."""
        matters = self.alarm.grade is not Grade.CAUTION and not self.earlier
        return matters and self.state is AlarmState.ACTIVE


class AlarmList:
    """The list of a rig; may be used from any thread.

    `clock` gives the time of the day in s.
    """

    def __init__(self, clock: Callable[[], float] = time) -> None:
        self._clock = clock
        self._rows: dict[AlarmKey, AlarmRow] = {}
        self._since_s: dict[AlarmKey, float] = {}
        self._lock = threading.Lock()

    def see(self, conditions: Mapping[AlarmKey, str], happened: Iterable[tuple[AlarmKey, str]] = ()) -> None:
        """What holds at this moment, each with its cause, and what has happened since the last call.

        A cause that is empty is the catalogue's.
        """
        now_s = self._clock()
        with self._lock:
            for key, cause in happened:
                self._raise(key, cause, now_s, again=True)
                if not CATALOGUE[key].latched:
                    self._clear(key, now_s)
            for key, cause in conditions.items():
                since_s = self._since_s.setdefault(key, now_s)
                if now_s - since_s >= CATALOGUE[key].after_s:
                    self._raise(key, cause, now_s, again=False)
            for key in [key for key in self._since_s if key not in conditions]:
                del self._since_s[key]
            for key in list(self._rows):
                if key not in conditions and not CATALOGUE[key].latched:
                    self._clear(key, now_s)

    def session_begins(self) -> None:
        """What no condition holds now belongs to what was before: it is still to be seen, and not heard."""
        with self._lock:
            for key, row in self._rows.items():
                if key not in self._since_s:
                    self._rows[key] = replace(row, earlier=True)

    def rows(self) -> list[AlarmRow]:
        """All that is in the list: what is to be seen first comes first."""
        with self._lock:
            return sorted(self._rows.values(), key=_order)

    def acknowledge(self, key: AlarmKey) -> None:
        """Somebody has seen it; one whose cause is gone leaves the list.

        Raises RigError for a trip, whose acknowledgement is more than that.
        """
        with self._lock:
            row = self._row(key)
            if row.alarm.by_leave and row.cleared_s is None:
                raise RigError(f"{key}: {row.alarm.remedy}")
            seen = replace(row, acknowledged_s=self._clock())
            if row.alarm.latched and seen.cleared_s is None and key not in self._since_s:
                seen = replace(seen, cleared_s=seen.acknowledged_s)
            self._rows[key] = seen
            self._leave_if_over(key)

    def _row(self, key: AlarmKey) -> AlarmRow:
        row = self._rows.get(key)
        if row is None:
            raise RigError(f"alarm {key!s}: is not in the list any more")
        return row

    def _raise(self, key: AlarmKey, cause: str, now_s: float, *, again: bool) -> None:
        cause = cause or CATALOGUE[key].cause
        row = self._rows.get(key)
        if row is None:
            self._rows[key] = AlarmRow(key, cause, now_s)
        elif again or row.cleared_s is not None:
            # it comes again: whoever has seen the last one has not seen this one
            self._rows[key] = AlarmRow(key, cause, now_s, times=row.times + 1)
        elif row.earlier or row.cause != cause:
            self._rows[key] = replace(row, cause=cause, earlier=False)

    def _clear(self, key: AlarmKey, now_s: float) -> None:
        row = self._rows[key]
        if row.cleared_s is None:
            row = replace(row, cleared_s=now_s)
            if row.alarm.by_leave and row.acknowledged_s is None:
                # what takes a person to go away was acknowledged by one
                row = replace(row, acknowledged_s=now_s)
            self._rows[key] = row
        self._leave_if_over(key)

    def _leave_if_over(self, key: AlarmKey) -> None:
        row = self._rows[key]
        if row.cleared_s is not None and row.acknowledged_s is not None:
            del self._rows[key]


_STATES = {state: place for place, state in enumerate(AlarmState)}
_GRADES = {grade: place for place, grade in enumerate(Grade)}


def _order(row: AlarmRow) -> tuple[bool, int, int, float]:
    return row.earlier, _STATES[row.state], _GRADES[row.alarm.grade], -row.raised_s
