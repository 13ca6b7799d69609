"""Camera features used by the rig, through pylon's nodes."""

from contextlib import suppress
from typing import Any, Final

from acquisition.camera import CameraSettings, ColourPlane, FeatureValue, PixelFormat
from acquisition.cameras import preparation, wiring
from acquisition.cameras.colour_plane import format_of, in_sensor_px, preferred_names
from acquisition.cameras.pixel_formats import Format
from acquisition.cameras.preparation import RESULTING_RATES, binning_of
from processing.errors import DeviceError
from processing.ticks import NS_PER_S

_EXPOSURE: Final = ("ExposureTime", "ExposureTimeAbs")
_RATE: Final = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_RATE_SWITCH: Final = "AcquisitionFrameRateEnable"
_TICKS_PER_S: Final = "GevTimestampTickFrequency"


class PylonFeatures:
    """Features of an open camera; `camera` is pylon's object, `name` the camera's in messages.

    Methods raise DeviceError for values that the camera does not support; pylon's errors are passed on.
    """

    def __init__(self, camera: Any, name: str) -> None:
        self._camera = camera
        self._nodes = camera.GetNodeMap()
        self.name = name
        self._asked = CameraSettings()

    @property
    def plane(self) -> ColourPlane | None:
        """The colour that is read, of a sensor with a Bayer mosaic."""
        return self._asked.colour_plane

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None; return all settings as read back."""
        self._asked = preparation.prepare(self, settings, self._asked)
        settings = in_sensor_px(self._asked)
        self._set_format(settings.pixel_format)
        self._set_region(settings)
        self._set_times(settings)
        self._set(("Gain",), settings.gain_db, "gain_db")
        for name, value in settings.features.items():
            if self.node(name) is None:
                raise DeviceError(f"{self.name}: has no feature {name}; leave camera.features.{name} out")
            self.write(name, value)
        return self._readings(settings)

    # ---- as named_features.NamedFeatures

    def writable(self, feature: str) -> bool:
        """Whether the camera has the feature and it can be set now."""
        node = self.node(feature)
        return node is not None and bool(node.IsWritable())

    def choices(self, feature: str) -> tuple[str, ...]:
        """Values that an enumeration takes now; none for other features."""
        return tuple(getattr(self.node(feature), "Symbolics", ()))

    def read(self, feature: str) -> FeatureValue | None:
        """Value of a feature; None if it cannot be read now."""
        node = self.node(feature)
        if node is None or not node.IsReadable():
            return None
        value: FeatureValue = node.Value
        return value

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature, or run a command."""
        node = self.node(feature)
        if hasattr(node, "Execute"):
            node.Execute()
        else:
            node.FromString(str(value).lower() if isinstance(value, bool) else str(value))

    # ---- for the driver

    def node(self, *names: str) -> Any:
        """The first of these features that the camera has, as pylon's node; None if it has none of them."""
        for name in names:
            node = self._nodes.GetNode(name)
            # newer versions return something that stands for a missing feature
            if node is not None and node.IsValid():
                return node
        return None

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        """All features that can be read now; `error` is raised by pylon for those that cannot."""
        wiring.latch_clock_state(self)
        found: dict[str, FeatureValue] = {}
        for node in self._nodes.GetNodes():
            if node.IsReadable() and hasattr(node, "ToString") and not hasattr(node, "Features"):
                # some features say that they can be read, and fail
                with suppress(error):
                    found[node.GetNode().GetName()] = str(node.ToString())
        return found

    def tick_ns(self) -> float:
        """Length of a tick in ns: USB cameras count nanoseconds, GigE cameras report their tick frequency,
        which another clock changes.
        """
        per_s = self.read(_TICKS_PER_S)
        return NS_PER_S / float(per_s) if per_s else 1.0

    def choose_usable_format(self) -> Format:
        """Keep the present pixel format if the rig supports it, of a mosaic, too; otherwise set the first
        supported one.
        """
        mosaic = format_of(self._camera.PixelFormat.Value, "red")
        if mosaic is not None:
            return mosaic
        if self.pixel_format() is None:
            self._camera.PixelFormat.Value = next(iter(self._possible().values()))
        found = self.pixel_format()
        assert found is not None
        return found

    def pixel_format(self) -> Format | None:
        """The present pixel format, if the rig supports it."""
        return format_of(self._camera.PixelFormat.Value, self.plane)

    # ---- inside

    def _possible(self) -> dict[PixelFormat, str]:
        there = self._camera.PixelFormat.Symbolics
        # pylon makes arrays of whole words only
        whole = [name for name in there if not name.endswith(("p", "Packed"))]
        return preferred_names(self.name, whole, self.plane)

    def _set_format(self, wanted: PixelFormat | None) -> None:
        if wanted is None and self.pixel_format() is not None:
            return
        there = self._possible()
        wanted = wanted or next(iter(there))
        if wanted not in there:
            raise DeviceError(
                f"{self.name}: pixel format {wanted} is not supported; there are {', '.join(there)}"
            )
        self._camera.PixelFormat.Value = there[wanted]

    def _set_times(self, settings: CameraSettings) -> None:
        """Set exposure and frame rate in the order in which they fit: each limits the other."""
        if settings.trigger is not None:
            if self.writable(_RATE_SWITCH):
                self.write(_RATE_SWITCH, False)
            self._set(_EXPOSURE, settings.exposure_us, "exposure_us")
            return
        exposure_us, now = settings.exposure_us, self.node(*_EXPOSURE)
        first = exposure_us is None or now is None or exposure_us <= now.Value
        if first:
            self._set(_EXPOSURE, exposure_us, "exposure_us")
        if settings.frame_rate_hz is not None and self.node(_RATE_SWITCH) is not None:
            self.write(_RATE_SWITCH, True)
        self._set(_RATE, settings.frame_rate_hz, "frame_rate_hz")
        if not first:
            self._set(_EXPOSURE, exposure_us, "exposure_us")

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
                    f"{self.name}: {axis} with its offset reaches {start + length}; the sensor has {whole}"
                )
            offset.Value = offset.Min
            size.Value = length
            offset.Value = start

    def _set(self, names: tuple[str, ...], wanted: float | None, key: str) -> None:
        if wanted is None:
            return
        node = self.node(*names)
        if node is None:
            raise DeviceError(f"{self.name}: has no {names[0]}; leave camera.{key} out")
        if not node.Min <= wanted <= node.Max:
            raise DeviceError(
                f"{self.name}: {key} = {wanted:g} is out of range; {node.Min:g} to {node.Max:g} are possible"
            )
        node.Value = wanted

    def _positive(self, names: tuple[str, ...]) -> float | None:
        node = self.node(*names)
        if node is None or not node.IsReadable():
            return None
        return float(node.Value) if node.Value > 0 else None

    def _readings(self, settings: CameraSettings) -> CameraSettings:
        camera, gain, possible_hz = self._camera, self.node("Gain"), self._positive(RESULTING_RATES)
        rate_hz = min(filter(None, (self._positive(_RATE), possible_hz)), default=None)
        pixel_format = self.pixel_format()
        applied = CameraSettings(
            exposure_us=self._positive(_EXPOSURE),
            gain_db=None if gain is None else float(gain.Value),
            frame_rate_hz=rate_hz,
            pixel_format=None if pixel_format is None else pixel_format.pixel_format,
            binning=binning_of(self),
            width_px=int(camera.Width.Value),
            height_px=int(camera.Height.Value),
            offset_x_px=int(camera.OffsetX.Value),
            offset_y_px=int(camera.OffsetY.Value),
            features={name: self.node(name).ToString() for name in settings.features},
        )
        return preparation.as_prepared(self, applied, settings, possible_hz)
