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
    REJECTED = "start rejected"
    FORECAST = "forecast"
    LIVE_FIT = "live fit"
    WATCHER = "watcher"
    CONFIGURATION = "configuration"
    DESK_LOST = "desk lost"
    NETWORK = "network"


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
        "turn the key switch; then see its driver and cable",
        _DANGER,
    ),
    AlarmKey.TRIP: Alarm(
        "light taken away",
        "the interlock opened, a watchdog ran out, or somebody pressed LIGHT OFF",
        "look that nobody is in the beam's way, then Acknowledge trip",
        _DANGER,
        by_leave=True,
    ),
    AlarmKey.INTERLOCK: Alarm(
        "interlock open",
        "a door, a cover or the connector of the loop is open",
        "close it, then Acknowledge trip and Light again: until then the laser stays dark",
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
        "nothing was heard of it for more than 2 s",
        "see the cable and power of laser and controller; take the laser for lit until then",
        _URGENT,
    ),
    AlarmKey.CONTROLLER: Alarm(
        "controller does not answer",
        "its cable or its power",
        "plug it in again; it is looked for by itself",
        _URGENT,
        after_s=1.5,
    ),
    AlarmKey.CAMERA: Alarm(
        "no frames from the camera",
        "unplugged, without power, or without its trigger",
        "see cable, power and trigger: for a minute it is opened again by itself, and the run goes on",
        _URGENT,
    ),
    AlarmKey.SPOT: Alarm(
        "spot lost",
        "the beam is blocked or misses the sensor, or the pendulum swings too far",
        "look at the picture: clear the beam's way, or align again",
        _URGENT,
    ),
    AlarmKey.DISK_FULL: Alarm(
        "disk full",
        "less is free than a run needs to be closed",
        "free some space on the disk of session.output, or state another folder there",
        _URGENT,
    ),
    AlarmKey.DISK_HANGS: Alarm(
        "disk does not answer",
        "a network drive that is gone, or a disk that fails",
        "see the drive; frames wait in memory for about half a minute",
        _URGENT,
    ),
    AlarmKey.DISK_FORECAST: Alarm(
        "disk will be full before the end",
        "the record grows faster than there is room for",
        "free some space now; the record is closed whole if it does fill up",
        _URGENT,
        after_s=1.0,
    ),
    AlarmKey.OUTPUT: Alarm(
        "folder of the sessions cannot be written",
        "its drive is gone, or its permissions have changed",
        "bring session.output back, or state another folder; nothing can be measured until then",
        _URGENT,
    ),
    AlarmKey.SESSION_DIED: Alarm(
        "session died",
        "its process was killed, or has crashed",
        "see that the laser is dark; then Resume makes the missing runs: what was recorded is kept",
        _URGENT,
        latched=True,
    ),
    AlarmKey.SESSION_FROZEN: Alarm(
        "session does not answer",
        "its process is stopped, or waits for a disk or a device",
        "wait half a minute; LIGHT OFF works also now. If it stays silent end its process: "
        "the record can be recovered",
        _URGENT,
    ),
    AlarmKey.SESSION_FAILED: Alarm(
        "session failed",
        "an error has ended it before its end",
        "remove the cause that it names, then start again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.STALLED: Alarm(
        "run in trouble",
        "a part of the run does not go on, so that the laser is switched off",
        "see load and disk of the computer; the record is whole up to here",
        _URGENT,
    ),
    AlarmKey.PREFLIGHT: Alarm(
        "preflight says no-go",
        "a check before the run has failed",
        "see its remedy under Preflight; then start again, or overrule it for this session",
        _URGENT,
    ),
    AlarmKey.PICTURE: Alarm(
        "live picture has ended",
        "the camera was unplugged, or another program has it",
        "see its cable, end other programs, then press Live picture again",
        _URGENT,
        latched=True,
    ),
    AlarmKey.COMMAND: Alarm(
        "command failed",
        "it has ended with an error",
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
        "frames wait in memory for it",
        "close other programs; none is lost as long as memory lasts",
        latched=True,
    ),
    AlarmKey.CAMERA_CLOCK: Alarm(
        "clock of the camera",
        "it has stepped, or frames had wrong times",
        "the step is taken off and recorded; see cable and firmware if it comes again",
        latched=True,
    ),
    AlarmKey.HOST_CLOCK: Alarm(
        "clock of the computer was set",
        "a time server, or a person, has set it",
        "nothing during a run, whose times keep those of its beginning; have it set slowly (chrony)",
        latched=True,
    ),
    AlarmKey.ENVIRONMENT: Alarm(
        "environment not measured",
        "the sensor does not answer",
        "see its cable and port; without it the run has no temperature, humidity and pressure",
        after_s=1.0,
    ),
    AlarmKey.SENSOR: Alarm(
        "message of a sensor",
        "environment sensor or witness of the ground",
        "see its cable and settings",
        latched=True,
    ),
    AlarmKey.REST_STEP: Alarm(
        "rest position has moved",
        "the foundation, the mirror or the ball was touched",
        "look what was touched; if it comes again the run is better repeated",
        latched=True,
    ),
    AlarmKey.LIGHT_STEP: Alarm(
        "background light has changed",
        "a lamp was switched, a door opened",
        "keep the room dark until the end of the run",
        latched=True,
    ),
    AlarmKey.PUSH: Alarm(
        "swing was pushed",
        "a draught, or a knock",
        "close doors, keep away; the fit leaves this half-cycle out",
        latched=True,
    ),
    AlarmKey.REJECTED: Alarm(
        "start not accepted",
        "amplitude or transverse motion were not as wanted",
        "it is tried again; correct the release if the next one is rejected, too",
        latched=True,
    ),
    AlarmKey.FORECAST: Alarm(
        "time ends the run before its amplitude",
        "session.max_duration_s is shorter than this decay",
        "nothing, if that is meant; otherwise a longer max_duration_s for the next run",
        after_s=5.0,
    ),
    AlarmKey.LIVE_FIT: Alarm(
        "parameters are no longer fitted live",
        "the live fit has failed or is too slow",
        "nothing: the record is fitted at its end; session.stop_when does not act in this run",
        latched=True,
    ),
    AlarmKey.WATCHER: Alarm(
        "a display has failed",
        "what only watches the run has failed",
        "nothing: the record is whole; close the view and open it again after the run",
        latched=True,
    ),
    AlarmKey.CONFIGURATION: Alarm(
        "configuration cannot be read",
        "its file was changed, moved or removed while the desk runs",
        "correct the file; nothing can be started until then",
    ),
    AlarmKey.DESK_LOST: Alarm(
        "the desk says nothing",
        "its process has ended or hangs, or the connection is gone",
        "start rig desk again: this page finds it by itself; a session goes on; "
        "if the laser must be dark now, turn the key switch",
        _URGENT,
    ),
    AlarmKey.NETWORK: Alarm(
        "no network",
        "this device has lost its connection",
        "see Wi-Fi or cable; what was typed is kept; if the laser must be dark now, turn the key switch",
        _URGENT,
    ),
}
OF_PAGE: Final = (AlarmKey.DESK_LOST, AlarmKey.NETWORK)
"""What only the page itself can see, without the desk."""
