"""Camera features used by the rig, through libaravis's functions for them."""

from contextlib import suppress
from typing import Any

from acquisition.camera import CameraSettings, ColourPlane, FeatureValue, PixelFormat
from acquisition.cameras import preparation, wiring
from acquisition.cameras.colour_plane import format_of, in_sensor_px, preferred_names
from acquisition.cameras.pixel_formats import Format
from acquisition.cameras.preparation import RESULTING_RATES, binning_of
from processing.errors import DeviceError


class AravisFeatures:
    """Features of an open camera; `camera` is libaravis's object.

    Methods raise DeviceError for values that the camera does not support; libaravis's errors are passed on.
    """

    def __init__(self, camera: Any, aravis: Any, name: str) -> None:
        self.camera = camera
        self._aravis = aravis
        self.name = name
        self._asked = CameraSettings()

    @property
    def plane(self) -> ColourPlane | None:
        """The colour that is read, of a sensor with a Bayer mosaic."""
        return self._asked.colour_plane

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
        self._asked = preparation.prepare(self, settings, self._asked)
        settings = in_sensor_px(self._asked)
        if settings.pixel_format is not None:
            self._set_format(settings.pixel_format)
        elif self._format() is None:
            self._set_format(next(iter(self._depths())))
        self._set_region(settings)
        camera = self.camera
        if settings.trigger is None:
            self._set_times(settings)
        else:
            self._set_exposure(settings.exposure_us)
            if self.writable("AcquisitionFrameRateEnable"):
                self.write("AcquisitionFrameRateEnable", False)
        if settings.gain_db is not None:
            self._need(camera.is_gain_available(), "gain_db")
            self._check("gain_db", settings.gain_db, camera.get_gain_bounds())
            camera.set_gain(settings.gain_db)
        for name, value in settings.features.items():
            self.write(name, value)
        applied = self.read_back(tuple(settings.features))
        return preparation.as_prepared(self, applied, settings, self._possible_rate())

    # ---- as named_features.NamedFeatures

    def writable(self, feature: str) -> bool:
        """Whether the camera has the feature and it can be set now."""
        if not self.camera.is_feature_available(feature):
            return False
        node = self.camera.get_device().get_feature(feature)
        read_only = node.get_actual_access_mode() == self._aravis.GcAccessMode.RO
        return not (read_only or node.is_locked())

    def choices(self, feature: str) -> tuple[str, ...]:
        """Values that an enumeration takes now; none for other features."""
        node = self.camera.get_device().get_feature(feature)
        if not isinstance(node, self._aravis.GcEnumeration) or not node.is_available():
            return ()
        return tuple(self.camera.dup_available_enumerations_as_strings(feature))

    def read(self, feature: str) -> FeatureValue | None:
        """Value of a feature as text; None if it cannot be read now."""
        return self.text(feature) if self.camera.is_feature_available(feature) else None

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature, or run a command."""
        if isinstance(self.camera.get_device().get_feature(feature), self._aravis.GcCommand):
            self.camera.execute_command(feature)
            return
        text = str(value).lower() if isinstance(value, bool) else str(value)
        self.camera.get_device().set_features_from_string(f"{feature}={text}")

    # ---- inside

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
        possible_hz = self._possible_rate()
        return CameraSettings(
            exposure_us=exposure_us if exposure_us > 0 else None,
            gain_db=camera.get_gain() if camera.is_gain_available() else None,
            frame_rate_hz=min(filter(None, (rate_hz, possible_hz)), default=None),
            pixel_format=self.pixel_format().pixel_format,
            binning=binning_of(self),
            width_px=width_px,
            height_px=height_px,
            offset_x_px=x,
            offset_y_px=y,
            features={name: self.text(name) for name in features},
        )

    def _possible_rate(self) -> float | None:
        """Frames per second that exposure, size and bus leave, if the camera says it."""
        for name in RESULTING_RATES:
            if self.camera.is_feature_available(name):
                return float(self.text(name))
        return None

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        """All features that can be read now; `error` is raised by libaravis for those that cannot."""
        wiring.latch_clock_state(self)
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

    def run_on(self) -> None:
        """Select continuous acquisition, without a trigger unless one was asked for."""
        if not preparation.waits(self._asked):
            self.camera.clear_triggers()
        self.camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)

    def pixel_format(self) -> Format:
        """The present pixel format; DeviceError if the rig does not support it."""
        found = self._format()
        if found is None:
            name = self.camera.get_pixel_format_as_string()
            raise DeviceError(
                f"{self.name}: pixel format {name} can't be used; there are {', '.join(self._depths())}"
            )
        return found

    def choose_usable_format(self) -> Format:
        """Keep the present pixel format if the rig supports it, of a mosaic, too; otherwise set the first
        supported one.
        """
        mosaic = format_of(self.camera.get_pixel_format_as_string(), "red")
        if mosaic is not None:
            return mosaic
        if self._format() is None:
            self._set_format(next(iter(self._depths())))
        return self.pixel_format()

    def _format(self) -> Format | None:
        return format_of(self.camera.get_pixel_format_as_string(), self.plane)

    def _depths(self) -> dict[PixelFormat, str]:
        """The available bit depths, with the camera's name of each."""
        return preferred_names(self.name, self.camera.dup_available_pixel_formats_as_strings(), self.plane)

    def _set_format(self, wanted: PixelFormat) -> None:
        depths = self._depths()
        if wanted not in depths:
            raise DeviceError(
                f"{self.name}: pixel format {wanted} is not supported; there are {', '.join(depths)}"
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
                raise DeviceError(f"{self.name}: {key} with its offset reaches {end}; the sensor has {size}")
        self.camera.set_region(x, y, width_px, height_px)

    def _need(self, available: bool, key: str) -> None:
        if not available:
            raise DeviceError(f"{self.name}: does not let it be set; leave camera.{key} out")

    def _check(self, key: str, wanted: float, bounds: tuple[float, float]) -> None:
        # libaravis clips values out of range without an error
        low, high = bounds
        if not low <= wanted <= high:
            raise DeviceError(
                f"{self.name}: {key} = {wanted:g} is out of range; {low:g} to {high:g} are possible"
            )
