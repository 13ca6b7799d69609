"""Events of a measurement, such as the start or the loss of frames, and the list of their kinds."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Final, NamedTuple, Self


class Severity(StrEnum):
    """Importance of an event, the gravest first."""

    TRIP = "trip"
    """The light was switched off, and stays off until a person acknowledges it."""
    ALARM = "alarm"
    """The run is worth nothing until the cause is removed."""
    WARNING = "warning"
    """Data are missing or disturbed."""
    INFORMATION = "information"


class EventKind(StrEnum):
    """Kinds of events, and how much they matter; a warning means missing or disturbed data."""

    level: Severity

    def __new__(cls, word: str, level: Severity = Severity.INFORMATION) -> Self:
        """The kind that is recorded as `word`."""
        kind = str.__new__(cls, word)
        kind._value_ = word
        kind.level = level
        return kind

    START = "start"
    """The first frame of the record."""
    STOP = "stop"
    """The last frame, with the reason of the end."""
    ENDED_EARLY = "stopped", Severity.WARNING
    """A person ended the run before its end, or the program had to end, with the reason; `STOP` follows."""
    FAILED = "failed", Severity.WARNING
    """An error ended the run before its end, with the reason; `STOP` follows."""
    REJECTED = "rejected"
    """The last frame of a run whose start was not accepted, with the reason."""
    GAP = "gap", Severity.WARNING
    """Frames are missing."""
    SPOT_LOST = "spot lost", Severity.WARNING
    SPOT_FOUND = "spot found"
    CAMERA_SILENT = "camera silent"
    """No frame for longer than usual; further ones may still arrive."""
    CAMERA_SPEAKS = "camera speaks"
    """The first frame after `CAMERA_SILENT`."""
    CAMERA_LOST = "camera lost", Severity.WARNING
    """The camera was unplugged or reset."""
    CAMERA_BACK = "camera back"
    CAMERA_STOP = "camera stop"
    """The camera could not be stopped at the end; what it delivered before is whole."""
    RECORD = "record", Severity.WARNING
    """The record can no longer be written."""
    SLOW_DISK = "slow disk", Severity.WARNING
    """A write took seconds; frames waited in memory, and those that could not are counted as lost."""
    BACKLOG = "backlog", Severity.WARNING
    """Many frames wait in memory to be processed, or no longer do."""
    REST = "rest"
    WARM_UP = "warm-up"
    PREFLIGHT = "preflight"
    RELEASE = "release"
    """`REST` to `RELEASE`: phases, begun or stopped."""
    MAGNET = "magnet"
    STARTER = "starter"
    BRAKE = "brake"
    CONTROLLER = "controller"
    LASER = "laser"
    SENSOR = "sensor"
    """`MAGNET` to `SENSOR`: messages of that device."""
    TRIP = "trip", Severity.TRIP
    """The light was switched off by a trip, which stays until a person acknowledges it."""
    LASER_DARK = "laser dark", Severity.ALARM
    """The laser went dark during the run, with the reason."""
    LASER_UNKNOWN = "laser unknown", Severity.ALARM
    """Nothing confirms any more, during the run, whether the laser is lit; with what is known."""
    LASER_LIT = "laser lit"
    """The laser is lit, after `LASER_DARK` or `LASER_UNKNOWN`."""
    BEAM = "beam"
    """The model of the beam was chosen, or is chosen again."""
    REST_STEP = "rest step", Severity.WARNING
    """The rest position has jumped, to a new constant place."""
    LIGHT_STEP = "light step", Severity.WARNING
    """The background has jumped: a lamp was switched."""
    PUSH = "push", Severity.WARNING
    """The pendulum was pushed within a half-cycle: a draught, a knock."""
    LIVE_FIT = "posterior"
    """Parameters are no longer fitted while the run is measured."""
    CAMERA_CLOCK = "camera clock", Severity.WARNING
    """The clock stepped or frame times were wrong; with what was done."""
    WATCHER_FAILED = "watcher failed"
    """A part that only watches the run (display, view, live fit, balance) has failed; the record is whole."""
    ADVICE = "advice"
    """Which weight to turn, by the last balance before this event; Markdown, for displays."""
    NOTE = "note"
    """A note of an operator, for displays; in the record it is a message of `/note`."""
    CLOCK_STEP = "clock step", Severity.WARNING
    """The computer's date or time was set; the record keeps its first offset to UTC."""


_LEVELS: Final = {str(kind): kind.level for kind in EventKind}


class Event(NamedTuple):
    """One event; `time_ns` is on the frames' clock."""

    time_ns: int
    kind: str
    text: str

    @property
    def level(self) -> Severity:
        """Severity, which the kind decides; events of unknown kinds are information."""
        return _LEVELS.get(self.kind, Severity.INFORMATION)

    @property
    def line(self) -> str:
        """The event as one line, `kind: text`."""
        return f"{self.kind}: {self.text}"


_ENDS: Final = (EventKind.STOP, EventKind.REJECTED)
EARLY_ENDS: Final = (EventKind.ENDED_EARLY, EventKind.FAILED)
"""Kinds of early ends of runs."""


def end_of(events: Sequence[Event]) -> Event | None:
    """The end event of a run, of kind STOP (regular), REJECTED, ENDED_EARLY or FAILED; None if missing."""
    index = max((i for i, event in enumerate(events) if event.kind in _ENDS), default=None)
    if index is None:
        return None
    end, previous = events[index], events[index - 1] if index else None
    return end if previous is None or previous.kind not in EARLY_ENDS else end._replace(kind=previous.kind)
