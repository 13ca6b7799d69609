"""Video4Linux cameras as a `Camera`: a thread reads ahead, so that the driver never runs out of buffers."""

import sys
import threading
from dataclasses import replace

from acquisition.camera import CameraInfo, CameraLost, CameraSettings, CameraStatus, FrameTimeout
from acquisition.cameras.v4l2.settings import V4l2Settings
from acquisition.cameras.v4l2.source import Source
from acquisition.frame import Frame
from acquisition.frame_queue import FrameQueue
from processing.errors import DeviceError

_JOIN_S = 0.4


class V4l2Camera:
    """A UVC or other Video4Linux camera; with OpenCV also what Windows and macOS offer.

    Notes
    -----
    If the driver numbers frames, its numbers are used and gaps count as lost on the bus; frames that it
    marks as damaged count as incomplete. OpenCV provides neither: frames are numbered in order of arrival,
    and losses are not known.
    """

    def __init__(self, settings: V4l2Settings | None = None) -> None:
        self._settings = settings or V4l2Settings()
        self._lock = threading.RLock()
        self._source: Source | None = None
        self._reader: _Reader | None = None
        self._status = CameraStatus()
        self._was_lost = False

    def open(self) -> CameraInfo:
        """Find and claim the device."""
        self.close()
        with self._lock:
            source = _make_source(self._settings)
            info = source.open()
            self._source = source
            return info

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; what is returned was read from the camera afterwards."""
        with self._lock:
            source = self._opened()
            self._must_not_run("stop it before settings are changed")
            return source.configure(settings)

    def start(self) -> None:
        """Begin with an empty queue and fresh buffers."""
        with self._lock:
            source = self._opened()
            self._must_not_run("stop it first")
            if self._reader is not None and not self._reader.ended.wait(1.0):
                raise DeviceError("video camera: still waits for a frame of the last run; close and open it")
            before = self.status
            lost, self._was_lost = self._was_lost, False
            self._status = replace(before, reconnects=before.reconnects + 1) if lost else CameraStatus()
            source.start()
            self._reader = _Reader(source, self._settings.queued_frames)
            self._reader.thread.start()

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame; see `acquisition.camera.Camera.read`."""
        reader = self._reader
        if reader is None:
            raise DeviceError("video camera: is not started; call start before read")
        frames = reader.queue.take(1, timeout_s)
        if reader.halted:
            return None
        if frames:
            reader.delivered += 1
            return frames[0]
        if not reader.queue.drained:
            raise FrameTimeout(f"video camera: no frame within {timeout_s:g} s; is it still plugged in?")
        if reader.error is None:
            return None
        self._was_lost = isinstance(reader.error, CameraLost)
        raise type(reader.error)(str(reader.error))

    def stop(self) -> None:
        """No more frames."""
        reader = self._reader
        if reader is not None:
            reader.stop()

    def close(self) -> None:
        """Stop and give the device back, at the latest when a read that waits has come to its end."""
        self.stop()
        with self._lock:
            source, self._source = self._source, None
            if source is None:
                return
            if self._reader is not None:
                self._reader.when_ended_close()
            else:
                source.close()

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`; they go on over a reconnection."""
        reader, before = self._reader, self._status
        if reader is None:
            return before
        return before + CameraStatus(
            delivered=reader.delivered,
            dropped_by_bus=reader.missing,
            dropped_by_host=reader.queue.dropped,
            incomplete=reader.damaged,
        )

    def _opened(self) -> Source:
        if self._source is None:
            raise DeviceError("video camera: is not open; call open first")
        return self._source

    def _must_not_run(self, remedy: str) -> None:
        if self._reader is not None and not self._reader.halted and self._reader.thread.is_alive():
            raise DeviceError(f"video camera: is running; {remedy}")


class _Reader:
    """The thread that reads from start to stop, and its counts."""

    def __init__(self, source: Source, frames: int) -> None:
        self._source = source
        self._halt = threading.Event()
        self._lock = threading.Lock()
        self._close = False
        self._first = -1
        self._last = -1
        self.queue = FrameQueue(frames, "every")
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._run, name="v4l2", daemon=True)
        self.error: DeviceError | None = None
        self.delivered = self.missing = self.damaged = 0

    @property
    def halted(self) -> bool:
        """It was told to stop."""
        return self._halt.is_set()

    def stop(self) -> None:
        """End the thread; waits for it a moment."""
        self._halt.set()
        self.queue.close()
        if self.thread.is_alive() and self.thread is not threading.current_thread():
            self.thread.join(_JOIN_S)

    def when_ended_close(self) -> None:
        """Close the device now, or after the read that the thread waits in: never under it."""
        with self._lock:
            self._close = True
            if not self.ended.is_set():
                return
        self._source.close()

    def _run(self) -> None:
        try:
            while not self._halt.is_set():
                raw = self._source.next()
                if raw is None:
                    continue
                number = raw.sequence if raw.sequence >= 0 else self._last + 1
                if self._first < 0:
                    self._first, self._last = number, number - 1
                self.missing += max(number - self._last - 1, 0)
                self._last = number
                if raw.image is None:
                    self.damaged += 1
                    continue
                if not self._halt.is_set():
                    self.queue.put(
                        Frame(raw.image, number - self._first, raw.device_time_ns, raw.host_time_ns)
                    )
        except DeviceError as error:
            self.error = error
        except Exception as error:
            # whatever else goes wrong in this thread must reach the reader, never end in silence
            self.error = DeviceError(f"video camera: {type(error).__name__}: {error}")
        finally:
            self._source.stop()
            self.queue.close()
            with self._lock:
                self.ended.set()
                close = self._close
            if close:
                self._source.close()


def _make_source(settings: V4l2Settings) -> Source:
    reading = settings.reading
    if reading == "auto":
        reading = "kernel" if sys.platform == "linux" else "opencv"
    if reading == "kernel":
        if sys.platform != "linux":
            raise DeviceError("camera.v4l2.reading = 'kernel' works on Linux only; use 'opencv'")
        from acquisition.cameras.v4l2.linux import LinuxSource

        return LinuxSource(settings)
    from acquisition.cameras.v4l2.opencv import OpenCvSource

    return OpenCvSource(settings)
