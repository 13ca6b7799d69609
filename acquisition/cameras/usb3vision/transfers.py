"""Bulk reads from the stream endpoint: interface, blocking reads of pyusb, and queued reads of libusb."""

import ctypes
import errno
import logging
import time
from collections import deque
from ctypes import POINTER, Structure, byref, c_int, c_long, c_ubyte, c_uint, c_void_p
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import usb.core
from numpy.typing import NDArray

from acquisition.cameras.usb3vision.link import StreamHalted, UsbLink, is_gone, is_timeout
from processing.errors import DeviceError

Bytes = NDArray[np.uint8]
_READING: Final = "reading frames"


class CompletedTransfer(NamedTuple):
    """A transfer that has ended: its number of bytes, and the host's monotonic clock at its end."""

    byte_count: int
    host_time_ns: int


class Transfers(Protocol):
    """A queue of reads, used by one thread at a time."""

    frames_ahead: int
    """Number of frames for which reads should be queued."""
    under_way: bool
    """Whether a queued read may receive bytes before `wait` is called."""

    @property
    def has_room(self) -> bool:
        """Whether the system accepts a further read."""
        ...

    def submit(self, buffer: Bytes) -> None:
        """Queue a read into this buffer, which must stay untouched until it has ended."""
        ...

    def wait(self, timeout_s: float) -> CompletedTransfer:
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

    def wait(self, timeout_s: float) -> CompletedTransfer:
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
            if is_gone(error):
                raise link.unplugged(_READING) from error
            stalled = error.errno == errno.EPIPE
            what = "the stream endpoint has stalled" if stalled else f"error while reading frames: {error}"
            raise StreamHalted(f"{link.name}: {what}") from error
        now_ns = time.monotonic_ns()
        self._filled += count
        # whole packets only, and the time has elapsed, so the timeout ended the transfer and not the camera
        timed_out = count % link.packet_size == 0 and time.monotonic() - begin_s >= timeout_s
        if timed_out and self._filled < buffer.size:
            raise TimeoutError
        self._queued.popleft()
        total, self._filled = self._filled, 0
        return CompletedTransfer(total, now_ns)

    def cancel(self) -> None:
        """Remove all reads; none is pending between two calls of `wait`."""
        self._queued.clear()
        self._filled = 0


logger = logging.getLogger(__name__)

_BULK: Final = 2
_COMPLETED: Final = 0
_NO_DEVICE: Final = 5
_STATUS_NAMES: Final = {1: "error", 2: "timed out", 3: "cancelled", 4: "stalled", 6: "overflow"}
_ERROR_NO_DEVICE: Final = -4
_ERROR_NO_MEMORY: Final = -11


class _Transfer(Structure):
    """libusb's struct libusb_transfer, without the isochronous packets that may follow it."""


_Callback = ctypes.CFUNCTYPE(None, POINTER(_Transfer))
_Transfer._fields_ = [
    ("dev_handle", c_void_p),
    ("flags", c_ubyte),
    ("endpoint", c_ubyte),
    ("type", c_ubyte),
    ("timeout", c_uint),
    ("status", c_int),
    ("length", c_int),
    ("actual_length", c_int),
    ("callback", _Callback),
    ("user_data", c_void_p),
    ("buffer", c_void_p),
    ("num_iso_packets", c_int),
]


class _TimeValue(Structure):
    _fields_ = [("seconds", c_long), ("microseconds", c_long)]


class _Read:
    """One pending read; its reference to `buffer` keeps the memory alive into which libusb writes."""

    def __init__(self, transfer: Any, buffer: NDArray[np.uint8]) -> None:
        self.transfer = transfer
        self.buffer = buffer
        self.done = c_int(0)
        self.host_time_ns = 0


