"""Reads that receive bytes before they are waited for, as with a host controller, without a kernel."""

import threading
import time
from collections import deque
from dataclasses import dataclass

from acquisition.camera import CameraLost
from acquisition.cameras.usb3vision.link import StreamHalted
from acquisition.cameras.usb3vision.transfers import Bytes, CompletedTransfer
from tests.acquisition.cameras.usb3vision.device import (
    OverrunError,
    StalledError,
    UnpluggedError,
    VisionDevice,
)


@dataclass(eq=False)
class _Read:
    buffer: Bytes
    arrived: CompletedTransfer | None = None
    error: Exception | None = None


class EagerTransfers:
    """A queue of reads that a thread fills as fast as the camera gives; what is cancelled is lost.

    `lag_s` holds the reader up after every read, so that the later ones are well ahead of it.
    """

    has_room = True
    under_way = True

    def __init__(self, device: VisionDevice, frames_ahead: int, lag_s: float) -> None:
        self.frames_ahead = frames_ahead
        self._device = device
        self._lag_s = lag_s
        self._changed = threading.Condition()
        self._under_way: deque[_Read] = deque()
        self._submitted: deque[_Read] = deque()
        self._thread: threading.Thread | None = None

    def _work(self) -> None:
        """Until no read is under way, or for good when the camera is gone."""
        while True:
            with self._changed:
                if not self._under_way:
                    self._thread = None
                    return
                read = self._under_way[0]
            try:
                count = self._device.stream_in(memoryview(read.buffer), 0.005)
                read.arrived = CompletedTransfer(count, time.monotonic_ns())
            except TimeoutError:
                continue
            except (StalledError, OverrunError, UnpluggedError) as error:
                read.error = error
            with self._changed:
                if read in self._under_way:
                    self._under_way.remove(read)
                self._changed.notify_all()
            if isinstance(read.error, UnpluggedError):
                return

    def submit(self, buffer: Bytes) -> None:
        """Begin a read."""
        read = _Read(buffer)
        with self._changed:
            self._under_way.append(read)
            self._submitted.append(read)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True)
                self._thread.start()

    def wait(self, timeout_s: float) -> CompletedTransfer:
        """The oldest read's end."""
        time.sleep(self._lag_s)
        with self._changed:
            read = self._submitted[0]
            if not self._changed.wait_for(lambda: read.arrived or read.error, timeout_s):
                raise TimeoutError
            self._submitted.popleft()
        if isinstance(read.error, UnpluggedError):
            raise CameraLost("is no longer connected; plug it in again")
        if read.error is not None:
            raise StreamHalted(repr(read.error))
        assert read.arrived is not None
        return read.arrived

    def cancel(self) -> None:
        """Give up all reads; what they have brought, or bring just now, is lost."""
        with self._changed:
            self._under_way.clear()
            self._submitted.clear()
            thread = self._thread
        if thread is not None:
            thread.join()
