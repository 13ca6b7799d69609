"""Every alarm of the desk: what it is called, what its usual cause is, what to do."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final


class Grade(StrEnum):
    """How much an alarm matters; the order is that of the list."""

    DANGER = "danger"
    """Light may be where none should be; cannot be shelved."""
    URGENT = "urgent"
    """What is measured is being lost."""
    CAUTION = "caution"
    """Seen in the list and not heard: data that will have to be looked at."""


class AlarmKey(StrEnum):
    """The alarms."""

    LIGHT_DISAGREES = "light disagrees"
    TRIP = "trip"
    INTERLOCK = "interlock"
    LASER_DARK = "laser dark"
    LASER_UNKNOWN = "laser unknown"
    CONTROLLER = "controller"
    CAMERA = "camera"
    SPOT = "spot lost"
    DISK_FULL = "disk full"
    DISK_HANGS = "disk hangs"
    DISK_FORECAST = "disk forecast"
    OUTPUT = "output"
    SESSION_DIED = "session died"
    SESSION_FROZEN = "session frozen"
    SESSION_FAILED = "session failed"
    STALLED = "run stalled"
    PREFLIGHT = "preflight"
    PICTURE = "live picture"
    COMMAND = "command"
    FRAMES = "frames lost"
    BACKLOG = "backlog"
    CAMERA_CLOCK = "camera clock"
    HOST_CLOCK = "computer clock"
    ENVIRONMENT = "environment"
    SENSOR = "sensor"
    REST_STEP = "rest step"
    LIGHT_STEP = "light step"
    PUSH = "push"
    BALANCE = "balance"
    REJECTED = "start rejected"
    FORECAST = "forecast"
    LIVE_FIT = "live fit"
    WATCHER = "watcher"
    CONFIGURATION = "configuration"
    DESK_LOST = "desk lost"


@dataclass(frozen=True, slots=True)
class Alarm:
    """What is known of an alarm before it is raised.

    `cause` is the usual one, used where nothing tells the real one. `latched`: it has happened, and stays
    active until somebody acknowledges it. `after_s`: for so long its condition holds before it is raised.
    `by_leave`: its acknowledgement is that of the light, after looking, and is given nowhere else.
    """

    title: str
    cause: str
    remedy: str
    grade: Grade = Grade.CAUTION
    latched: bool = False
    after_s: float = 0.0
    by_leave: bool = False


_DANGER, _URGENT = Grade.DANGER, Grade.URGENT

CATALOGUE: Final[Mapping[AlarmKey, Alarm]] = {
    AlarmKey.LIGHT_DISAGREES: Alarm(
        "light although it is commanded off",
        "the laser's output, or its light in the picture, is seen to be on",
        "turn the key switch; then check its driver and cable",
        _DANGER,
    ),
    AlarmKey.TRIP: Alarm(
        "light taken away",
        "the interlock opened, a watchdog ran out, or somebody pressed LIGHT OFF",
        "check that nobody is in the beam path, then Acknowledge trip",
        _DANGER,
        by_leave=True,
    ),
    AlarmKey.INTERLOCK: Alarm(
        "interlock open",
        "a door, a cover or the connector of the loop is open",
        "close it, then press Acknowledge trip and Light again; the laser stays dark until then",
        _DANGER,
    ),
    AlarmKey.LASER_DARK: Alarm(
        "laser dark",
        "its light was taken away during a run",
        "remove the cause, acknowledge the trip, then Light again",
        _URGENT,
    ),
    AlarmKey.LASER_UNKNOWN: Alarm(
        "state of the laser unknown",
        "it has not reported for more than 2 s",
        "check cable and power of laser and controller; assume until then that the laser is lit",
        _URGENT,
    ),
    AlarmKey.CONTROLLER: Alarm(
        "controller does not answer",
        "its cable or its power",
        "plug it in again; it is found automatically",
        _URGENT,
        after_s=1.5,
    ),
    AlarmKey.CAMERA: Alarm(
        "no frames from the camera",
        "unplugged, without power, or without its trigger",
        "check cable, power and trigger at once: it is reopened automatically, but the laser goes dark after "
        "some seconds without frames, and that may end the run",
        _URGENT,
    ),
    AlarmKey.SPOT: Alarm(
        "spot lost",
        "the beam is blocked or misses the sensor, or the swing is too large",
        "look at the picture; clear the beam path, or align again",
        _URGENT,
    ),
    AlarmKey.DISK_FULL: Alarm(
        "disk full",
        "less space is free than closing a run needs",
        "free some space on the disk of session.output, or name another folder there",
        _URGENT,
    ),
    AlarmKey.DISK_HANGS: Alarm(
        "disk does not answer",
        "a network drive has gone, or a disk is failing",
        "check the drive; frames wait in memory for about half a minute",
        _URGENT,
    ),
    AlarmKey.DISK_FORECAST: Alarm(
        "disk will be full before the end",
        "the record will outgrow the free space",
        "free some space now; if the disk does fill up, the record is closed complete",
        _URGENT,
        after_s=1.0,
    ),
    AlarmKey.OUTPUT: Alarm(
        "folder of the sessions cannot be written",
        "its drive is gone, or its permissions have changed",
        "restore session.output, or name another folder; nothing can be measured until then",
        _URGENT,
    ),
    AlarmKey.SESSION_DIED: Alarm(
        "session died",
        "its process was killed or crashed",
        "check that the laser is dark; then press Resume to make the missing runs. Recorded data are kept",
        _URGENT,
        latched=True,
    ),
    AlarmKey.SESSION_FROZEN: Alarm(
        "session does not answer",
        "its process is stopped, or is waiting for a disk or a device",
        "wait half a minute; LIGHT OFF still works. If it stays silent, press Stop: it ends the process, "
        "and the record is kept",
        _URGENT,
    ),
    AlarmKey.SESSION_FAILED: Alarm(
        "session failed",
        "an error ended it early",
        "remove the cause that the error names, then start again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.STALLED: Alarm(
        "run in trouble",
        "a part of the run has stalled; a laser that the program switches is told off",
        "check the computer's load and disk; the record is complete up to here",
        _URGENT,
    ),
    AlarmKey.PREFLIGHT: Alarm(
        "preflight says no-go",
        "a check before the run has failed",
        "see its remedy under Rig; then start again, or overrule it for this session",
        _URGENT,
    ),
    AlarmKey.PICTURE: Alarm(
        "live picture has ended",
        "the camera was unplugged, or another program has it",
        "check its cable, close other programs, then press Live picture again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.COMMAND: Alarm(
        "command failed",
        "it ended with an error",
        "read its last line, remove the cause, start it again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.FRAMES: Alarm(
        "frames lost",
        "the camera, its bus or this computer could not keep up",
        "close other programs, use another port or cable, or lower the frame rate",
        latched=True,
    ),
    AlarmKey.BACKLOG: Alarm(
        "processor late",
        "frames are waiting in memory for it",
        "close other programs; no frame is lost while there is memory",
        latched=True,
    ),
    AlarmKey.CAMERA_CLOCK: Alarm(
        "clock of the camera",
        "it stepped, or frames had wrong times",
        "the step is subtracted and recorded; if it happens again, check cable and firmware",
        latched=True,
    ),
    AlarmKey.HOST_CLOCK: Alarm(
        "clock of the computer was set",
        "a time server or a person set it",
        "nothing: times in the run keep their initial offset; let chrony adjust the clock slowly",
        latched=True,
    ),
    AlarmKey.ENVIRONMENT: Alarm(
        "environment not measured",
        "the sensor does not answer",
        "check its cable and port; without it the run has no temperature, humidity or pressure",
        after_s=1.0,
    ),
    AlarmKey.SENSOR: Alarm(
        "message of a sensor",
        "environment sensor or witness of the ground",
        "check its cable and settings",
        latched=True,
    ),
    AlarmKey.REST_STEP: Alarm(
        "rest position has moved",
        "the foundation, the mirror or the ball was touched",
        "find out what was touched; if it happens again, repeat the run",
        latched=True,
    ),
    AlarmKey.LIGHT_STEP: Alarm(
        "background light has changed",
        "a lamp was switched or a door opened",
        "keep the room dark until the end of the run",
        latched=True,
    ),
    AlarmKey.PUSH: Alarm(
        "swing was pushed",
        "a draught, or a knock",
        "close doors, keep away; the fit leaves this half-cycle out",
        latched=True,
    ),
    AlarmKey.BALANCE: Alarm(
        "out of balance",
        "the pendulum turns, was pushed sideways at the start, or its weights are not set",
        "the run is recorded; before the next one balance the pendulum and let it settle (rig balance)",
        after_s=5.0,
    ),
    AlarmKey.REJECTED: Alarm(
        "start not accepted",
        "amplitude, transverse motion or rotation was out of range",
        "the start is repeated; if the next one is rejected too, correct the release",
        latched=True,
    ),
    AlarmKey.FORECAST: Alarm(
        "time ends the run before its amplitude",
        "session.max_duration_s is shorter than this decay",
        "nothing, if this is intended; otherwise set a longer max_duration_s for the next run",
        after_s=5.0,
    ),
    AlarmKey.LIVE_FIT: Alarm(
        "parameters are no longer fitted live",
        "the live fit has failed or is too slow",
        "nothing: the record is fitted at the end; session.stop_when has no effect in this run",
        latched=True,
    ),
    AlarmKey.WATCHER: Alarm(
        "a display has failed",
        "a part that only displays the run has failed",
        "nothing: the record is complete; close the view and open it again after the run",
        latched=True,
    ),
    AlarmKey.CONFIGURATION: Alarm(
        "configuration cannot be read",
        "its file was changed, moved or removed while the desk was running",
        "correct the file; nothing can be started until then",
    ),
    AlarmKey.DESK_LOST: Alarm(
        "the desk does not answer",
        "its process has ended or hangs, or the connection is gone",
        "start rig desk again: this page reconnects automatically; a running session continues; "
        "to darken the laser now, turn the key switch",
        _URGENT,
    ),
}
