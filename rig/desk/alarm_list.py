"""The alarms with their remedies, and their list: active, cleared, acknowledged, with times."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from time import time
from typing import Final, Self

from processing.errors import RigError

_SILENT: Final = False
"""Sound of an alarm that only concerns data, which have to be inspected later."""


class AlarmKey(StrEnum):
    """The alarms, the gravest first: each with its title, its remedy, and whether it sounds."""

    remedy: str
    has_sound: bool

    def __new__(cls, title: str, remedy: str, has_sound: bool = True) -> Self:
        alarm = str.__new__(cls, title)
        alarm._value_ = title
        alarm.remedy, alarm.has_sound = remedy, has_sound
        return alarm

    LIGHT_DISAGREES = (
        "light although it is commanded off",
        "turn the key switch; then check its driver and cable",
    )
    TRIP = "light taken away", "check that nobody is in the beam path, then Acknowledge trip"
    INTERLOCK = (
        "interlock open",
        "close it, then press Acknowledge trip and Light again; the laser stays dark until then",
    )
    LASER_DARK = "laser dark", "remove the cause, acknowledge the trip, then Light again"
    LASER_UNKNOWN = (
        "state of the laser unknown",
        "check cable and power of laser and controller; assume until then that the laser is lit",
    )
    CONTROLLER = "controller does not answer", "plug it in again; it is found automatically"
    CAMERA = (
        "no frames from the camera",
        (
            "check cable, power and trigger at once: it is reopened automatically, but the laser goes dark "
            "after some seconds without frames, and that may end the run"
        ),
    )
    SPOT = "spot lost", "look at the picture; clear the beam path, or align again"
    DISK_FULL = "disk full", "free some space on the disk of session.output, or name another folder there"
    DISK_HANGS = "disk does not answer", "check the drive; frames wait in memory for about half a minute"
    DISK_FORECAST = (
        "disk will be full before the end",
        "free some space now; if the disk does fill up, the record is closed complete",
    )
    SESSION_DIED = (
        "session died",
        (
            "check that the laser is dark; then mark it in Runs and press Resume to measure the missing "
            "runs. Recorded data are kept"
        ),
    )
    SESSION_FROZEN = (
        "session does not answer",
        (
            "wait half a minute; LIGHT OFF still works. If it stays silent, press Stop: it ends the "
            "process, and the record is kept"
        ),
    )
    SESSION_FAILED = "session failed", "remove the cause that the error names, then start again"
    STALLED = "run in trouble", "check the computer's load and disk; the record is complete up to here"
    PREFLIGHT = (
        "preflight says no-go",
        "see its remedy under Rig; then start again, or overrule it for this session",
    )
    WATCHER = "alarms are not judged", "end the desk and open it again; a session goes on"
    DESK_LOST = (
        "the desk does not answer",
        (
            "start rig desk again: this page reconnects automatically; a running session continues; to "
            "darken the laser now, turn the key switch"
        ),
    )
    DISTURBED = (
        "data disturbed",
        "keep away, keep the room dark, close other programs; the run's events name every disturbance",
        _SILENT,
    )
    ENVIRONMENT = (
        "environment not measured",
        "check its cable and port; without it the run has no temperature, humidity or pressure",
        _SILENT,
    )
    BALANCE = (
        "out of balance",
        "the run is recorded; before the next one balance the pendulum and let it settle (rig balance)",
        _SILENT,
    )


RaisedAlarm = tuple[AlarmKey, str]
"""An alarm and its cause."""
_LATCHED: Final = frozenset(
    {AlarmKey.SESSION_DIED, AlarmKey.SESSION_FAILED, AlarmKey.DISTURBED, AlarmKey.WATCHER}
)
"""Alarms by events, which are active until a person acknowledges them, or the next session begins."""
ALARM_DELAY_S: Final[Mapping[AlarmKey, float]] = {
    AlarmKey.CONTROLLER: 1.5,
    # a desk that was itself delayed finds all news late at its first look
    AlarmKey.SESSION_FROZEN: 0.4,
    AlarmKey.DISK_FORECAST: 1.0,
    AlarmKey.ENVIRONMENT: 1.0,
    AlarmKey.BALANCE: 5.0,
}
"""Time in s for which a condition must hold before it raises an alarm; 0 for all other alarms."""


class AlarmState(StrEnum):
    """States of an alarm, in the order of the list."""

    ACTIVE = "active"
    """Its cause is present, and it is not acknowledged."""
    CLEARED = "cleared"
    """Its cause is gone, and it is not acknowledged."""
    ACKNOWLEDGED = "acknowledged"
    """A person has acknowledged it, and its cause is still present."""


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One alarm of the list; times are those of the day in s, None if it has not come to that."""

    key: AlarmKey
    cause: str
    raised_s: float
    cleared_s: float | None = None
    acknowledged_s: float | None = None
    count: int = 1
    """How often the alarm was raised since it came into the list."""

    @property
    def state(self) -> AlarmState:
        if self.acknowledged_s is not None:
            return AlarmState.ACKNOWLEDGED
        return AlarmState.ACTIVE if self.cleared_s is None else AlarmState.CLEARED

    @property
    def is_loud(self) -> bool:
        """Whether the alarm sounds now."""
        return self.key.has_sound and self.state is AlarmState.ACTIVE