class LibusbTransfers:
    """A queue of reads, all of which libusb has submitted to the kernel; see `Transfers`."""

    under_way = True

    def __init__(self, link: UsbLink, frames_ahead: int) -> None:
        self.frames_ahead = frames_ahead
        self._max_bytes = _usbfs_limit()
        self._link = link
        backend = link.device.backend
        # loaded again, because the declarations of functions below must not change those of pyusb
        self._lib = ctypes.CDLL(backend.lib._name)
        self._context = c_void_p(_address(backend.ctx))
        self._handle = c_void_p(_address(link.handle.handle))
        self._declare()
        self._reads: deque[_Read] = deque()
        self._read_at_address: dict[int, _Read] = {}
        self._callback = _Callback(self._on_end)

    @staticmethod
    def suits(link: UsbLink) -> bool:
        """Whether pyusb accesses this camera through libusb 1.0."""
        backend = link.device.backend
        return hasattr(getattr(backend, "lib", None), "libusb_submit_transfer") and hasattr(backend, "ctx")

    @property
    def has_room(self) -> bool:
        """Whether the kernel has memory for a further read of the largest size."""
        pending = sum(read.buffer.size for read in self._reads)
        longest = max((read.buffer.size for read in self._reads), default=0)
        return pending + longest <= self._max_bytes

    def _declare(self) -> None:
        lib = self._lib
        lib.libusb_alloc_transfer.argtypes = [c_int]
        lib.libusb_alloc_transfer.restype = POINTER(_Transfer)
        for function in (lib.libusb_submit_transfer, lib.libusb_cancel_transfer, lib.libusb_free_transfer):
            function.argtypes = [POINTER(_Transfer)]
        lib.libusb_free_transfer.restype = None
        lib.libusb_handle_events_timeout_completed.argtypes = [c_void_p, POINTER(_TimeValue), POINTER(c_int)]

    def _on_end(self, transfer: Any) -> None:
        """Called by libusb at the end of a read, in the thread that handles its events."""
        read = self._read_at_address.get(ctypes.addressof(transfer.contents))
        if read is not None:
            read.host_time_ns = time.monotonic_ns()
            read.done.value = 1

    def submit(self, buffer: NDArray[np.uint8]) -> None:
        """Submit a read to the kernel."""
        transfer = self._lib.libusb_alloc_transfer(0)
        fields = transfer.contents
        fields.dev_handle = self._handle
        fields.endpoint = self._link.stream_in
        fields.type = _BULK
        fields.timeout = 0
        fields.length = buffer.size
        fields.buffer = buffer.ctypes.data
        fields.callback = self._callback
        read = _Read(transfer, buffer)
        self._read_at_address[ctypes.addressof(fields)] = read
        error = self._lib.libusb_submit_transfer(transfer)
        if error:
            self._free(read)
            if error == _ERROR_NO_DEVICE:
                raise self._link.unplugged(_READING)
            if error == _ERROR_NO_MEMORY:
                raise DeviceError(
                    f"{self._link.name}: the system has no memory for {len(self._reads) + 1} transfers; "
                    "lower camera.frame_rate_hz or the size of the frames, "
                    "or raise /sys/module/usbcore/parameters/usbfs_memory_mb"
                )
            raise StreamHalted(f"{self._link.name}: a read could not be started (libusb error {error})")
        self._reads.append(read)

    def _free(self, read: _Read) -> None:
        self._read_at_address.pop(ctypes.addressof(read.transfer.contents), None)
        self._lib.libusb_free_transfer(read.transfer)

    def _handle_events(self, timeout_s: float, done: c_int) -> None:
        microseconds = max(0, round(timeout_s * 1e6))
        span = _TimeValue(microseconds // 1_000_000, microseconds % 1_000_000)
        self._lib.libusb_handle_events_timeout_completed(self._context, byref(span), byref(done))

    def wait(self, timeout_s: float) -> CompletedTransfer:
        """Handle libusb's events until the oldest read has ended; see `Transfers.wait`."""
        read = self._reads[0]
        deadline_s = time.monotonic() + timeout_s
        while not read.done.value:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            self._handle_events(left_s, read.done)
        self._reads.popleft()
        status, count = read.transfer.contents.status, read.transfer.contents.actual_length
        self._free(read)
        if status == _COMPLETED:
            return CompletedTransfer(count, read.host_time_ns)
        if status == _NO_DEVICE:
            raise self._link.unplugged(_READING)
        meaning = _STATUS_NAMES.get(status, f"status {status}")
        raise StreamHalted(f"{self._link.name}: a read of the stream ended with: {meaning}")

    def cancel(self) -> None:
        """Cancel all reads and wait until libusb no longer uses their memory."""
        for read in self._reads:
            if not read.done.value:
                self._lib.libusb_cancel_transfer(read.transfer)
        deadline_s = time.monotonic() + 0.5
        while self._reads:
            read = self._reads[0]
            while not read.done.value and time.monotonic() < deadline_s:
                self._handle_events(0.05, read.done)
            if not read.done.value:
                # libusb may still write into the buffers: they are never freed
                logger.warning("%s: %d reads cannot be cancelled", self._link.name, len(self._reads))
                _ABANDONED.extend(self._reads)
                self._reads.clear()
                return
            self._reads.popleft()
            self._free(read)


_ABANDONED: list[_Read] = []
"""Reads that could not be cancelled, whose memory must therefore stay."""


def _usbfs_limit() -> float:
    """Largest total size of pending reads in bytes: half of Linux's limit for all USB devices; else inf."""
    try:
        megabytes = int(Path("/sys/module/usbcore/parameters/usbfs_memory_mb").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return float("inf")
    return megabytes * 2**20 / 2 if megabytes else float("inf")


def _address(pointer: Any) -> int | None:
    address: int | None = getattr(pointer, "value", pointer)
    return address
