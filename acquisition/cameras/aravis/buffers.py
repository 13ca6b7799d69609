"""Conversion of libaravis's buffers into frames: checks, counts, and numbers that go on beyond 16 bits."""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from acquisition.camera import CameraStatus, ColourPlane
from acquisition.cameras.colour_plane import plane_of
from acquisition.cameras.pixel_formats import Format
from acquisition.frame import Frame
from processing.errors import DeviceError

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
        self._counts = CameraStatus()

    def damaged(self) -> None:
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
        unseen = missing - incomplete
        self._counts += CameraStatus(
            delivered=1,
            dropped_by_bus=0 if was_full else unseen,
            dropped_by_host=unseen if was_full else 0,
            incomplete=incomplete,
        )
        self._damaged, self._last_id, self._last_arrived_ns = 0, frame_id, arrived_ns
        self._last_number += step
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
        return self._counts + CameraStatus(incomplete=self._damaged)


@dataclass(slots=True)
class BufferReader:
    """Converts the buffers of one acquisition into frames.

    `aravis` is the library's module; `has_clock` is True if timestamps come from the camera's own clock,
    `plane` is the colour to deliver.
    """

    aravis: Any
    name: str
    pixel_format: Format
    width_px: int
    height_px: int
    has_clock: bool
    numbering: FrameNumbering
    plane: ColourPlane | None = None
    _host_time_ns: int = field(default=0, init=False)

    def frame(self, buffer: Any, underruns: int) -> Frame | None:
        """The frame in a buffer; None if it is damaged or was delivered before.

        Raises DeviceError if the payload is not an image, or has padding that cannot be removed.
        """
        if buffer.get_status() != self.aravis.BufferStatus.SUCCESS:
            self.numbering.damaged()
            return None
        kinds = self.aravis.BufferPayloadType
        if buffer.get_payload_type() not in (kinds.IMAGE, kinds.EXTENDED_CHUNK_DATA):
            sent = buffer.get_payload_type().value_nick
            raise DeviceError(
                f"{self.name}: sends payload of type {sent}, not images; switch that off in the camera"
            )
        x_padding, _ = buffer.get_image_padding()
        if x_padding and not self.pixel_format.rows_end_with_bytes(self.width_px):
            raise DeviceError(
                f"{self.name}: pads rows of {self.width_px} px in {self.pixel_format.name}; set a width that "
                "is a multiple of 4, or another pixel format"
            )
        data = buffer.get_data()
        if len(data) < self.pixel_format.byte_count(self.width_px, self.height_px, x_padding):
            self.numbering.damaged()
            return None
        now_ns = time.monotonic_ns()
        arrived_ns = self._arrived_ns(now_ns, buffer.get_system_timestamp())
        number = self.numbering.number(buffer.get_frame_id(), arrived_ns, now_ns, underruns)
        if number is None:
            return None
        raw = np.frombuffer(data, np.uint8)
        image = self.pixel_format.image(raw, self.width_px, self.height_px, x_padding)
        image = plane_of(image, self.pixel_format.colours, self.plane)
        image.flags.writeable = False
        device_time_ns = buffer.get_timestamp() if self.has_clock else -1
        return Frame(image, number, device_time_ns, arrived_ns)

    def _arrived_ns(self, now_ns: int, wall_time_ns: int) -> int:
        """Arrival in ns on the monotonic clock, from that on the wall clock, which libaravis gives."""
        age_ns = min(max(time.time_ns() - wall_time_ns, 0), now_ns)
        self._host_time_ns = max(self._host_time_ns, now_ns - age_ns)
        return self._host_time_ns