class AlarmList:
    """The alarms of a rig; may be used from any thread. `clock` gives the time of the day in s."""

    def __init__(self, clock: Callable[[], float] = time) -> None:
        self._clock = clock
        self._rows: dict[AlarmKey, AlarmRow] = {}
        self._condition_began_s: dict[AlarmKey, float] = {}
        self._lock = threading.Lock()

    def update(self, conditions: Mapping[AlarmKey, str], events: Iterable[RaisedAlarm] = ()) -> None:
        """Update the list by the conditions that hold now, with causes, and by events since the last call."""
        now_s = self._clock()
        with self._lock:
            self._condition_began_s = {key: self._condition_began_s.get(key, now_s) for key in conditions}
            for key, cause in events:
                self._raise(key, cause, now_s, again=True)
            for key, cause in conditions.items():
                if now_s - self._condition_began_s[key] >= ALARM_DELAY_S.get(key, 0.0):
                    self._raise(key, cause, now_s, again=False)
            for key, row in list(self._rows.items()):
                if key in conditions or key in _LATCHED or row.cleared_s is not None:
                    continue
                if key is AlarmKey.TRIP or row.acknowledged_s is not None:
                    # a trip goes away because a person has acknowledged it
                    del self._rows[key]
                else:
                    self._rows[key] = replace(row, cleared_s=now_s)

    def session_begins(self) -> None:
        """Clear the alarms by events of earlier sessions; they are listed until they are acknowledged."""
        with self._lock:
            for key in _LATCHED & self._rows.keys():
                self._rows[key] = replace(self._rows[key], cleared_s=self._clock())

    def rows(self) -> list[AlarmRow]:
        """All alarms, in the order of the list."""
        with self._lock:
            states, keys = list(AlarmState), list(AlarmKey)
            return sorted(self._rows.values(), key=lambda row: (states.index(row.state), keys.index(row.key)))

    def acknowledge(self, key: AlarmKey) -> None:
        """Acknowledge an alarm for a person; if its cause is gone, it leaves the list.

        Raises RigError for a trip, which is acknowledged at the devices.
        """
        with self._lock:
            row = self._rows.get(key)
            if row is None:
                raise RigError(f"alarm {key!s}: is not in the list any more")
            if key is AlarmKey.TRIP:
                raise RigError(f"{key}: {key.remedy}")
            if row.cleared_s is not None or key in _LATCHED:
                del self._rows[key]
            else:
                self._rows[key] = replace(row, acknowledged_s=self._clock())

    def _raise(self, key: AlarmKey, cause: str, now_s: float, *, again: bool) -> None:
        row = self._rows.get(key)
        if row is None or again or row.cleared_s is not None:
            # an alarm that is raised again is not acknowledged
            self._rows[key] = AlarmRow(key, cause, now_s, count=1 if row is None else row.count + 1)
        elif row.cause != cause:
            self._rows[key] = replace(row, cause=cause)
