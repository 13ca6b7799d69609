"""Events of a measurement, such as the start or the loss of frames, and the list of their kinds."""

from enum import StrEnum
from typing import Final, NamedTuple


class EventKind(StrEnum):
    """Kinds of events. Besides, each phase of the preparation is a kind with the phase's name."""

    START = "start"
    """The first frame of the record."""
    STOP = "stop"
    """The last frame, with the reason of the end."""
    GAP = "gap"
    """Frames are missing."""
    SPOT_LOST = "spot lost"
    SPOT_FOUND = "spot found"
    CAMERA_SILENT = "camera silent"
    """No frame for longer than usual; further ones may still arrive."""
    CAMERA_SPEAKS = "camera speaks"
    """The first frame after `CAMERA_SILENT`."""
    CAMERA_LOST = "camera lost"
    """Unplugged or reset."""
    CAMERA_BACK = "camera back"
    RECORD = "record"
    """The record can no longer be written."""
    PREFLIGHT = "preflight"
    MAGNET = "magnet"
    STARTER = "starter"
    BRAKE = "brake"
    CONTROLLER = "controller"
    LASER = "laser"
    SENSOR = "sensor"
    """Messages of the device."""


WARNING_KINDS: Final = frozenset(
    {EventKind.GAP, EventKind.SPOT_LOST, EventKind.CAMERA_LOST, EventKind.RECORD}
)
"""Kinds that mean missing data: warnings in the record's log and in every view."""


class Event(NamedTuple):
    """One event; `time_ns` is on the frames' clock."""

    time_ns: int
    kind: str
    text: str

    @property
    def is_warning(self) -> bool:
        """Whether data are missing."""
        return self.kind in WARNING_KINDS

    @property
    def line(self) -> str:
        """The event as one line, `kind: text`."""
        return f"{self.kind}: {self.text}"
