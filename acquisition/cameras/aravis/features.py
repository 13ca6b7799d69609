"""Camera features used by the rig, through libaravis's functions for them."""

from contextlib import suppress
from typing import Any

from acquisition.camera import CameraSettings, FeatureValue, PixelFormat
from acquisition.cameras.automatic import AUTOMATIC, BENDING
from acquisition.cameras.pixel_formats import BY_NAME, FORMATS, Format
from processing.errors import DeviceError


class AravisFeatures:
    """Features of an open camera; `camera` is libaravis's object.

    Methods raise DeviceError for values that the camera does not support; libaravis's errors are passed on.
    """

    def __init__(self, camera: Any, aravis: Any, name: str) -> None:
        self.camera = camera
        self._aravis = aravis
        self._name = name

    def give_up(self) -> list[Any]:
        """Return libaravis's camera in a list, no longer held here: dropping the last reference may block."""
        camera, self.camera = self.camera, None
        return [camera]

    def sensor_size(self) -> tuple[int, int]:
        """(width, height) of the sensor."""
        width_px, height_px = self.camera.get_sensor_size()
        return int(width_px), int(height_px)

    def region(self) -> tuple[int, int, int, int]:
        """(x, y, width, height) of the frames."""
        x, y, width_px, height_px = self.camera.get_region()
        return int(x), int(y), int(width_px), int(height_px)

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None; return all settings as read back."""
        self._leave_images_alone()
        if settings.pixel_format is not None:
            self._set_format(settings.pixel_format)
        self._set_region(settings)
        camera = self.camera
        self._set_times(settings)
        if settings.gain_db is not None:
            self._need(camera.is_gain_available(), "gain_db")
            self._check("gain_db", settings.gain_db, camera.get_gain_bounds())
            camera.set_gain(settings.gain_db)
        device = camera.get_device()
        for name, value in settings.features.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            device.set_features_from_string(f"{name}={text}")
        return self.read_back(tuple(settings.features))

    def _leave_images_alone(self) -> None:
        """Switch off what the camera does by itself to its images."""
        camera, off = self.camera, self._aravis.Auto.OFF
        if camera.is_exposure_auto_available():
            camera.set_exposure_time_auto(off)
        if camera.is_gain_auto_available():
            camera.set_gain_auto(off)
        for name in AUTOMATIC:
            if camera.is_feature_available(name) and "Off" in camera.dup_available_enumerations_as_strings(
                name
            ):
                camera.set_string(name, "Off")
        for name in BENDING:
            if camera.is_feature_available(name):
                camera.set_boolean(name, False)

    def _set_times(self, settings: CameraSettings) -> None:
        """Set exposure and frame rate in the order in which they fit: each limits the other."""
        camera, exposure_us = self.camera, settings.exposure_us
        if exposure_us is not None:
            self._need(camera.is_exposure_time_available(), "exposure_us")
        first = exposure_us is None or exposure_us <= camera.get_exposure_time()
        if first:
            self._set_exposure(exposure_us)
        if settings.frame_rate_hz is not None:
            self._need(camera.is_frame_rate_available(), "frame_rate_hz")
            self._check("frame_rate_hz", settings.frame_rate_hz, camera.get_frame_rate_bounds())
            camera.set_frame_rate(settings.frame_rate_hz)
        if not first:
            self._set_exposure(exposure_us)

    def _set_exposure(self, exposure_us: float | None) -> None:
        if exposure_us is not None:
            self._check("exposure_us", exposure_us, self.camera.get_exposure_time_bounds())
            self.camera.set_exposure_time(exposure_us)

    def read_back(self, features: tuple[str, ...] = ()) -> CameraSettings:
        """The camera's present settings, and these `features`; None for those that it does not have."""
        camera = self.camera
        x, y, width_px, height_px = self.region()
        exposure_us = camera.get_exposure_time() if camera.is_exposure_time_available() else 0.0
        rate_hz = camera.get_frame_rate() if camera.is_frame_rate_available() else 0.0
        return CameraSettings(
            exposure_us=exposure_us if exposure_us > 0 else None,
            gain_db=camera.get_gain() if camera.is_gain_available() else None,
            frame_rate_hz=rate_hz if rate_hz > 0 else None,
            pixel_format=self.pixel_format().pixel_format,
            width_px=width_px,
            height_px=height_px,
            offset_x_px=x,
            offset_y_px=y,
            features={name: self.text(name) for name in features},
        )

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        """All features that can be read now; `error` is raised by libaravis for those that cannot."""
        found: dict[str, FeatureValue] = {}
        waiting = ["Root"]
        genicam = self.camera.get_device().get_genicam()
        while waiting:
            name = waiting.pop()
            node = genicam.get_node(name)
            if isinstance(node, self._aravis.GcCategory):
                waiting += node.get_features()
                continue
            with suppress(error, AttributeError):
                if not isinstance(node, self._aravis.GcCommand) and node.is_available():
                    found[name] = str(node.get_value_as_string())
        return found

    def text(self, name: str) -> str:
        """A feature's value as text."""
        return str(self.camera.get_device().get_feature(name).get_value_as_string())

    def run_freely(self) -> None:
        """Select continuous acquisition without a trigger."""
        self.camera.clear_triggers()
        self.camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)

    def pixel_format(self) -> Format:
        """The present pixel format; DeviceError if the rig does not support it."""
        name = self.camera.get_pixel_format_as_string()
        if name not in BY_NAME:
            raise DeviceError(
                f"{self._name}: pixel format {name} can't be used; there are {', '.join(self._depths())}"
            )
        return BY_NAME[name]

    def choose_usable_format(self) -> Format:
        """Keep the present pixel format if the rig supports it; otherwise set the first supported one."""
        if self.camera.get_pixel_format_as_string() not in BY_NAME:
            self._set_format(next(iter(self._depths())))
        return self.pixel_format()

    def _depths(self) -> dict[PixelFormat, str]:
        """The available bit depths, with the camera's name of each."""
        there = set(self.camera.dup_available_pixel_formats_as_strings())
        usable: dict[PixelFormat, str] = {}
        for one in FORMATS:
            if one.name in there:
                usable.setdefault(one.pixel_format, one.name)
        if not usable:
            raise DeviceError(f"{self._name}: has no grey pixel format, only {', '.join(sorted(there))}")
        return usable

    def _set_format(self, wanted: PixelFormat) -> None:
        depths = self._depths()
        if wanted not in depths:
            raise DeviceError(
                f"{self._name}: pixel format {wanted} is not supported; there are {', '.join(depths)}"
            )
        self.camera.set_pixel_format_from_string(depths[wanted])

    def _set_region(self, asked: CameraSettings) -> None:
        wanted = (asked.offset_x_px, asked.offset_y_px, asked.width_px, asked.height_px)
        if all(value is None for value in wanted):
            return
        x, y, width_px, height_px = (
            now if value is None else value for value, now in zip(wanted, self.region(), strict=True)
        )
        for key, end, size in zip(
            ("width_px", "height_px"), (x + width_px, y + height_px), self.sensor_size(), strict=True
        ):
            if end > size:
                raise DeviceError(f"{self._name}: {key} with its offset reaches {end}; the sensor has {size}")
        self.camera.set_region(x, y, width_px, height_px)

    def _need(self, available: bool, key: str) -> None:
        if not available:
            raise DeviceError(f"{self._name}: does not let it be set; leave camera.{key} out")

    def _check(self, key: str, wanted: float, bounds: tuple[float, float]) -> None:
        # libaravis clips values out of range without an error
        low, high = bounds
        if not low <= wanted <= high:
            raise DeviceError(
                f"{self._name}: {key} = {wanted:g} is out of range; {low:g} to {high:g} are possible"
            )
