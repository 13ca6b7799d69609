"""Cameras that pylon supports, as a `Camera`."""

import time
import warnings
from contextlib import suppress
from typing import Any, Final

import numpy as np

from acquisition.camera import CameraInfo, CameraLost, FeatureValue, Frame, PluggedCamera
from acquisition.cameras.drivers import PylonSettings, buffer_count
from acquisition.cameras.genicam import GenicamCamera, GenicamFeatures
from acquisition.cameras.pixel_formats import ExpectedFrames
from acquisition.cameras.reading import CameraRun, only_camera
from acquisition.frames.losses import LAST_SHORT_ID
from processing.errors import optional_module
from processing.units import NS_PER_S

_TICKS_PER_S: Final = "GevTimestampTickFrequency"


class PylonFeatures(GenicamFeatures):
    """Features of an open camera; `camera` is pylon's object, `name` is for messages."""

    def __init__(self, camera: Any, name: str) -> None:
        super().__init__(name)
        self._nodes = camera.GetNodeMap()

    def has(self, feature: str) -> bool:
        return self._node(feature) is not None

    def writable(self, feature: str) -> bool:
        node = self._node(feature)
        return node is not None and bool(node.IsWritable())

    def choices(self, feature: str) -> tuple[str, ...]:
        return tuple(getattr(self._node(feature), "Symbolics", ()))

    def limits(self, feature: str) -> tuple[float | None, float | None]:
        node = self._node(feature)
        return getattr(node, "Min", None), getattr(node, "Max", None)

    def read(self, feature: str) -> FeatureValue | None:
        node = self._node(feature)
        if node is None or not node.IsReadable():
            return None
        value: FeatureValue = node.Value
        return value

    def write(self, feature: str, value: FeatureValue) -> None:
        node = self._node(feature)
        if hasattr(node, "Execute"):
            node.Execute()
        else:
            node.FromString(str(value).lower() if isinstance(value, bool) else str(value))

    def displayed_value(self, name: str) -> FeatureValue:
        return str(self._node(self.local_name(name)).ToString())

    def _node(self, name: str) -> Any:
        """pylon's node of a feature; None if the camera does not have it."""
        node = self._nodes.GetNode(name)
        # newer versions return an invalid node for a missing feature
        return node if node is not None and node.IsValid() else None

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        values: dict[str, FeatureValue] = {}
        for node in self._nodes.GetNodes():
            if node.IsReadable() and hasattr(node, "ToString") and not hasattr(node, "Features"):
                # some features are reported as readable, and fail when they are read
                with suppress(error):
                    values[node.GetNode().GetName()] = str(node.ToString())
        return values

    def tick_ns(self) -> float:
        """Length of a tick in ns: USB cameras count ns, GigE cameras state a frequency, which PTP changes."""
        per_s = self.read(_TICKS_PER_S)
        return NS_PER_S / float(per_s) if per_s else 1.0


_UNKNOWN_BLOCK_ID: Final = 2**64 - 1


class PylonCamera(GenicamCamera[PylonFeatures]):
    """A camera supported by pylon (USB3 Vision, GigE, emulation); pylon acquires and queues the frames.

    Missing block numbers are counted as dropped by the bus (pylon does not say which of them found no
    buffer); damaged frames have an error status. A camera whose timestamps are all 0 (the emulation) has no
    clock.
    """

    def __init__(self, settings: PylonSettings | None = None) -> None:
        super().__init__("pylon camera")
        self._settings = settings or PylonSettings()
        self._camera: Any = None
        self._pylon: Any = None
        self._emulated = False
        self._expected: ExpectedFrames | None = None
        self._tick_ns = 0.0

    def _library_error(self) -> type[Exception]:
        return Exception

    def _is_gone(self) -> bool:
        return self._camera is not None and bool(self._camera.IsCameraDeviceRemoved())

    def open(self) -> CameraInfo:
        self.close()
        pylon = self._pylon = load_pylon()
        factory = pylon.TlFactory.GetInstance()
        connected = [
            (f"{device.GetModelName()} (serial {number})", number, device)
            for device in factory.EnumerateDevices()
            for number in [device.GetSerialNumber()]
        ]
        device = only_camera("pylon", connected, self._settings.serial)
        self._name = f"pylon camera {device.GetModelName()} (serial {device.GetSerialNumber()})"
        with self._lock, self._translate_errors():
            camera = pylon.InstantCamera(factory.CreateDevice(device))
            camera.Open()
            self._camera = camera
            features = self._features = PylonFeatures(camera, self._name)
            features.choose_usable_format()
            self._emulated = device.GetDeviceClass() == "BaslerCamEmu"
            return features.info(
                "pylon",
                device.GetVendorName(),
                device.GetModelName(),
                device.GetSerialNumber(),
                has_clock=not self._emulated,
            )

    def start(self) -> None:
        """Start the acquisition of every frame, in order, into new buffers."""
        with self._lock, self._translate_errors():
            features, camera = self._open_device(), self._camera
            self._must_be_idle()
            # block numbers of old GigE cameras end at 65535
            self._begin((LAST_SHORT_ID,))
            self._expected = features.expected_frames(has_clock=not self._emulated)
            self._tick_ns = 0.0 if self._emulated else features.tick_ns()
            frame_bytes = camera.PayloadSize.Value
            camera.MaxNumBuffer.Value = buffer_count(features.expected_rate_hz(), frame_bytes, 64, 4096)
            camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            self._run = CameraRun(self._next, camera.StopGrabbing)

    def _next(self, timeout_s: float) -> Frame | None:
        camera, run, expected = self._camera, self._run, self._expected
        if camera is None or run is None or expected is None:
            return None
        result = camera.RetrieveResult(int(timeout_s * 1000) + 1, self._pylon.TimeoutHandling_Return)
        host_time_ns = time.monotonic_ns()
        if result is None or not result.IsValid():
            if not run.stopped and camera.IsCameraDeviceRemoved():
                raise CameraLost(f"{self._name}: is no longer connected; plug it in again")
            return None
        try:
            if not result.GrabSucceeded():
                self._numbers.lose_faulty()
                return None
            # pylon's count of skipped images lacks other losses; the numbers of blocks show every loss
            block = int(result.GetBlockID())
            number = self._numbers.number(None if block == _UNKNOWN_BLOCK_ID else block, "dropped_by_bus")
            if number is None:
                return None
            x_padding = result.GetPaddingX()
            expected.refuse_padding(self._name, x_padding)
            image = expected.image(np.frombuffer(result.GetBuffer(), np.uint8), x_padding)
            device_time_ns = round(result.GetTimeStamp() * self._tick_ns) if self._tick_ns else -1
        finally:
            result.Release()
        return Frame(image, number, device_time_ns, host_time_ns)

    def close(self) -> None:
        self.stop()
        with self._lock:
            camera, self._camera, self._features = self._camera, None, None
            if camera is not None:
                self._when_idle(camera.Close)


def load_pylon() -> Any:
    """The module pypylon.pylon. Raises MissingPackage if missing."""
    with warnings.catch_warnings():
        # importing its binary module raises warnings, and would fail if warnings are errors
        warnings.simplefilter("ignore")
        return optional_module("pypylon.pylon", "camera.driver = 'pylon'", "pypylon", "pylon")


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by pylon, with the transport layer as `connection`."""
    return [
        PluggedCamera("pylon", device.GetModelName(), device.GetSerialNumber(), device.GetDeviceClass())
        for device in load_pylon().TlFactory.GetInstance().EnumerateDevices()
    ]
