"""Cameras that pylon supports, as a `Camera`."""

import time
import warnings
from contextlib import suppress
from typing import Any, Final

import numpy as np

from acquisition.camera import (
    CameraInfo,
    CameraLost,
    CameraSettings,
    ColourPlane,
    FeatureValue,
    Frame,
    PluggedCamera,
)
from acquisition.cameras.drivers import PylonSettings, buffer_count
from acquisition.cameras.genicam import GenicamCamera, GenicamFeatures, NumericFeature
from acquisition.cameras.pixel_formats import Format, plane_of
from acquisition.cameras.reading import CameraRun
from processing.errors import DeviceError, MissingPackage
from processing.units import NS_PER_S

_NAMES: Final[dict[NumericFeature, tuple[str, ...]]] = {
    "exposure_us": ("ExposureTime", "ExposureTimeAbs"),
    "gain_db": ("Gain",),
    "frame_rate_hz": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
}
_TICKS_PER_S: Final = "GevTimestampTickFrequency"


class PylonFeatures(GenicamFeatures):
    """Features of an open camera; `camera` is pylon's object, `name` is for messages."""

    def __init__(self, camera: Any, name: str) -> None:
        super().__init__(name)
        self._camera = camera
        self._nodes = camera.GetNodeMap()

    # ---- the methods of GenicamFeatures

    def writable(self, feature: str) -> bool:
        node = self.node(feature)
        return node is not None and bool(node.IsWritable())

    def choices(self, feature: str) -> tuple[str, ...]:
        return tuple(getattr(self.node(feature), "Symbolics", ()))

    def read(self, feature: str) -> FeatureValue | None:
        node = self.node(feature)
        if node is None or not node.IsReadable():
            return None
        value: FeatureValue = node.Value
        return value

    def write(self, feature: str, value: FeatureValue) -> None:
        node = self.node(feature)
        if hasattr(node, "Execute"):
            node.Execute()
        else:
            node.FromString(str(value).lower() if isinstance(value, bool) else str(value))

    def set_feature(self, name: str, value: FeatureValue) -> None:
        if self.node(name) is None:
            raise DeviceError(f"{self.name}: has no feature {name}; leave camera.features.{name} out")
        self.write(name, value)

    def value_for_user(self, name: str) -> FeatureValue:
        return str(self.node(name).ToString())

    def number(self, key: NumericFeature) -> float | None:
        node = self.node(*_NAMES[key])
        return None if node is None or not node.IsReadable() else float(node.Value)

    def set_number(self, key: NumericFeature, wanted: float) -> None:
        node = self.node(*_NAMES[key])
        if key == "frame_rate_hz" and self.node(self.rate_switch) is not None:
            self.write(self.rate_switch, True)
        if node is None:
            raise DeviceError(f"{self.name}: has no {_NAMES[key][0]}; leave camera.{key} out")
        self._check(key, wanted, node.Min, node.Max)
        node.Value = wanted

    def region(self) -> tuple[int, int, int, int]:
        camera = self._camera
        x, y, width_px, height_px = camera.OffsetX, camera.OffsetY, camera.Width, camera.Height
        return int(x.Value), int(y.Value), int(width_px.Value), int(height_px.Value)

    def set_region(self, asked: CameraSettings) -> None:
        camera = self._camera
        for key, start, length, offset, size in (
            ("width_px", asked.offset_x_px, asked.width_px, camera.OffsetX, camera.Width),
            ("height_px", asked.offset_y_px, asked.height_px, camera.OffsetY, camera.Height),
        ):
            if start is None and length is None:
                continue
            start = int(offset.Value) if start is None else start
            length = int(size.Value) if length is None else length
            self._check_end(key, start + length, int(size.Max) + int(offset.Value))
            offset.Value = offset.Min
            size.Value = length
            offset.Value = start

    def format_name(self) -> str:
        return str(self._camera.PixelFormat.Value)

    def offered_formats(self) -> list[str]:
        # pylon makes arrays of whole words only
        return [name for name in self._camera.PixelFormat.Symbolics if not name.endswith(("p", "Packed"))]

    def set_format_name(self, name: str) -> None:
        self._camera.PixelFormat.Value = name

    # ---- for the driver

    def node(self, *names: str) -> Any:
        """The first of these features that the camera has, as pylon's node; None if it has none of them."""
        for name in names:
            node = self._nodes.GetNode(name)
            # newer versions return an invalid node for a missing feature
            if node is not None and node.IsValid():
                return node
        return None

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        found: dict[str, FeatureValue] = {}
        for node in self._nodes.GetNodes():
            if node.IsReadable() and hasattr(node, "ToString") and not hasattr(node, "Features"):
                # some features are reported as readable, and fail
                with suppress(error):
                    found[node.GetNode().GetName()] = str(node.ToString())
        return found

    def tick_ns(self) -> float:
        """Length of a tick in ns: USB cameras count ns, GigE cameras report a frequency (PTP changes it)."""
        per_s = self.read(_TICKS_PER_S)
        return NS_PER_S / float(per_s) if per_s else 1.0


