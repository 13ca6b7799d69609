"""Every alarm with its usual cause and remedy, and their list: active, cleared, acknowledged, with times."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from time import time
from typing import Final, Self

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
    """The alarms: each with its title, its usual cause, its remedy, and how much it matters.

    The cause is used where nothing tells the real one.
    """

    cause: str
    remedy: str
    grade: Grade

    def __new__(cls, title: str, cause: str, remedy: str, grade: Grade) -> Self:
        alarm = str.__new__(cls, title)
        alarm._value_ = title
        alarm.cause, alarm.remedy, alarm.grade = cause, remedy, grade
        return alarm

    LIGHT_DISAGREES = (
        "light although it is commanded off",
        "the laser's output, or its light in the picture, is seen to be on",
        "turn the key switch; then check its driver and cable",
        Grade.DANGER,
    )
    TRIP = (
        "light taken away",
        "the interlock opened, a watchdog ran out, or somebody pressed LIGHT OFF",
        "check that nobody is in the beam path, then Acknowledge trip",
        Grade.DANGER,
    )
    INTERLOCK = (
        "interlock open",
        "a door, a cover or the connector of the loop is open",
        "close it, then press Acknowledge trip and Light again; the laser stays dark until then",
        Grade.DANGER,
    )
    LASER_DARK = (
        "laser dark",
        "its light was taken away during a run",
        "remove the cause, acknowledge the trip, then Light again",
        Grade.URGENT,
    )
    LASER_UNKNOWN = (
        "state of the laser unknown",
        "it has not reported for more than 2 s",
        "check cable and power of laser and controller; assume until then that the laser is lit",
        Grade.URGENT,
    )
    CONTROLLER = (
        "controller does not answer",
        "its cable or its power",
        "plug it in again; it is found automatically",
        Grade.URGENT,
    )
    CAMERA = (
        "no frames from the camera",
        "unplugged, without power, or without its trigger",
        (
            "check cable, power and trigger at once: it is reopened automatically, but the laser goes dark "
            "after some seconds without frames, and that may end the run"
        ),
        Grade.URGENT,
    )
    SPOT = (
        "spot lost",
        "the beam is blocked or misses the sensor, or the swing is too large",
        "look at the picture; clear the beam path, or align again",
        Grade.URGENT,
    )
    DISK_FULL = (
        "disk full",
        "less space is free than closing a run needs",
        "free some space on the disk of session.output, or name another folder there",
        Grade.URGENT,
    )
    DISK_HANGS = (
        "disk does not answer",
        "a network drive has gone, or a disk is failing",
        "check the drive; frames wait in memory for about half a minute",
        Grade.URGENT,
    )
    DISK_FORECAST = (
        "disk will be full before the end",
        "the record will outgrow the free space",
        "free some space now; if the disk does fill up, the record is closed complete",
        Grade.URGENT,
    )
    SESSION_DIED = (
        "session died",
        "its process was killed or crashed",
        "check that the laser is dark; then press Resume to measure the missing runs. Recorded data are kept",
        Grade.URGENT,
    )
    SESSION_FROZEN = (
        "session does not answer",
        "its process is stopped, or is waiting for a disk or a device",
        (
            "wait half a minute; LIGHT OFF still works. If it stays silent, press Stop: it ends the process, "
            "and the record is kept"
        ),
        Grade.URGENT,
    )
    SESSION_FAILED = (
        "session failed",
        "an error ended it early",
        "remove the cause that the error names, then start again",
        Grade.URGENT,
    )
    STALLED = (
        "run in trouble",
        "a part of the run has stalled; a laser that the program switches is told off",
        "check the computer's load and disk; the record is complete up to here",
        Grade.URGENT,
    )
    PREFLIGHT = (
        "preflight says no-go",
        "a check before the run has failed",
        "see its remedy under Rig; then start again, or overrule it for this session",
        Grade.URGENT,
    )
    DISTURBED = (
        "data disturbed",
        "frames were lost, a clock was set, or something was touched",
        "keep away, keep the room dark, close other programs; the run's events name every disturbance",
        Grade.CAUTION,
    )
    ENVIRONMENT = (
        "environment not measured",
        "the sensor does not answer",
        "check its cable and port; without it the run has no temperature, humidity or pressure",
        Grade.CAUTION,
    )
    BALANCE = (
        "out of balance",
        "the pendulum turns, was pushed sideways at the start, or its weights are not set",
        "the run is recorded; before the next one balance the pendulum and let it settle (rig balance)",
        Grade.CAUTION,
    )
    WATCHER = (
        "alarms are not judged",
        "a part of the desk that looks for alarms has failed",
        "end the desk and open it again; a session goes on",
        Grade.URGENT,
    )
    DESK_LOST = (
        "the desk does not answer",
        "its process has ended or hangs, or the connection is gone",
        (
            "start rig desk again: this page reconnects automatically; a running session continues; "
            "to darken the laser now, turn the key switch"
        ),
        Grade.URGENT,
    )


RaisedAlarm = tuple[AlarmKey, str]
"""An alarm and its cause; one that is empty is the usual one."""
_LATCHED: Final = frozenset(
    {AlarmKey.SESSION_DIED, AlarmKey.SESSION_FAILED, AlarmKey.DISTURBED, AlarmKey.WATCHER}
)
"""What has happened, and is active until somebody acknowledges it."""
AFTER_S: Final[Mapping[AlarmKey, float]] = {
    AlarmKey.CONTROLLER: 1.5,
    AlarmKey.DISK_FORECAST: 1.0,
    AlarmKey.ENVIRONMENT: 1.0,
    AlarmKey.BALANCE: 5.0,
}
"""For how long a condition holds before it is an alarm, where that is longer than a moment."""


class AlarmState(StrEnum):
    """How an alarm stands; the order is that of the list."""

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
    def state(self) -> AlarmState:
        """How it stands."""
        if self.acknowledged_s is not None:
            return AlarmState.ACKNOWLEDGED
        is_active = self.cleared_s is None or self.key in _LATCHED
        return AlarmState.ACTIVE if is_active else AlarmState.CLEARED

    @property
    def cries(self) -> bool:
        """Whether it is to be heard: it is there, matters, and nobody has seen it yet."""
        matters = self.key.grade is not Grade.CAUTION and not self.earlier
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
        """What holds at this moment, each with its cause, and what has happened since the last call."""
        now_s = self._clock()
        with self._lock:
            self._since_s = {key: self._since_s.get(key, now_s) for key in conditions}
            for key, cause in happened:
                self._raise(key, cause, now_s, again=True)
            for key, cause in conditions.items():
                if now_s - self._since_s[key] >= AFTER_S.get(key, 0.0):
                    self._raise(key, cause, now_s, again=False)
            for key, row in list(self._rows.items()):
                if key in conditions or row.cleared_s is not None:
                    continue
                if key is AlarmKey.TRIP or row.acknowledged_s is not None:
                    # a trip goes away because a person has acknowledged it
                    del self._rows[key]
                else:
                    self._rows[key] = replace(row, cleared_s=now_s)

    def session_begins(self) -> None:
        """What no condition holds now belongs to what was before: it is still to be seen, and not heard."""
        with self._lock:
            for key, row in self._rows.items():
                self._rows[key] = replace(row, earlier=row.earlier or row.cleared_s is not None)

    def rows(self) -> list[AlarmRow]:
        """All that is in the list: what is to be seen first comes first."""
        with self._lock:
            return sorted(self._rows.values(), key=_order)

    def acknowledge(self, key: AlarmKey) -> None:
        """Somebody has seen it; one whose cause is gone leaves the list.

        Raises RigError for a trip, whose acknowledgement is more than that.
        """
        with self._lock:
            row = self._rows.get(key)
            if row is None:
                raise RigError(f"alarm {key!s}: is not in the list any more")
            if key is AlarmKey.TRIP:
                raise RigError(f"{key}: {key.remedy}")
            if row.cleared_s is not None:
                del self._rows[key]
            else:
                self._rows[key] = replace(row, acknowledged_s=self._clock())

    def _raise(self, key: AlarmKey, cause: str, now_s: float, *, again: bool) -> None:
        cause = cause or key.cause
        row = self._rows.get(key)
        if row is None or again or row.cleared_s is not None:
            # where it comes again the operator has seen the last one, and not this one
            self._rows[key] = AlarmRow(key, cause, now_s, times=1 if row is None else row.times + 1)
        elif row.earlier or row.cause != cause:
            self._rows[key] = replace(row, cause=cause, earlier=False)


def _order(row: AlarmRow) -> tuple[bool, int, int, float]:
    return row.earlier, list(AlarmState).index(row.state), list(Grade).index(row.key.grade), -row.raised_s
