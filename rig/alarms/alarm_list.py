"""The states of alarms: active, cleared, acknowledged, shelved, with the times of each."""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from time import time

from pydantic import TypeAdapter, ValidationError

from processing.errors import RigError
from rig.alarms.catalogue import CATALOGUE, Alarm, AlarmKey, Grade

_PAST_KEPT = 200
_SHELF_S = 600.0


class AlarmState(StrEnum):
    """How an alarm stands."""

    ACTIVE = "active"
    """Nobody has acknowledged it."""
    CLEARED = "cleared"
    """Its cause is gone, and nobody has acknowledged it."""
    ACKNOWLEDGED = "acknowledged"
    """Somebody has seen it, and its cause is still there."""
    SHELVED = "shelved"
    """Put aside by a person for a stated time."""


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
    shelved_until_s: float | None = None
    times: int = 1
    earlier: bool = False

    @property
    def alarm(self) -> Alarm:
        """What the catalogue says of it."""
        return CATALOGUE[self.key]

    @property
    def state(self) -> AlarmState:
        """How it stands."""
        if self.shelved_until_s is not None:
            return AlarmState.SHELVED
        if self.acknowledged_s is not None:
            return AlarmState.ACKNOWLEDGED
        return AlarmState.ACTIVE if self.cleared_s is None else AlarmState.CLEARED

    @property
    def cries(self) -> bool:
        """Whether it is to be heard: it is there, matters, and nobody has seen it yet."""
        matters = self.alarm.grade is not Grade.CAUTION and not self.earlier
        return matters and self.state is AlarmState.ACTIVE


@dataclass(frozen=True, slots=True)
class _Kept:
    rows: tuple[AlarmRow, ...] = ()
    past: tuple[AlarmRow, ...] = ()


_KEPT = TypeAdapter(_Kept)


class AlarmList:
    """The list of a rig; may be used from any thread.

    `clock` gives the time of the day in s.
    """

    def __init__(self, clock: Callable[[], float] = time) -> None:
        self._clock = clock
        self._rows: dict[AlarmKey, AlarmRow] = {}
        self._since_s: dict[AlarmKey, float] = {}
        self._lock = threading.Lock()
        self.past: deque[AlarmRow] = deque(maxlen=_PAST_KEPT)

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
            for key, row in list(self._rows.items()):
                if row.shelved_until_s is not None and row.shelved_until_s <= now_s:
                    self._rows[key] = replace(row, shelved_until_s=None)
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

    def kept(self) -> bytes:
        """The list and what has left it, for a file from which `restore` makes them again."""
        with self._lock:
            return _KEPT.dump_json(_Kept(tuple(self._rows.values()), tuple(self.past)))

    def restore(self, kept: bytes) -> None:
        """Go on with the list of an earlier desk; what is no such list is passed over.

        What nobody has seen stays to be seen, and is heard where its cause is found again. A cause that is
        not is gone, as of now.
        """
        try:
            found = _KEPT.validate_json(kept)
        except ValidationError:
            return
        with self._lock:
            for row in found.rows:
                self._rows.setdefault(row.key, replace(row, earlier=True))
            self.past.extend(found.past)

    def acknowledge(self, key: AlarmKey) -> None:
        """Somebody has seen it; one whose cause is gone leaves the list.

        Raises RigError for a trip, whose acknowledgement is more than that.
        """
        with self._lock:
            row = self._row(key)
            if row.alarm.by_leave and row.cleared_s is None:
                raise RigError(f"{row.alarm.title}: {row.alarm.remedy}")
            seen = replace(row, acknowledged_s=self._clock(), shelved_until_s=None)
            if row.alarm.latched and seen.cleared_s is None and key not in self._since_s:
                seen = replace(seen, cleared_s=seen.acknowledged_s)
            self._rows[key] = seen
            self._leave_if_over(key)

    def shelve(self, key: AlarmKey) -> None:
        """Put it aside for ten minutes; it comes back by itself. Raises RigError for danger, which stays."""
        with self._lock:
            row = self._row(key)
            if row.alarm.grade is Grade.DANGER:
                raise RigError(f"{row.alarm.title}: danger is not shelved; {row.alarm.remedy}")
            self._rows[key] = replace(row, shelved_until_s=self._clock() + _SHELF_S)

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
            self._rows[key] = AlarmRow(
                key, cause, now_s, shelved_until_s=row.shelved_until_s, times=row.times + 1
            )
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
            self.past.appendleft(replace(row, shelved_until_s=None))
            del self._rows[key]


_STATES = {state: place for place, state in enumerate(AlarmState)}
_GRADES = {grade: place for place, grade in enumerate(Grade)}


def _order(row: AlarmRow) -> tuple[bool, int, int, float]:
    return row.earlier, _STATES[row.state], _GRADES[row.alarm.grade], -row.raised_s