_NO_BLOCK: Final = 2**64 - 1
"""Block number that means "not known"."""
_LAST_GIGE_BLOCK: Final = 65535
"""Last block number of a GigE camera, which is followed by 1."""


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
        self._format_and_plane: tuple[Format | None, ColourPlane | None] = (None, None)
        self._tick_ns = 0.0

    def _library_error(self) -> type[Exception]:
        return Exception

    def _is_gone(self) -> bool:
        return self._camera is not None and bool(self._camera.IsCameraDeviceRemoved())

    def open(self) -> CameraInfo:
        self.close()
        pylon = self._pylon = load_pylon()
        factory = pylon.TlFactory.GetInstance()
        devices = list(factory.EnumerateDevices())
        wanted = self._settings.serial
        chosen = [device for device in devices if wanted in (None, device.GetSerialNumber())]
        listed = "; ".join(f"{device.GetModelName()} serial {device.GetSerialNumber()}" for device in devices)
        if not chosen:
            what = "no camera is plugged in" if not devices else f"no camera has the serial number {wanted!r}"
            raise DeviceError(f"pylon: {what}; there are: {listed or 'none'}")
        if len(chosen) > 1:
            raise DeviceError(f"pylon: several cameras: {listed}; set camera.serial to one of them")
        device = chosen[0]
        self._name = f"pylon camera {device.GetModelName()} (serial {device.GetSerialNumber()})"
        with self._lock, self._translate_errors():
            camera = pylon.InstantCamera(factory.CreateDevice(device))
            camera.Open()
            self._camera = camera
            features = self._features = PylonFeatures(camera, self._name)
            pixel_format = features.choose_usable_format()
            self._emulated = device.GetDeviceClass() == "BaslerCamEmu"
            shutter = features.read("SensorShutterMode") or features.read("ShutterMode")
            return CameraInfo(
                driver="pylon",
                vendor=device.GetVendorName(),
                model=device.GetModelName(),
                serial=device.GetSerialNumber(),
                width_px=int(features.node("SensorWidth", "WidthMax").Value),
                height_px=int(features.node("SensorHeight", "HeightMax").Value),
                full_scale_dn=pixel_format.full_scale_dn,
                has_clock=not self._emulated,
                shutter=str(shutter or ""),
            )

    def start(self) -> None:
        """Start the acquisition of every frame, in order, into new buffers."""
        with self._lock, self._translate_errors():
            features, camera = self._open_device(), self._camera
            self._must_be_idle()
            self._begin((_LAST_GIGE_BLOCK,))
            self._format_and_plane = (features.present_format(), features.plane)
            self._tick_ns = 0.0 if self._emulated else features.tick_ns()
            frame_bytes = int(features.node("PayloadSize").Value)
            camera.MaxNumBuffer.Value = buffer_count(
                self._settings.buffers, features.stated_rate(), frame_bytes, 64, 4096
            )
            camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            self._run = CameraRun(self._next, camera.StopGrabbing)

    def _next(self, timeout_s: float) -> Frame | None:
        camera, run = self._camera, self._run
        if camera is None or run is None:
            return None
        result = camera.RetrieveResult(int(timeout_s * 1000) + 1, self._pylon.TimeoutHandling_Return)
        host_time_ns = time.monotonic_ns()
        if result is None or not result.IsValid():
            if not run.stopped and camera.IsCameraDeviceRemoved():
                raise CameraLost(f"{self._name}: is no longer connected; plug it in again")
            return None
        try:
            if not result.GrabSucceeded():
                self._numbers.lost_parts += 1
                self._numbers.faulty += 1
                return None
            # pylon's count of skipped images lacks other losses; the numbers of blocks show every loss
            block = int(result.GetBlockID())
            number = self._numbers.number(None if block == _NO_BLOCK else block, "dropped_by_bus")
            if number is None:
                return None
            image = np.array(result.GetArray(), copy=True)
            pixel_format, plane = self._format_and_plane
            if pixel_format is not None:
                image = plane_of(image, pixel_format.colours, plane)
            image.flags.writeable = False
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
    try:
        with warnings.catch_warnings():
            # importing its binary module raises warnings, and would fail if warnings are errors
            warnings.simplefilter("ignore")
            from pypylon import pylon
    except ImportError:
        raise MissingPackage("camera.driver = 'pylon'", "pypylon", "pylon") from None
    return pylon


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by pylon, with the transport layer as `place`."""
    devices = load_pylon().TlFactory.GetInstance().EnumerateDevices()
    return [
        PluggedCamera("pylon", device.GetModelName(), device.GetSerialNumber(), device.GetDeviceClass())
        for device in devices
    ]
