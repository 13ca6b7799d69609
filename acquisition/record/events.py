"""What happens to a measurement beside its frames: the value, and the one list of its kinds."""

from enum import StrEnum
from typing import Final, NamedTuple


class EventKind(StrEnum):
    """Kinds of events. A phase of the preparation is a kind of its own, called by the phase's name."""

    START = "start"
    """The first frame of the record."""
    STOP = "stop"
    """The last, and why."""
    GAP = "gap"
    """Frames are missing."""
    SPOT_LOST = "spot lost"
    SPOT_FOUND = "spot found"
    CAMERA_SILENT = "camera silent"
    """No frame for longer than is usual; it may still come."""
    CAMERA_SPEAKS = "camera speaks"
    """A frame after a silence."""
    CAMERA_LOST = "camera lost"
    """Unplugged or reset."""
    CAMERA_BACK = "camera back"
    RECORD = "record"
    """The record cannot be written any more."""
    PREFLIGHT = "preflight"
    MAGNET = "magnet"
    STARTER = "starter"
    BRAKE = "brake"
    CONTROLLER = "controller"
    LASER = "laser"
    SENSOR = "sensor"
    """What the device itself says."""


WARNING_KINDS: Final = frozenset(
    {EventKind.GAP, EventKind.SPOT_LOST, EventKind.CAMERA_LOST, EventKind.RECORD}
)
"""Something of the measurement is missing: a warning in the record's log and in every view."""


class Event(NamedTuple):
    """Something that happened to the measurement, as the record holds it."""

    time_ns: int
    kind: str
    text: str

    @property
    def is_warning(self) -> bool:
        """Whether something of the measurement is missing."""
        return self.kind in WARNING_KINDS

    @property
    def line(self) -> str:
        """`kind: text`, as logs and screens show it."""
        return f"{self.kind}: {self.text}"
