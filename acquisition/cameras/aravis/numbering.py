"""Continuous frame numbers from the frame ids of GigE Vision and USB3 Vision, and counts of lost frames."""

from collections import deque
from typing import Final

from acquisition.camera import CameraStatus

# 16-bit ids are followed by 1 after 65535; zero is not used (GigE Vision 1.x).
_SHORT_IDS: Final = 65535
# A larger jump means that the camera restarted its counter, not that frames were lost.
_LARGEST_GAP: Final = _SHORT_IDS // 2


class FrameNumbering:
    """Numbers frames from 0 and counts missing ones by the place of the loss.

    Damaged frames count as incomplete. Other missing frames count as lost by the host if libaravis reported a
    lack of free buffers in the time in question, otherwise as lost on the bus. Cameras do not report frames
    that they lost themselves.
    """

    def __init__(self, short_ids: bool) -> None:
        self._short_ids = short_ids
        self._last_id: int | None = None
        self._last_number = -1
        self._damaged = 0
        self._last_arrived_ns = -1
        # (time of fetching a frame, libaravis's count of buffer underruns at that time)
        self._underruns = deque([(-1, 0)])
        self._delivered = self._by_bus = self._by_host = self._incomplete = 0

    def damaged(self) -> None:
        """Count a damaged frame."""
        self._damaged += 1

    def number(self, frame_id: int, arrived_ns: int, fetched_ns: int, underruns: int) -> int | None:
        """Number of a complete frame; None if it was delivered before.

        Parameters
        ----------
        frame_id
            The camera's frame id.
        arrived_ns, fetched_ns
            Times of arrival and of fetching, on the same clock.
        underruns
            libaravis's count of events without a free buffer up to the fetching; it may count packets.
        """
        samples = self._underruns
        while len(samples) > 1 and samples[1][0] <= self._last_arrived_ns:
            samples.popleft()
        was_full = underruns > samples[0][1]
        samples.append((fetched_ns, underruns))
        step = self._step(frame_id)
        if step is None:
            return None
        missing = step - 1
        incomplete = min(self._damaged, missing)
        self._incomplete += incomplete
        unseen = missing - incomplete
        if was_full:
            self._by_host += unseen
        else:
            self._by_bus += unseen
        self._damaged, self._last_id, self._last_arrived_ns = 0, frame_id, arrived_ns
        self._last_number += step
        self._delivered += 1
        return self._last_number

    def _step(self, frame_id: int) -> int | None:
        after_damaged = 1 + self._damaged
        if self._last_id is None:
            return after_damaged  # damaged frames before the first complete one count as missing
        step = frame_id - self._last_id
        if step == 0:
            return None
        if self._short_ids and max(frame_id, self._last_id) <= _SHORT_IDS:
            step %= _SHORT_IDS
        return step if 0 < step <= _LARGEST_GAP else after_damaged

    @property
    def status(self) -> CameraStatus:
        """Counts so far."""
        return CameraStatus(
            delivered=self._delivered,
            dropped_by_bus=self._by_bus,
            dropped_by_host=self._by_host,
            incomplete=self._incomplete + self._damaged,
        )
