"""Numbers of lost frames by the place of the loss."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from operator import attrgetter, sub
from typing import Self

from acquisition.camera import CameraStatus


@dataclass(frozen=True, slots=True)
class FrameLosses:
    """Numbers of lost frames by the place of the loss.

    Attributes
    ----------
    by_camera
        The camera numbered them and did not send them.
    by_bus
        They went missing between camera and driver.
    by_host
        This program took them too late, in the driver or after it.
    incomplete
        They arrived damaged and were discarded.
    while_unplugged
        They would have come while the camera was gone, estimated from the elapsed time.
    wrong_time
        Their times fitted neither the camera's rate nor the computer's clock.
    error_status
        The camera or its driver marked them as faulty.
    wrong_id
        They came again or too late, with an earlier number; none is missing because of them.
    """

    by_camera: int = 0
    by_bus: int = 0
    by_host: int = 0
    incomplete: int = 0
    while_unplugged: int = 0
    wrong_time: int = 0
    error_status: int = 0
    wrong_id: int = 0

    @classmethod
    def of(
        cls, status: CameraStatus, *, unqueued: int = 0, while_unplugged: int = 0, wrong_time: int = 0
    ) -> Self:
        """From a driver's counts, what our own queue refused, what the time of a gap tells, wrong times."""
        return cls(
            status.dropped_by_camera,
            status.dropped_by_bus,
            status.dropped_by_host + unqueued,
            status.incomplete,
            while_unplugged,
            wrong_time,
            status.error_status,
            status.wrong_id,
        )

    @property
    def total(self) -> int:
        """Frames that are missing."""
        return sum(_counts(self)) - self.wrong_id

    @property
    def came(self) -> int:
        """Frames that came, in part at least, and were not used."""
        return self.incomplete + self.wrong_time + self.error_status + self.wrong_id

    @property
    def came_text(self) -> str:
        """The same in words, by their reasons."""
        return str(
            FrameLosses(0, 0, 0, self.incomplete, 0, self.wrong_time, self.error_status, self.wrong_id)
        )

    def since(self, before: "FrameLosses") -> "FrameLosses":
        """What was lost after `before`."""
        return FrameLosses(*map(sub, _counts(self), _counts(before)))

    def __str__(self) -> str:
        words = (
            *("by the camera", "by the bus", "by this computer", "incomplete", "while unplugged"),
            *("without a right time", "with an error status", "with a number that was before"),
        )
        named = [f"{count} {word}" for count, word in zip(_counts(self), words, strict=True) if count]
        return ", ".join(named) or "none"


_counts: Callable[[FrameLosses], tuple[int, ...]] = attrgetter(*(field.name for field in fields(FrameLosses)))
"""All counts; they are taken with every block of frames, for which `astuple` copies too deeply."""
