"""A source whose calls cannot be limited in time, read ahead by a thread."""

import threading

from acquisition.camera import CameraInfo, CameraSettings
from acquisition.cameras.v4l2.opencv import OpenCvSource
from acquisition.cameras.v4l2.source import RawFrame
from acquisition.frame import Frame
from acquisition.frame_queue import FrameQueue
from processing.errors import DeviceError

_JOIN_S = 0.4


class ReadAhead:
    """See `source.Source`. The only driver with a thread of its own.

    A read through OpenCV waits as long as it likes for a silent camera, and the device must not be closed
    under it: `next` could then keep no timeout. Frames are numbered in order of arrival.
    """

    def __init__(self, source: OpenCvSource, frames: int) -> None:
        self._source = source
        self._frames = frames
        self._halt = threading.Event()
        self._queue = FrameQueue(frames, "every")
        self._thread: threading.Thread | None = None
        self._error: DeviceError | None = None
        self._handover = threading.Lock()
        self._in_use = self._close = False

    def open(self) -> CameraInfo:
        """Claim the device."""
        return self._source.open()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply, read back."""
        return self._source.configure(settings)

    def start(self) -> None:
        """Begin to read."""
        if self._in_use:
            raise DeviceError("video camera: still waits for a frame of the last run; close and open it")
        self._source.start()
        self._halt.clear()
        self._queue, self._error = FrameQueue(self._frames, "every"), None
        self._in_use = True
        self._thread = threading.Thread(target=self._run, name="OpenCV", daemon=True)
        self._thread.start()

    def next(self, timeout_s: float) -> RawFrame | None:
        """The oldest frame that was not taken; what is missing before it came when the queue was full."""
        frames = self._queue.take(1, timeout_s)
        if frames:
            image, sequence, device_time_ns, host_time_ns = frames[0]
            return RawFrame(image, sequence, device_time_ns, host_time_ns, late=True)
        if self._error is not None and self._queue.drained:
            raise self._error
        return None

    def stop(self) -> None:
        """End the thread; waits for it a moment."""
        self._halt.set()
        self._queue.close()
        if self._thread is not None:
            self._thread.join(_JOIN_S)

    def close(self) -> None:
        """Close the device, or have the thread do so after the read that it waits in."""
        self.stop()
        with self._handover:
            self._close = self._in_use
        if not self._close:
            self._source.close()

    def _run(self) -> None:
        number = 0
        try:
            while not self._halt.is_set():
                raw = self._source.next()
                if raw is not None and raw.image is not None:
                    self._queue.put(Frame(raw.image, number, raw.device_time_ns, raw.host_time_ns))
                    number += 1
        except DeviceError as error:
            self._error = error
        except Exception as error:
            # whatever else goes wrong in this thread must reach the reader, never end in silence
            self._error = DeviceError(f"video camera: {type(error).__name__}: {error}")
        finally:
            self._queue.close()
            with self._handover:
                self._in_use = False
            if self._close:
                self._source.close()
