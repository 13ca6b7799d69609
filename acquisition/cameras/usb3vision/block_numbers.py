"""What the camera's block numbers say: the number of each frame, and which are missing, by cause."""

import logging
from typing import Final

from acquisition.camera import CameraLost, CameraStatus
from acquisition.cameras.usb3vision.packets import Leader

logger = logging.getLogger(__name__)

# A larger jump of the block number means that the counter was reset, not that frames were lost.
_LARGEST_GAP: Final = 1 << 31
# Sizes of block counters that are shorter than the standard's 64 bits, and the largest loss across their end.
_COUNTERS: Final = (1 << 16, 1 << 32)
_LARGEST_LOSS: Final = 1000
# So many frames in a row whose old numbers rise again: the camera counts again, none of them is late.
_RESTARTED_AFTER: Final = 3


class BlockNumbers:
    """Numbers the whole frames of the camera `name`, and counts the others.

    `lost_parts` counts the frames since the last whole one of which a part arrived, `faulty` those of them
    that the camera called so, `disturbed` is set after an error of the bus.
    """

    def __init__(self, name: str, *, has_clock: bool) -> None:
        self._name, self._has_clock = name, has_clock
        self.lost_parts = self.faulty = 0
        self.disturbed = False
        self._last_block: int | None = None
        self._last_timestamp = 0
        self._last_sequence = -1
        self._by_camera = self._by_bus = self._incomplete = 0
        self._error_status = self._wrong_id = 0
        self._stale: list[Leader] = []

    def status(self, delivered: int) -> CameraStatus:
        """The counts, beside that of the frames delivered."""
        return CameraStatus(
            delivered=delivered,
            dropped_by_camera=self._by_camera,
            dropped_by_bus=self._by_bus,
            incomplete=self._incomplete + self.lost_parts - self.faulty,
            error_status=self._error_status + self.faulty,
            wrong_id=self._wrong_id,
        )

    def number(self, leader: Leader) -> int | None:
        """Number of the whole frame with this leader; None for a block that came again or too late.

        Raises CameraLost where the camera has reset itself.
        """
        # Number of frames since the last one delivered. Before the first one there is no block number to
        # compare with; damaged frames count nevertheless.
        step = 1 + self.lost_parts if self._last_block is None else leader.block - self._last_block
        if step <= 0 and self._is_stale(leader):
            # sent again, or overtaken by another one, which was when it counted as lost
            logger.warning("%s: block %d came again or too late", self._name, leader.block)
            self._wrong_id += 1
            self._refuse_restart(leader)
            return None
        self._stale.clear()
        if step < 0:
            step = next((step + n for n in _COUNTERS if 0 < step + n <= _LARGEST_LOSS), step)
        if not 0 < step <= _LARGEST_GAP:
            logger.warning("%s: block number went from %s to %d", self._name, self._last_block, leader.block)
            step = 1 + self.lost_parts
        missing = step - 1
        incomplete = min(self.lost_parts, missing)
        faulty = min(self.faulty, incomplete)
        self._incomplete += incomplete - faulty
        self._error_status += faulty
        if self.disturbed:
            self._by_bus += missing - incomplete
        else:
            self._by_camera += missing - incomplete
        self.lost_parts, self.faulty, self.disturbed = 0, 0, False
        self._last_block, self._last_timestamp = leader.block, leader.timestamp
        self._last_sequence += step
        return self._last_sequence

    def _refuse_restart(self, leader: Leader) -> None:
        """Raise CameraLost where old block numbers and times rise again: the camera has reset itself."""
        before = self._stale[-1:]
        if before and leader.block <= before[0].block:
            self._stale.clear()
        self._stale.append(leader)
        if len(self._stale) >= _RESTARTED_AFTER:
            raise CameraLost(
                f"{self._name}: its block numbers and its clock have begun again, at {leader.block} "
                f"after {self._last_block}: it has reset itself; see its supply and its cable"
            )

    def _is_stale(self, leader: Leader) -> bool:
        """Whether a frame whose block number does not rise is an old one, by its time if it has one."""
        if self._has_clock:
            return leader.timestamp <= self._last_timestamp
        return leader.block == self._last_block
