"""Video4Linux cameras as a `Camera`, read by the kernel's calls."""

import contextlib
import errno
import math
import mmap
import os
import re
import select
import sys
import time
from collections.abc import Iterable

from acquisition.camera import (
    BITS_OF_FORMAT,
    CameraInfo,
    CameraLost,
    CameraSettings,
    ColourPlane,
    FeatureValue,
    Frame,
    refuse_unsupported,
)
from acquisition.cameras.drivers import V4l2Settings, buffer_count
from acquisition.cameras.pixel_formats import preferred_name, region_to_plane_px, region_to_sensor_px
from acquisition.cameras.reading import CameraRun, DeviceCamera, check_end, check_range
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.devices import (
    LAYOUTS,
    VideoDevice,
    find_again,
    find_device,
    image_bytes,
    refusal,
    to_image,
)
from acquisition.frames.losses import BlockNumbers
from processing.errors import DeviceError

_MIN_BUFFERS, _MAX_BUFFERS = 4, 32
_EXPOSURE_STEP_US = 100.0
"""The kernel's unit of V4L2_CID_EXPOSURE_ABSOLUTE."""


class V4l2Camera(DeviceCamera["LinuxSource"]):
    """A UVC or other Video4Linux camera, on Linux.

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
            self._features, self._last_device = source, source.device
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


class LinuxSource:
    """A `device`, used by one thread at a time. Timestamps are the driver's, on the host's monotonic clock.

    A device that was `known` before is found again by its name and serial number, and not by its device
    number.
    """

    def __init__(self, settings: V4l2Settings, known: VideoDevice | None = None) -> None:
        self._settings = settings
        self.device = known
        self._descriptor = -1
        self._name = "video device"
        self._layout = kernel.PixelLayout(0, 0, "", 0)
        self._maps: list[mmap.mmap] = []
        self._started_ns = 0
        self._last_ns = 0
        self._last_sequence: int | None = None
        self._queued_ns: list[int] = []
        self._bounds: kernel.Rectangle | None = None
        self._plane: ColourPlane | None = None

    def open(self) -> CameraInfo:
        """Find and open the device; if its format is not supported, set the preferred one that it offers."""
        if self.device is None:
            device = find_device(self._settings.device, self._settings.serial)
        else:
            device = find_again(self.device)
        self._name = f"{device.path} ({device.name})"
        try:
            self._descriptor = kernel.open_device(device.path)
            offered = kernel.formats(self._descriptor)
            fourcc = next((code for code in LAYOUTS if code in offered), None)
            if fourcc is None:
                raise DeviceError(
                    f"{self._name}: offers {', '.join(code.strip() for code in offered)}; none is grey "
                    f"or has its luminance uncompressed ({', '.join(code.strip() for code in LAYOUTS)})"
                )
            present = kernel.get_layout(self._descriptor)
            if present.fourcc not in LAYOUTS:
                present = kernel.set_layout(self._descriptor, present.width_px, present.height_px, fourcc)
            driver = kernel.capabilities(self._descriptor).driver
        except OSError as error:
            self.close()
            raise DeviceError(refusal(self._name, error)) from None
        except DeviceError:
            self.close()
            raise
        self.device, self._layout = device, present
        region = kernel.get_selection(self._descriptor, kernel.CROP)
        self._bounds = None if region is None else kernel.get_selection(self._descriptor, kernel.CROP_BOUNDS)
        return CameraInfo(
            driver="v4l2",
            vendor=device.bus,
            model=device.name,
            serial=device.serial,
            width_px=self._bounds.width if self._bounds else present.width_px,
            height_px=self._bounds.height if self._bounds else present.height_px,
            full_scale_dn=2 ** BITS_OF_FORMAT[LAYOUTS[present.fourcc].depth] - 1,
            has_clock=True,
            # UVC cameras state when an exposure began, all others when its last pixel has arrived
            stamped="start" if driver == "uvcvideo" else "end",
        )

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings, in an order in which no setting changes an earlier one."""
        refuse_unsupported(settings, self._name, supported=("colour_plane", "features"))
        self._plane = settings.colour_plane or self._plane
        settings = region_to_sensor_px(settings.model_copy(update={"colour_plane": self._plane}))
        try:
            self._switch_off_processing()
            self._set_layout(settings)
            self._set_exposure(settings)
            self._set_gain(settings)
            if settings.frame_rate_hz is not None:
                kernel.set_rate_hz(self._descriptor, settings.frame_rate_hz)
            for name, value in settings.features.items():
                self._set_feature(name, value)
            return region_to_plane_px(self._readings(settings.features), self._plane)
        except OSError as error:
            raise self._failure(error) from None

    def start(self) -> None:
        """Map the buffers, give them all to the driver, start the stream."""
        try:
            rate_hz = kernel.get_rate_hz(self._descriptor)
            wanted = buffer_count(
                rate_hz if math.isfinite(rate_hz) else None,
                image_bytes(self._layout),
                _MIN_BUFFERS,
                _MAX_BUFFERS,
            )
            count = kernel.request_buffers(self._descriptor, wanted)
            for index in range(count):
                offset, length = kernel.buffer_place(self._descriptor, index)
                self._maps.append(
                    mmap.mmap(self._descriptor, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)
                )
                kernel.queue(self._descriptor, index)
            self._started_ns = self._last_ns = time.monotonic_ns()
            self._last_sequence, self._queued_ns = None, [0] * count
            kernel.stream(self._descriptor, True)
        except OSError as error:
            self.stop()
            raise self._failure(error) from None

    def next(self, timeout_s: float, numbers: BlockNumbers) -> Frame | None:
        """The next frame, copied, with its number from `numbers`; None if no complete frame has come.

        The driver fills buffers in the order in which it received them. If it received this frame's buffer
        only after the frame before had arrived, it had no buffer for the frames in between.
        """
        try:
            poll = select.poll()
            poll.register(self._descriptor, select.POLLIN)
            if not poll.poll(math.ceil(timeout_s * 1000)):
                return None
            filled = kernel.dequeue(self._descriptor)
            if filled is None:
                return None
            host_time_ns = time.monotonic_ns()
            stale = filled.time_ns < self._started_ns
            complete = not filled.flags & kernel.FLAG_ERROR and filled.bytes_used >= image_bytes(self._layout)
            image = None
            if complete and not stale:
                with memoryview(self._maps[filled.buffer]) as data:
                    image = to_image(data, self._layout, self._plane)
            no_buffer = self._queued_ns[filled.buffer] > self._last_ns
            self._last_ns = filled.time_ns
            kernel.queue(self._descriptor, filled.buffer)
            self._queued_ns[filled.buffer] = time.monotonic_ns()
        except OSError as error:
            raise self._failure(error) from None
        if stale:
            return None
        if image is None:
            numbers.lose_faulty()
            return None
        # a driver that gives all frames the same number does not count them
        block = None if filled.sequence == self._last_sequence else filled.sequence
        self._last_sequence = filled.sequence
        number = numbers.number(block, "dropped_by_host" if no_buffer else "dropped_by_bus")
        return None if number is None else Frame(image, number, filled.time_ns, host_time_ns)

    def stop(self) -> None:
        """Stop the stream and free the buffers; errors of an unplugged device are ignored."""
        with contextlib.suppress(OSError):
            kernel.stream(self._descriptor, False)
        with contextlib.suppress(OSError):
            for mapped in self._maps:
                mapped.close()
            self._maps = []
            kernel.request_buffers(self._descriptor, 0)

    def close(self) -> None:
        if self._descriptor >= 0:
            self.stop()
            os.close(self._descriptor)
            self._descriptor = -1

    def _controls(self) -> dict[int, kernel.Control]:
        return {control.number: control for control in kernel.controls(self._descriptor)}

    def _switch_off_processing(self) -> None:
        """Switch off the camera's automatic changes of images, whether or not settings replace them."""
        available = self._controls()
        for number, value in kernel.AUTOMATIC.items():
            if number in available and available[number].can_be_set:
                kernel.set_control(self._descriptor, number, value)

    def _set_feature(self, name: str, value: FeatureValue) -> None:
        available = {_key(control.name): control for control in kernel.controls(self._descriptor)}
        control = available.get(_key(name))
        if control is None:
            raise DeviceError(
                f"{self._name}: has no control {name}; there are {', '.join(sorted(available)) or 'none'}"
            )
        if isinstance(value, str):
            raise DeviceError(f"{self._name}: {name} = {value!r} is not a number")
        check_range(self._name, name, value, control.lowest, control.highest)
        kernel.set_control(self._descriptor, control.number, int(value))

    def feature_values(self) -> dict[str, FeatureValue]:
        """All controls that can be read now, by name."""
        values: dict[str, FeatureValue] = {}
        for control in kernel.controls(self._descriptor):
            with contextlib.suppress(OSError):
                values[_key(control.name)] = kernel.get_control(self._descriptor, control.number)
        return values

    def _set_layout(self, settings: CameraSettings) -> None:
        offered = kernel.formats(self._descriptor)
        fourcc = self._layout.fourcc
        wanted, present = settings.pixel_format, LAYOUTS[fourcc]
        if wanted not in (None, present.depth) or bool(present.colours) != bool(self._plane):
            fourcc = preferred_name(self._name, offered, wanted, self._plane, LAYOUTS)
        width_px = settings.width_px or self._layout.width_px
        height_px = settings.height_px or self._layout.height_px
        if self._bounds is not None:
            region = self._set_region(self._bounds, settings)
            # the format must have the region's size, because a driver scales the region to any other
            width_px, height_px = region.width, region.height
        elif settings.offset_x_px or settings.offset_y_px:
            raise DeviceError(
                f"{self._name}: has no region of interest; leave the offsets out; its sizes: "
                + ", ".join(f"{wide} x {high}" for wide, high in kernel.sizes(self._descriptor, fourcc))
            )
        self._layout = kernel.set_layout(self._descriptor, width_px, height_px, fourcc)
        if self._layout.fourcc != fourcc:
            raise DeviceError(
                f"{self._name}: format {fourcc} was requested, the camera set {self._layout.fourcc}; "
                "set camera.pixel_format to another one"
            )
        applied = (self._layout.width_px, self._layout.height_px)
        if self._bounds is not None and applied != (width_px, height_px):
            raise DeviceError(
                f"{self._name}: scales a region of {width_px} x {height_px} to {applied[0]} x {applied[1]}; "
                "set camera.width_px and camera.height_px to another size"
            )

    def _set_region(self, bounds: kernel.Rectangle, settings: CameraSettings) -> kernel.Rectangle:
        present = kernel.get_selection(self._descriptor, kernel.CROP) or bounds
        requested = kernel.Rectangle(
            present.left if settings.offset_x_px is None else settings.offset_x_px,
            present.top if settings.offset_y_px is None else settings.offset_y_px,
            settings.width_px or present.width,
            settings.height_px or present.height,
        )
        check_end(self._name, "width_px", requested.left, requested.width, bounds.width)
        check_end(self._name, "height_px", requested.top, requested.height, bounds.height)
        if requested == present:
            return present
        kernel.set_selection(self._descriptor, requested)
        return kernel.get_selection(self._descriptor, kernel.CROP) or requested

    def _set_exposure(self, settings: CameraSettings) -> None:
        if settings.exposure_us is None:
            return
        exposure = self._controls().get(kernel.EXPOSURE_ABSOLUTE)
        if exposure is None:
            raise DeviceError(f"{self._name}: has no exposure time; leave camera.exposure_us out")
        steps = round(settings.exposure_us / _EXPOSURE_STEP_US)
        low_us, high_us = exposure.lowest * _EXPOSURE_STEP_US, exposure.highest * _EXPOSURE_STEP_US
        check_range(self._name, "exposure_us", settings.exposure_us, low_us, high_us)
        kernel.set_control(self._descriptor, kernel.EXPOSURE_ABSOLUTE, steps)

    def _set_gain(self, settings: CameraSettings) -> None:
        if settings.gain_db is not None:
            raise DeviceError(
                f"{self._name}: its gain has steps of its own, not decibels; set camera.v4l2.gain instead"
            )
        wanted = self._settings.gain
        if wanted is None:
            return
        gain = self._controls().get(kernel.GAIN)
        if gain is None:
            raise DeviceError(f"{self._name}: has no gain; leave camera.v4l2.gain out")
        check_range(self._name, "gain", wanted, gain.lowest, gain.highest)
        kernel.set_control(self._descriptor, kernel.GAIN, wanted)
        applied = kernel.get_control(self._descriptor, kernel.GAIN)
        if applied != wanted:
            raise DeviceError(f"{self._name}: gain = {wanted} was requested, the camera set {applied}")

    def _readings(self, features: Iterable[str]) -> CameraSettings:
        region = kernel.get_selection(self._descriptor, kernel.CROP) if self._bounds else None
        rate_hz = kernel.get_rate_hz(self._descriptor)
        exposure_us = None
        if kernel.EXPOSURE_ABSOLUTE in self._controls():
            steps = kernel.get_control(self._descriptor, kernel.EXPOSURE_ABSOLUTE)
            exposure_us = max(steps * _EXPOSURE_STEP_US, 1e-3)
        return CameraSettings(
            exposure_us=exposure_us,
            frame_rate_hz=None if math.isnan(rate_hz) else rate_hz,
            pixel_format=LAYOUTS[self._layout.fourcc].depth,
            width_px=self._layout.width_px,
            height_px=self._layout.height_px,
            offset_x_px=region.left if region else 0,
            offset_y_px=region.top if region else 0,
            features={name: self.feature_values().get(_key(name), "") for name in features},
        )

    def _failure(self, error: OSError) -> DeviceError:
        if error.errno in (errno.ENODEV, errno.ENXIO, errno.EIO, errno.EBADF):
            return CameraLost(f"{self._name}: is no longer connected ({error.strerror}); plug it in again")
        return DeviceError(refusal(self._name, error))


def _key(name: str) -> str:
    """A control's name as v4l2-ctl writes it: "White Balance, Automatic" is white_balance_automatic."""
    return re.sub("[^a-z0-9]+", "_", name.lower()).strip("_")
