"""Conversion of libaravis's buffers into frames, with their checks."""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from acquisition.camera import ColourPlane
from acquisition.cameras.pixel_formats import Format, plane_of
from acquisition.frame import Frame
from acquisition.frames.losses import BlockNumbers, Place
from processing.errors import DeviceError

SHORT_IDS: Final = 65535
"""16-bit ids are followed by 1 after 65535; zero is not used (GigE Vision 1.x)."""


class Underruns:
    """Whether libaravis has lacked free buffers, by its count of such events, which it may give early."""

    def __init__(self) -> None:
        self._last_arrived_ns = -1
        # (time of fetching a frame, libaravis's count at that time)
        self._samples = deque([(-1, 0)])

    def before(self, arrived_ns: int, fetched_ns: int, count: int) -> bool:
        """Whether it did so since the frame before the one that arrived and was fetched at these times."""
        samples = self._samples
        while len(samples) > 1 and samples[1][0] <= self._last_arrived_ns:
            samples.popleft()
        was_full = count > samples[0][1]
        samples.append((fetched_ns, count))
        self._last_arrived_ns = arrived_ns
        return was_full


@dataclass(slots=True)
class BufferReader:
    """Converts the buffers of one acquisition into frames.

    `aravis` is the library's module; `has_clock` is True if timestamps come from the camera's own clock,
    `plane` is the colour to deliver. Damaged frames count as incomplete, other missing ones as lost by the
    host if libaravis lacked free buffers in the time in question, otherwise as lost on the bus: cameras do
    not report those that they lost themselves.
    """

    aravis: Any
    name: str
    pixel_format: Format
    width_px: int
    height_px: int
    has_clock: bool
    numbers: BlockNumbers
    plane: ColourPlane | None = None
    _host_time_ns: int = field(default=0, init=False)
    _underruns: Underruns = field(default_factory=Underruns, init=False)

    def frame(self, buffer: Any, underruns: int) -> Frame | None:
        """The frame in a buffer; None if it is damaged or was delivered before.

        Raises DeviceError if the payload is not an image, or has padding that cannot be removed.
        """
        if buffer.get_status() != self.aravis.BufferStatus.SUCCESS:
            self.numbers.lost_parts += 1
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
            self.numbers.lost_parts += 1
            return None
        now_ns = time.monotonic_ns()
        arrived_ns = self._arrived_ns(now_ns, buffer.get_system_timestamp())
        was_full = self._underruns.before(arrived_ns, now_ns, underruns)
        lost: Place = "dropped_by_host" if was_full else "dropped_by_bus"
        number = self.numbers.number(buffer.get_frame_id(), lost)
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
