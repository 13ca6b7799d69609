"""Video4Linux cameras as a `Camera`."""

import sys
import threading

from acquisition.camera import (
    CameraInfo,
    CameraLost,
    CameraSettings,
    CameraStatus,
    FeatureValue,
    Frame,
    FrameTimeout,
)
from acquisition.cameras.drivers import V4l2Settings
from acquisition.cameras.reading import CameraRun
from acquisition.cameras.v4l2.devices import VideoDevice
from acquisition.cameras.v4l2.linux import LinuxSource
from acquisition.frames.losses import BlockNumbers
from processing.errors import DeviceError

_STOP_S = 0.4


class V4l2Camera:
    """A UVC or other Video4Linux camera, on Linux.

    Notes
    -----
    The driver numbers frames. Gaps count as lost by the host if all buffers were full, else as lost on the
    bus; frames that the driver marks as damaged have an error status. `open` finds the same camera again,
    also under another device number.
    """

    def __init__(self, settings: V4l2Settings | None = None) -> None:
        self._settings = settings or V4l2Settings()
        self._lock = threading.RLock()
        self._source: LinuxSource | None = None
        self._last_device: VideoDevice | None = None
        self._run: CameraRun | None = None
        self._numbers = BlockNumbers("video camera", ())
        self._past_counts = CameraStatus()
        self._was_lost = False

    def open(self) -> CameraInfo:
        if sys.platform != "linux":
            raise DeviceError(
                "camera.driver = 'v4l2' reads cameras on Linux only; use 'usb3vision' or 'files'"
            )
        self.close()
        with self._lock:
            source = LinuxSource(self._settings, self._last_device)
            info = source.open()
            self._source, self._last_device = source, source.found
            return info

    def configure(self, settings: CameraSettings) -> CameraSettings:
        with self._lock:
            source = self._open_source()
            self._must_not_run("stop it before settings are changed")
            return source.configure(settings)

    def start(self) -> None:
        """Begin with fresh buffers."""
        with self._lock:
            source = self._open_source()
            self._must_not_run("stop it first")
            if self._run is not None and not self._run.stop(1.0):
                raise DeviceError("video camera: still waits for a frame of the last run; close and open it")
            self._past_counts, self._was_lost = self.status.to_begin_with(lost=self._was_lost), False
            self._run = None
            self._numbers = numbers = BlockNumbers("video camera", ())
            source.start()
            self._run = CameraRun(lambda timeout_s: source.next(timeout_s, numbers), source.stop)

    def read(self, timeout_s: float) -> Frame | None:
        run = self._run
        if run is None:
            raise DeviceError("video camera: is not started; call start before read")
        try:
            return run.read(timeout_s)
        except TimeoutError:
            raise FrameTimeout(
                f"video camera: no frame within {timeout_s:g} s; is it still plugged in?"
            ) from None
        except CameraLost:
            self._was_lost = True
            raise

    def stop(self) -> None:
        run = self._run
        if run is not None:
            run.stop(_STOP_S)

    def close(self) -> None:
        """Stop, and release the device, at the latest when a waiting read has ended."""
        self.stop()
        with self._lock:
            source, self._source = self._source, None
            if source is None:
                return
            if self._run is None:
                source.close()
            else:
                self._run.when_ended(source.close)

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`; they go on over a reconnection."""
        run = self._run
        return self._past_counts if run is None else self._past_counts + self._numbers.status(run.delivered)

    def feature_values(self) -> dict[str, FeatureValue]:
        """All controls of the device that can be read now."""
        return self._open_source().feature_values()

    def feature_value(self, name: str) -> FeatureValue | None:
        """Value of one control; None if it cannot be read now."""
        return self.feature_values().get(name)

    def _open_source(self) -> LinuxSource:
        if self._source is None:
            raise DeviceError("video camera: is not open; call open first")
        return self._source

    def _must_not_run(self, remedy: str) -> None:
        if self._run is not None and not self._run.stopped:
            raise DeviceError(f"video camera: is running; {remedy}")
