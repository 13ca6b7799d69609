"""Basler cameras through the vendor's pypylon, an optional package."""

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, Field

from acquisition.camera import (
    CameraInfo,
    CameraLost,
    CameraSettings,
    CameraStatus,
    FeatureValue,
    FrameTimeout,
    PixelFormat,
    PluggedCamera,
)
from acquisition.cameras.automatic import AUTOMATIC, BENDING, RESULTING_RATES
from acquisition.frame import Frame
from processing.errors import DeviceError

_FORMATS: Final[dict[PixelFormat, str]] = {
    "mono8": "Mono8",
    "mono10": "Mono10",
    "mono12": "Mono12",
    "mono14": "Mono14",
    "mono16": "Mono16",
}
_EXPOSURE = ("ExposureTime", "ExposureTimeAbs")
_RATE = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_POLL_MS: Final = 100
_NO_BLOCK: Final = 2**64 - 1
_GIGE_BLOCKS: Final = 65535
_MOST_MISSING: Final = 1000


class PylonSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    buffers: int = Field(default=64, ge=2, le=4096, description="frames kept for a reader that is late")


class PylonCamera:
    """A camera supported by pylon (USB3 Vision, GigE, emulation); pylon acquires and queues the frames.

    Missing numbers of blocks are counted as dropped by the bus (pylon does not say which of them found no
    buffer), damaged frames as incomplete. A camera whose timestamps are all 0 (the emulation) has no clock.
    """

    def __init__(self, settings: PylonSettings | None = None) -> None:
        self._settings = settings or PylonSettings()
        self._lock = threading.RLock()
        self._camera: Any = None
        self._pylon: Any = None
        self._name = "pylon camera"
        self._tick_ns = 0.0
        self._halted = threading.Event()
        self._started = self._was_lost = False
        self._last_block = _NO_BLOCK
        self._next = self._delivered = self._skipped = self._incomplete = self._reconnects = 0

    def open(self) -> CameraInfo:
        """Find the camera and open it."""
        self.close()
        pylon = self._pylon = _load_pylon()
        factory = pylon.TlFactory.GetInstance()
        there = list(factory.EnumerateDevices())
        wanted = self._settings.serial
        chosen = [device for device in there if wanted in (None, device.GetSerialNumber())]
        listed = "; ".join(f"{device.GetModelName()} serial {device.GetSerialNumber()}" for device in there)
        if not chosen:
            what = "no camera is plugged in" if not there else f"no camera has the serial number {wanted!r}"
            raise DeviceError(f"pylon: {what}; there are: {listed or 'none'}")
        if len(chosen) > 1:
            raise DeviceError(f"pylon: several cameras: {listed}; set camera.serial to one of them")
        device = chosen[0]
        self._name = f"pylon camera {device.GetModelName()} (serial {device.GetSerialNumber()})"
        with self._lock, self._translated():
            camera = pylon.InstantCamera(factory.CreateDevice(device))
            camera.Open()
            self._camera = camera
            camera.MaxNumBuffer.Value = self._settings.buffers
            if camera.PixelFormat.Value not in _FORMATS.values():
                camera.PixelFormat.Value = self._possible()[0][1]
            emulated = device.GetDeviceClass() == "BaslerCamEmu"
            self._tick_ns = 0.0 if emulated else self._find_tick_ns()
            bits = int(camera.PixelFormat.Value.removeprefix("Mono"))
            shutter = self._first(("SensorShutterMode", "ShutterMode"))
            return CameraInfo(
                driver="pylon",
                vendor=device.GetVendorName(),
                model=device.GetModelName(),
                serial=device.GetSerialNumber(),
                width_px=int(self._first(("SensorWidth", "WidthMax")).Value),
                height_px=int(self._first(("SensorHeight", "HeightMax")).Value),
                full_scale_dn=2**bits - 1,
                has_clock=self._tick_ns > 0,
                shutter=str(shutter.Value) if shutter is not None and shutter.IsReadable() else "",
            )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; the values returned are read back from the camera."""
        with self._lock, self._translated():
            camera = self._opened()
            if camera.IsGrabbing():
                raise DeviceError(f"{self._name}: is running; stop it before settings are changed")
            self._leave_images_alone()
            self._set_format(settings.pixel_format)
            self._set_region(settings)
            self._set_times(settings)
            self._set(("Gain",), settings.gain_db, "gain_db")
            for name, value in settings.features.items():
                self._set_feature(name, value)
            return self._readings(tuple(settings.features))

    def feature_value(self, name: str) -> FeatureValue | None:
        """Value of one feature; None if it cannot be read now."""
        with self._lock, self._translated():
            self._opened()
            node = self._first((name,))
            if node is None or not node.IsReadable():
                return None
            value: FeatureValue = node.Value
            return value

    def _leave_images_alone(self) -> None:
        """Switch off what the camera does by itself to its images, and triggers."""
        for name in AUTOMATIC:
            node = self._first((name,))
            if node is not None and node.IsWritable() and "Off" in node.Symbolics:
                node.SetValue("Off")
        for name in BENDING:
            node = self._first((name,))
            if node is not None and node.IsWritable():
                node.SetValue(False)
        selector, mode = self._first(("TriggerSelector",)), self._first(("TriggerMode",))
        if mode is None or selector is None or not selector.IsWritable():
            return
        before = selector.GetValue()
        for kind in selector.Symbolics:
            selector.SetValue(kind)
            if mode.IsWritable():
                mode.SetValue("Off")
        selector.SetValue(before)

    def _set_times(self, settings: CameraSettings) -> None:
        """Set exposure and frame rate in the order in which they fit: each limits the other."""
        exposure_us, now = settings.exposure_us, self._first(_EXPOSURE)
        first = exposure_us is None or now is None or exposure_us <= now.Value
        if first:
            self._set(_EXPOSURE, exposure_us, "exposure_us")
        if settings.frame_rate_hz is not None:
            enable = self._first(("AcquisitionFrameRateEnable",))
            if enable is not None:
                enable.Value = True
        self._set(_RATE, settings.frame_rate_hz, "frame_rate_hz")
        if not first:
            self._set(_EXPOSURE, exposure_us, "exposure_us")

    def _set_feature(self, name: str, value: FeatureValue) -> None:
        node = self._first((name,))
        if node is None:
            raise DeviceError(f"{self._name}: has no feature {name}; leave camera.features.{name} out")
        node.FromString(str(value).lower() if isinstance(value, bool) else str(value))

    def feature_values(self) -> dict[str, FeatureValue]:
        """All features that can be read now, by name."""
        with self._lock, self._translated():
            nodes = self._opened().GetNodeMap()
            found: dict[str, FeatureValue] = {}
            for node in nodes.GetNodes():
                if node.IsReadable() and hasattr(node, "ToString") and not hasattr(node, "Features"):
                    # some features say that they can be read, and fail
                    with suppress(self._pylon.GenericException):
                        found[node.GetNode().GetName()] = str(node.ToString())
            return found

    def start(self) -> None:
        """Start the acquisition of every frame, in order, into new buffers."""
        with self._lock, self._translated():
            camera = self._opened()
            if camera.IsGrabbing():
                raise DeviceError(f"{self._name}: is running already; stop it first")
            self._reconnects = self._reconnects + 1 if self._was_lost else 0
            if not self._was_lost:
                self._delivered = self._skipped = self._incomplete = 0
            self._was_lost = False
            self._next = 0
            self._last_block = _NO_BLOCK
            self._halted.clear()
            self._started = True
            camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame; see `acquisition.camera.Camera.read`."""
        if not self._started:
            raise DeviceError(f"{self._name}: is not started; call start before read")
        deadline_s = time.monotonic() + timeout_s
        while not self._halted.is_set():
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise FrameTimeout(f"{self._name}: no frame within {timeout_s:g} s; is its trigger on?")
            camera = self._camera
            if camera is None:
                return None
            frame = self._retrieve(camera, min(_POLL_MS, int(left_s * 1000) + 1))
            if frame is not None:
                return frame
        return None

    def _retrieve(self, camera: Any, patience_ms: int) -> Frame | None:
        with self._translated():
            try:
                result = camera.RetrieveResult(patience_ms, self._pylon.TimeoutHandling_Return)
            except Exception:
                if self._halted.is_set():
                    return None
                raise
            host_time_ns = time.monotonic_ns()
            if result is None or not result.IsValid():
                if not self._halted.is_set() and camera.IsCameraDeviceRemoved():
                    self._was_lost = True
                    raise CameraLost(f"{self._name}: is no longer connected; plug it in again")
                return None
            try:
                # pylon counts skipped images only where it skips; the numbers of blocks show every loss
                skipped = missing_blocks(self._last_block, int(result.GetBlockID()))
                self._last_block = int(result.GetBlockID())
                self._skipped += skipped
                number = self._next + skipped
                self._next = number + 1
                if not result.GrabSucceeded():
                    self._incomplete += 1
                    return None
                image = np.array(result.GetArray(), copy=True)
                image.flags.writeable = False
                device_time_ns = round(result.GetTimeStamp() * self._tick_ns) if self._tick_ns else -1
            finally:
                result.Release()
            self._delivered += 1
            return Frame(image, number, device_time_ns, host_time_ns)

    def stop(self) -> None:
        """Stop delivering."""
        self._halted.set()
        camera = self._camera
        if camera is not None and camera.IsGrabbing():
            camera.StopGrabbing()

    def close(self) -> None:
        """Stop and release the camera."""
        self.stop()
        with self._lock:
            camera, self._camera = self._camera, None
            if camera is not None:
                camera.Close()

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        return CameraStatus(
            delivered=self._delivered,
            dropped_by_bus=self._skipped,
            incomplete=self._incomplete,
            reconnects=self._reconnects,
        )

    def _opened(self) -> Any:
        if self._camera is None:
            raise DeviceError(f"{self._name}: is not open; call open first")
        return self._camera

    def _first(self, names: tuple[str, ...]) -> Any:
        nodes = self._opened().GetNodeMap()
        for name in names:
            node = nodes.GetNode(name)
            # newer versions return something that stands for a missing feature
            if node is not None and node.IsValid():
                return node
        return None

    def _find_tick_ns(self) -> float:
        """Length of a tick in ns: USB cameras count nanoseconds, GigE cameras report their tick frequency."""
        node = self._first(("GevTimestampTickFrequency",))
        return 1.0 if node is None else 1e9 / float(node.Value)

    def _possible(self) -> list[tuple[PixelFormat, str]]:
        there = set(self._camera.PixelFormat.Symbolics)
        found = [(ours, theirs) for ours, theirs in _FORMATS.items() if theirs in there]
        if not found:
            raise DeviceError(f"{self._name}: has no grey pixel format, only {', '.join(sorted(there))}")
        return found

    def _set_format(self, wanted: PixelFormat | None) -> None:
        if wanted is None:
            return
        there = dict(self._possible())
        if wanted not in there:
            raise DeviceError(
                f"{self._name}: pixel format {wanted} is not supported; there are {', '.join(there)}"
            )
        self._camera.PixelFormat.Value = there[wanted]

    def _set_region(self, asked: CameraSettings) -> None:
        camera = self._camera
        for axis, size, offset in (
            ("width_px", camera.Width, camera.OffsetX),
            ("height_px", camera.Height, camera.OffsetY),
        ):
            start = asked.offset_x_px if axis == "width_px" else asked.offset_y_px
            length = getattr(asked, axis)
            if start is None and length is None:
                continue
            start = int(offset.Value) if start is None else start
            length = int(size.Value) if length is None else length
            whole = int(size.Max) + int(offset.Value)
            if start + length > whole:
                raise DeviceError(
                    f"{self._name}: {axis} with its offset reaches {start + length}; the sensor has {whole}"
                )
            offset.Value = offset.Min
            size.Value = length
            offset.Value = start

    def _set(self, names: tuple[str, ...], wanted: float | None, key: str) -> None:
        if wanted is None:
            return
        node = self._first(names)
        if node is None:
            raise DeviceError(f"{self._name}: has no {names[0]}; leave camera.{key} out")
        if not node.Min <= wanted <= node.Max:
            raise DeviceError(
                f"{self._name}: {key} = {wanted:g} is out of range; {node.Min:g} to {node.Max:g} are possible"
            )
        node.Value = wanted

    def _readings(self, features: tuple[str, ...] = ()) -> CameraSettings:
        camera = self._camera

        def value(names: tuple[str, ...]) -> float | None:
            node = self._first(names)
            if node is None or not node.IsReadable():
                return None
            return float(node.Value) if node.Value > 0 else None

        gain = self._first(("Gain",))
        by_name = {theirs: ours for ours, theirs in _FORMATS.items()}
        return CameraSettings(
            exposure_us=value(_EXPOSURE),
            gain_db=None if gain is None else float(gain.Value),
            frame_rate_hz=min(filter(None, (value(_RATE), value(RESULTING_RATES))), default=None),
            pixel_format=by_name[camera.PixelFormat.Value],
            width_px=int(camera.Width.Value),
            height_px=int(camera.Height.Value),
            offset_x_px=int(camera.OffsetX.Value),
            offset_y_px=int(camera.OffsetY.Value),
            features={name: self._first((name,)).ToString() for name in features},
        )

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Convert pylon's errors into DeviceError, those of an unplugged camera into CameraLost."""
        try:
            yield
        except DeviceError:
            raise
        except Exception as error:
            text = " ".join(str(error).split())
            gone: Callable[[], bool] = getattr(self._camera, "IsCameraDeviceRemoved", lambda: False)
            if gone():
                self._was_lost = True
                raise CameraLost(f"{self._name}: is no longer connected; plug it in again ({text})") from None
            raise DeviceError(f"{self._name}: {text}") from None


def missing_blocks(last: int, block: int) -> int:
    """Number of blocks between two numbers; GigE cameras count from 65535 to 1, USB cameras on.

    0 for numbers that pylon does not know, and after a counter that began anew.
    """
    if _NO_BLOCK in (last, block):
        return 0
    if block > last:
        return block - last - 1
    past_end = block + _GIGE_BLOCKS - last
    return past_end - 1 if 0 < past_end <= _MOST_MISSING else 0


def _load_pylon() -> Any:
    try:
        with warnings.catch_warnings():
            # importing its binary module raises warnings, and would fail if warnings are errors
            warnings.simplefilter("ignore")
            from pypylon import pylon
    except ImportError:
        raise DeviceError(
            "camera.driver = 'pylon' needs the package pypylon: pip install 'optical-pendulum-rig[pylon]'"
        ) from None
    return pylon


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by pylon, with the transport layer as `place`."""
    devices = _load_pylon().TlFactory.GetInstance().EnumerateDevices()
    return [
        PluggedCamera("pylon", device.GetModelName(), device.GetSerialNumber(), device.GetDeviceClass())
        for device in devices
    ]
