"""Frames that wait in memory between the camera's thread and the one that processes them."""

from acquisition.frame import Frame
from acquisition.frame_queue import Policy

MOST_BYTES = 256 * 1024 * 1024
"""What waits for a processor that is late: 1.7 s of 500 frames/s of 640 x 480."""
_OWN_BYTES = 1024
"""What a frame takes beside its pixels, about."""
_FEWEST = 8
_FEWEST_ON_DEMAND = 64
_LATE = 0.125
"""Part of the memory from which on it is said."""


def most_waiting(frame: Frame, policy: Policy) -> int:
    """Number of frames for a bounded amount of memory, a few at least.

    Frames on demand are not lost while the queue is full; a short one keeps them in the processor's cache.
    """
    most = max(_FEWEST, MOST_BYTES // (frame.image.nbytes + _OWN_BYTES))
    return min(_FEWEST_ON_DEMAND, most) if policy == "wait" else most


class Backlog:
    """Notices when many frames wait, and when they no longer do.

    Parameters
    ----------
    capacity
        Number of frames for which there is memory.
    frame_bytes
        Size of one of them.
    """

    def __init__(self, capacity: int, frame_bytes: int) -> None:
        self._capacity = capacity
        self._frame_mb = frame_bytes / 1e6
        self._most = 0

    def see(self, waiting: int) -> str:
        """What is to be said of so many waiting frames; nothing as long as they are few, or still many."""
        if waiting > max(_LATE * self._capacity, self._most):
            begins, self._most = not self._most, waiting
            if begins:
                memory_mb = self._capacity * self._frame_mb
                return (
                    f"{waiting} frames wait for the processor, {waiting * self._frame_mb:.0f} of "
                    f"{memory_mb:.0f} MB; once full, frames are lost and counted: close other programs, or "
                    "set a lower camera.frame_rate_hz or a smaller region"
                )
        elif self._most and waiting <= 0.1 * _LATE * self._capacity:
            most, self._most = self._most, 0
            return f"caught up; at most {most} frames waited, {most * self._frame_mb:.0f} MB"
        return ""
