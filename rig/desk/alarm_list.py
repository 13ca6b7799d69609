"""Every alarm with its usual cause and remedy, and their list: active, cleared, acknowledged, with times."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from time import time
from typing import Final

from processing.errors import RigError


class Grade(StrEnum):
    """How much an alarm matters; the order is that of the list."""

    DANGER = "danger"
    """Light may be where none should be."""
    URGENT = "urgent"
    """What is measured is being lost."""
    CAUTION = "caution"
    """Seen in the list and not heard: data that will have to be looked at."""


class AlarmKey(StrEnum):
    """The alarms, each with its title."""

    LIGHT_DISAGREES = "light although it is commanded off"
    TRIP = "light taken away"
    INTERLOCK = "interlock open"
    LASER_DARK = "laser dark"
    LASER_UNKNOWN = "state of the laser unknown"
    CONTROLLER = "controller does not answer"
    CAMERA = "no frames from the camera"
    SPOT = "spot lost"
    DISK_FULL = "disk full"
    DISK_HANGS = "disk does not answer"
    DISK_FORECAST = "disk will be full before the end"
    SESSION_DIED = "session died"
    SESSION_FROZEN = "session does not answer"
    SESSION_FAILED = "session failed"
    STALLED = "run in trouble"
    PREFLIGHT = "preflight says no-go"
    DISTURBED = "data disturbed"
    ENVIRONMENT = "environment not measured"
    BALANCE = "out of balance"
    WATCHER = "alarms are not judged"
    DESK_LOST = "the desk does not answer"


RaisedAlarm = tuple[AlarmKey, str]
"""An alarm and its cause; one that is empty is the catalogue's."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """What is known of an alarm before it is raised.

    `cause` is the usual one, used where nothing tells the real one. `latched`: it has happened, and stays
    active until somebody acknowledges it. `after_s`: for so long its condition holds before it is raised.
    `by_leave`: its acknowledgement is that of the light, after looking, and is given nowhere else.
    """

    cause: str
    remedy: str
    grade: Grade = Grade.CAUTION
    latched: bool = False
    after_s: float = 0.0
    by_leave: bool = False


_DANGER, _URGENT = Grade.DANGER, Grade.URGENT

CATALOGUE: Final[Mapping[AlarmKey, Alarm]] = {
    AlarmKey.LIGHT_DISAGREES: Alarm(
        "the laser's output, or its light in the picture, is seen to be on",
        "turn the key switch; then check its driver and cable",
        _DANGER,
    ),
    AlarmKey.TRIP: Alarm(
        "the interlock opened, a watchdog ran out, or somebody pressed LIGHT OFF",
        "check that nobody is in the beam path, then Acknowledge trip",
        _DANGER,
        by_leave=True,
    ),
    AlarmKey.INTERLOCK: Alarm(
        "a door, a cover or the connector of the loop is open",
        "close it, then press Acknowledge trip and Light again; the laser stays dark until then",
        _DANGER,
    ),
    AlarmKey.LASER_DARK: Alarm(
        "its light was taken away during a run",
        "remove the cause, acknowledge the trip, then Light again",
        _URGENT,
    ),
    AlarmKey.LASER_UNKNOWN: Alarm(
        "it has not reported for more than 2 s",
        "check cable and power of laser and controller; assume until then that the laser is lit",
        _URGENT,
    ),
    AlarmKey.CONTROLLER: Alarm(
        "its cable or its power",
        "plug it in again; it is found automatically",
        _URGENT,
        after_s=1.5,
    ),
    AlarmKey.CAMERA: Alarm(
        "unplugged, without power, or without its trigger",
        "check cable, power and trigger at once: it is reopened automatically, but the laser goes dark after "
        "some seconds without frames, and that may end the run",
        _URGENT,
    ),
    AlarmKey.SPOT: Alarm(
        "the beam is blocked or misses the sensor, or the swing is too large",
        "look at the picture; clear the beam path, or align again",
        _URGENT,
    ),
    AlarmKey.DISK_FULL: Alarm(
        "less space is free than closing a run needs",
        "free some space on the disk of session.output, or name another folder there",
        _URGENT,
    ),
    AlarmKey.DISK_HANGS: Alarm(
        "a network drive has gone, or a disk is failing",
        "check the drive; frames wait in memory for about half a minute",
        _URGENT,
    ),
    AlarmKey.DISK_FORECAST: Alarm(
        "the record will outgrow the free space",
        "free some space now; if the disk does fill up, the record is closed complete",
        _URGENT,
        after_s=1.0,
    ),
    AlarmKey.SESSION_DIED: Alarm(
        "its process was killed or crashed",
        "check that the laser is dark; then press Resume to measure the missing runs. Recorded data are kept",
        _URGENT,
        latched=True,
    ),
    AlarmKey.SESSION_FROZEN: Alarm(
        "its process is stopped, or is waiting for a disk or a device",
        "wait half a minute; LIGHT OFF still works. If it stays silent, press Stop: it ends the process, "
        "and the record is kept",
        _URGENT,
    ),
    AlarmKey.SESSION_FAILED: Alarm(
        "an error ended it early",
        "remove the cause that the error names, then start again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.STALLED: Alarm(
        "a part of the run has stalled; a laser that the program switches is told off",
        "check the computer's load and disk; the record is complete up to here",
        _URGENT,
    ),
    AlarmKey.PREFLIGHT: Alarm(
        "a check before the run has failed",
        "see its remedy under Rig; then start again, or overrule it for this session",
        _URGENT,
    ),
    AlarmKey.DISTURBED: Alarm(
        "frames were lost, a clock was set, or something was touched",
        "keep away, keep the room dark, close other programs; the run's events name every disturbance",
        latched=True,
    ),
    AlarmKey.ENVIRONMENT: Alarm(
        "the sensor does not answer",
        "check its cable and port; without it the run has no temperature, humidity or pressure",
        after_s=1.0,
    ),
    AlarmKey.BALANCE: Alarm(
        "the pendulum turns, was pushed sideways at the start, or its weights are not set",
        "the run is recorded; before the next one balance the pendulum and let it settle (rig balance)",
        after_s=5.0,
    ),
    AlarmKey.WATCHER: Alarm(
        "a part of the desk that looks for alarms has failed",
        "end the desk and open it again; a session goes on",
        _URGENT,
        latched=True,
    ),
    AlarmKey.DESK_LOST: Alarm(
        "its process has ended or hangs, or the connection is gone",
        "start rig desk again: this page reconnects automatically; a running session continues; "
        "to darken the laser now, turn the key switch",
        _URGENT,
    ),
}


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

    def see(self, conditions: Mapping[AlarmKey, str], happened: Iterable[RaisedAlarm] = ()) -> None:
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
            # it comes again: the operator has seen the last one, and not this one
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
