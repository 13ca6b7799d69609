"""Every alarm of the desk: what it is called, what its usual cause is, what to do."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final


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
        "check that the laser is dark; then press Resume to make the missing runs. Recorded data are kept",
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
