"""Bulk reads from the stream endpoint: interface, and an implementation with blocking reads through pyusb."""

import errno
import time
from collections import deque
from typing import NamedTuple, Protocol

import numpy as np
import usb.core
from numpy.typing import NDArray

from acquisition.camera import CameraLost
from acquisition.cameras.usb3vision.link import StreamHalted, UsbLink, is_gone, is_timeout

Bytes = NDArray[np.uint8]


class Arrived(NamedTuple):
    """A completed transfer: number of bytes, and the host's monotonic clock at its end."""

    byte_count: int
    host_time_ns: int


class Transfers(Protocol):
    """A queue of reads, used by one thread at a time.

    `frames_ahead` is the number of frames for which reads should be queued. `under_way` is True if a queued
    read may receive bytes before `wait` is called.
    """

    frames_ahead: int
    under_way: bool

    @property
    def has_room(self) -> bool:
        """Whether the system accepts a further read."""
        ...

    def submit(self, buffer: Bytes) -> None:
        """Queue a read into this buffer, which must stay untouched until it has ended."""
        ...

    def wait(self, timeout_s: float) -> Arrived:
        """Wait for the end of the oldest read.

        Raises TimeoutError (the read remains queued), StreamHalted (it is removed from the queue),
        CameraLost.
        """
        ...

    def cancel(self) -> None:
        """Cancel all queued reads."""
        ...


class TransferBuffer(np.ndarray[tuple[int], np.dtype[np.uint8]]):
    """Memory for pyusb's backends, which expect the method `buffer_info` of array.array."""

    def buffer_info(self) -> tuple[int, int]:
        """Address and number of bytes."""
        return self.ctypes.data, self.size


class BlockingTransfers:
    """Reads one after the other through any of pyusb's backends; see `Transfers`."""

    frames_ahead = 1
    under_way = False
    has_room = True

    def __init__(self, link: UsbLink) -> None:
        self._link = link
        self._queued: deque[TransferBuffer] = deque()
        self._filled = 0

    def submit(self, buffer: Bytes) -> None:
        """Queue a read; it starts when it is the oldest and `wait` is called."""
        self._queued.append(buffer.view(TransferBuffer))

    def wait(self, timeout_s: float) -> Arrived:
        link = self._link
        buffer = self._queued[0]
        timeout_ms = max(1, round(timeout_s * 1000))
        begin_s = time.monotonic()
        try:
            count = link.device.backend.bulk_read(
                link.handle, link.stream_in, link.stream_interface, buffer[self._filled :], timeout_ms
            )
        except usb.core.USBError as error:
            if is_timeout(error):
                raise TimeoutError from None
            self._queued.popleft()
            self._filled = 0
            raise stream_error(error, link) from error
        now_ns = time.monotonic_ns()
        self._filled += count
        # only whole packets and the time has elapsed: the timeout ended the transfer, not the camera
        is_cut = count % link.packet_size == 0 and time.monotonic() - begin_s >= timeout_s
        if is_cut and self._filled < buffer.size:
            raise TimeoutError
        self._queued.popleft()
        total, self._filled = self._filled, 0
        return Arrived(total, now_ns)

    def cancel(self) -> None:
        """Remove all reads; none is pending between two calls of `wait`."""
        self._queued.clear()
        self._filled = 0


def unplugged(link: UsbLink) -> CameraLost:
    """The exception for a camera that is disconnected while frames are read."""
    return CameraLost(f"{link.name}: is no longer connected (reading frames); plug it in again")


def stream_error(error: usb.core.USBError, link: UsbLink) -> CameraLost | StreamHalted:
    """The exception for an error of pyusb while the stream is read."""
    if is_gone(error):
        return unplugged(link)
    if error.errno == errno.EPIPE:
        return StreamHalted(f"{link.name}: the stream endpoint has stalled")
    return StreamHalted(f"{link.name}: error while reading frames: {error}")
