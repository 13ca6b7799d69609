"""Video4Linux cameras as a `Camera`."""

import sys

from acquisition.camera import CameraInfo, FeatureValue
from acquisition.cameras.drivers import V4l2Settings
from acquisition.cameras.reading import CameraRun, DeviceCamera
from acquisition.cameras.v4l2.devices import VideoDevice
from acquisition.cameras.v4l2.linux import LinuxSource
from processing.errors import DeviceError


class V4l2Camera(DeviceCamera[LinuxSource]):
    """A UVC or other Video4Linux camera, on Linux.

    Notes
    -----
    The driver numbers frames. Gaps count as lost by the host if all buffers were full, else as lost on the
    bus; frames that the driver marks as damaged have an error status. `open` finds the same camera again,
    also under another device number.
    """

    _SILENT = "is it still plugged in?"

    def __init__(self, settings: V4l2Settings | None = None) -> None:
        super().__init__("video camera")
        self._settings = settings or V4l2Settings()
        self._last_device: VideoDevice | None = None

    def open(self) -> CameraInfo:
        if sys.platform != "linux":
            raise DeviceError(
                "camera.driver = 'v4l2' reads cameras on Linux only; use 'usb3vision' or 'files'"
            )
        self.close()
        with self._lock:
            source = LinuxSource(self._settings, self._last_device)
            info = source.open()
            self._features, self._last_device = source, source.found
            return info

    def start(self) -> None:
        """Start the stream with new buffers."""
        with self._lock:
            source = self._open_device()
            self._must_be_idle()
            if self._run is not None and not self._run.stop(1.0):
                raise DeviceError(f"{self._name}: still waits for a frame of the last run; close and open it")
            numbers = self._begin()
            source.start()
            self._run = CameraRun(lambda timeout_s: source.next(timeout_s, numbers), source.stop)

    def close(self) -> None:
        """Stop, and release the device, now or when a waiting read has ended."""
        self.stop()
        with self._lock:
            source, self._features = self._features, None
            if source is not None:
                self._when_idle(source.close)

    def feature_values(self) -> dict[str, FeatureValue]:
        """All controls of the device that can be read now."""
        return self._open_device().feature_values()

    def feature_value(self, name: str) -> FeatureValue | None:
        """Value of one control; None if it cannot be read now."""
        return self.feature_values().get(name)
