"""Which frames are missing: by a camera's own numbers, and how many were lost at which place."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter, sub
from typing import Final, Literal, Self

from acquisition.camera import CameraLost, CameraStatus

logger = logging.getLogger(__name__)

# A larger jump of a number means that the counter was reset, not that frames were lost.
_LARGEST_GAP: Final = 1 << 31
# The largest loss across the end of a counter.
_LARGEST_LOSS: Final = 1000
# So many frames in a row whose old numbers rise again: the camera counts again, none of them is late.
_RESTARTED_AFTER: Final = 3
Place = Literal["dropped_by_camera", "dropped_by_bus", "dropped_by_host"]


class BlockNumbers:
    """Numbers the whole frames of the camera `name` from 0, and counts the others.

    `counters` are the numbers of blocks after which a camera may begin again. With a clock a block that came
    too late is known by its time. `whole` counts the frames that were numbered, `lost_parts` those since the
    last of them of which a part arrived, `faulty` those of them that the camera called so.
    """

    def __init__(self, name: str, counters: Sequence[int], *, has_clock: bool = False) -> None:
        self._name, self._counters, self._has_clock = name, counters, has_clock
        self.whole = self.lost_parts = self.faulty = 0
        self._last_block: int | None = None
        self._last_time = 0
        self._last_number = -1
        self._lost = CameraStatus()
        self._stale: list[int] = []

    def status(self, delivered: int) -> CameraStatus:
        """The counts, beside that of the frames delivered."""
        since = CameraStatus(delivered, incomplete=self.lost_parts - self.faulty, error_status=self.faulty)
        return self._lost + since

    def number(self, block: int | None, lost: Place, time: int = 0) -> int | None:
        """Number of a whole frame; None for a block that came again or too late.

        `block` is None where the driver does not know it. `lost` is where those were lost that are missing
        before it. Raises CameraLost where the camera has reset itself.
        """
        # Number of frames since the last one delivered. Before the first one there is no block number to
        # compare with; damaged frames count nevertheless.
        after_parts = 1 + self.lost_parts
        step = after_parts
        if block is not None and self._last_block is not None:
            step = block - self._last_block
            if step <= 0 and (time <= self._last_time if self._has_clock else not step):
                # sent again, or overtaken by another one, which was when it counted as lost
                logger.warning("%s: block %d came again or too late", self._name, block)
                self._lost += CameraStatus(wrong_id=1)
                self._refuse_restart(block)
                return None
        self._stale.clear()
        if step < 0:
            step = next((step + n for n in self._counters if 0 < step + n <= _LARGEST_LOSS), step)
        if not 0 < step <= _LARGEST_GAP:
            logger.warning("%s: block number went from %s to %s", self._name, self._last_block, block)
            step = after_parts
        missing = step - 1
        in_part = min(self.lost_parts, missing)
        faulty = min(self.faulty, in_part)
        if missing:
            self._lost += CameraStatus(incomplete=in_part - faulty, error_status=faulty)
            self._lost += CameraStatus(**{lost: missing - in_part})
        self.lost_parts = self.faulty = 0
        self._last_block, self._last_time = block, time
        self._last_number += step
        self.whole += 1
        return self._last_number

    def _refuse_restart(self, block: int) -> None:
        """Raise CameraLost where old block numbers and times rise again: the camera has reset itself."""
        if self._stale and block <= self._stale[-1]:
            self._stale.clear()
        self._stale.append(block)
        if len(self._stale) >= _RESTARTED_AFTER:
            raise CameraLost(
                f"{self._name}: its block numbers and its clock have begun again, at {block} "
                f"after {self._last_block}: it has reset itself; see its supply and its cable"
            )


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
