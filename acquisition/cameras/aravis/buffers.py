"""Conversion of libaravis's buffers into frames, with checks and counts."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from acquisition.camera import ColourPlane
from acquisition.cameras.aravis.numbering import FrameNumbering
from acquisition.cameras.colour_plane import plane_of
from acquisition.cameras.pixel_formats import Format
from acquisition.frame import Frame
from processing.errors import DeviceError


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
                f"{self.name}: sends payload of the type {sent}, no image; switch that off in the camera"
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
