"""Features of a GenICam camera by name: access, quantities, region of interest, for any driver's library.

Names are those of the Standard Feature Naming Convention (SFNC) and of older cameras.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Final, Literal

from acquisition.camera import CameraInfo, CameraSettings, FeatureValue
from acquisition.cameras.pixel_formats import format_of
from acquisition.cameras.reading import check_end, check_range
from processing.errors import DeviceError

NumericFeature = Literal["exposure_us", "gain_db", "frame_rate_hz"]
Aliases = dict[str, tuple[str, ...]]

_NAMES: Final[dict[NumericFeature, str]] = {
    "exposure_us": "ExposureTime",
    "gain_db": "Gain",
    "frame_rate_hz": "AcquisitionFrameRate",
}
RATE_SWITCH: Final = "AcquisitionFrameRateEnable"
"""Feature that must be on for a frame rate to have an effect."""

_RESULTING_RATES: Final = (
    "AcquisitionResultingFrameRate",
    "ResultingFrameRate",
    "ResultingFrameRateAbs",
    "AcquisitionResultingFrameRateAbs",
)
"""Highest frame rate that exposure, size and bus allow, under the makers' names."""


class FeatureAccess(ABC):
    """Features of an open camera; each driver reads and sets them with its own library.

    Methods raise DeviceError for values that the camera does not support; errors of the driver's library are
    passed on.
    """

    ALIASES: ClassVar[Aliases] = {
        "ExposureTime": ("ExposureTime", "ExposureTimeAbs"),
        "Gain": ("Gain", "GainAbs"),
        "AcquisitionFrameRate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs", "FrameRate"),
        RATE_SWITCH: (
            RATE_SWITCH,
            "AcquisitionFrameRateEnabled",
            "AcquisitionFrameRateControlEnabled",
        ),
    }
    """Names of a feature in the order in which they are tried, that of the SFNC first."""

    def __init__(self, name: str) -> None:
        self.name = name

    # ---- implemented by each driver

    @abstractmethod
    def has(self, feature: str) -> bool:
        """Whether the camera has the feature, usable now or not."""

    @abstractmethod
    def writable(self, feature: str) -> bool:
        """Whether the camera has the feature and it can be set now."""

    @abstractmethod
    def choices(self, feature: str) -> tuple[str, ...]:
        """Values to which an enumeration can be set now; empty for other features."""

    @abstractmethod
    def limits(self, feature: str) -> tuple[float | None, float | None]:
        """Smallest and largest value of a number now, of type int for an integer; None: absent or unknown."""

    @abstractmethod
    def read(self, feature: str) -> FeatureValue | None:
        """Value of a feature, possibly as text; None if the camera has none or it is unreadable now."""

    @abstractmethod
    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature; any value runs a command."""

    def renew(self) -> None:  # noqa: B027 most libraries keep nothing
        """Discard values that the library keeps, so that they are read from the camera again."""

    @abstractmethod
    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        """All features that can be read now; `error` is raised by the library for those that cannot."""

    # ---- features by their standard names

    def local_name(self, name: str) -> str:
        """The name of a feature in this camera, a usable one first; `name` itself if the camera has none."""
        present = [alias for alias in self.ALIASES.get(name, ()) if self.has(alias)] or [name]
        usable = (alias for alias in present if self.writable(alias) or self.read(alias) is not None)
        return next(usable, present[0])

    def set_feature(self, name: str, value: FeatureValue) -> FeatureValue:
        """Set a feature by the name in the user's settings; returns the value that the camera reports."""
        feature = self.local_name(name)
        if not self.has(feature):
            raise DeviceError(f"{self.name}: has no feature {name}; leave camera.features.{name} out")
        self.put(feature, value)
        return self.displayed_value(name)

    def displayed_value(self, name: str) -> FeatureValue:
        """Present value of a feature for the user; empty if it is not readable."""
        value = self.read(self.local_name(name))
        return "" if value is None else value

    def put(self, feature: str, value: FeatureValue) -> None:
        """Set a feature; what the camera changed with it, or instead of it, is read again."""
        self.write(feature, value)
        self.renew()

    def number(self, key: NumericFeature) -> float | None:
        """Present value of a quantity; None where the camera does not have it, or does not use it."""
        if key == "frame_rate_hz":
            switch = self.read(self.local_name(RATE_SWITCH))
            if switch is not None and not is_on(switch):
                return None
        value = self.read(self.local_name(_NAMES[key]))
        return None if value is None else float(value)

    def set_number(self, key: NumericFeature, value: float) -> None:
        """Set a quantity; DeviceError if the camera does not have it, or cannot be set to this value."""
        if key == "frame_rate_hz":
            self._choose_if_possible("AcquisitionFrameRateAuto", "Off")
            if self.writable(switch := self.local_name(RATE_SWITCH)):
                self.put(switch, True)
        feature = self.local_name(_NAMES[key])
        if not self.writable(feature):
            raise DeviceError(f"{self.name}: has no {feature} that can be set; leave camera.{key} out")
        low, high = self.limits(feature)
        check_range(self.name, key, value, low, high)
        self.put(feature, round(value) if isinstance(low, int) else value)

    def sensor_size(self, size: str) -> int:
        """Number of columns (`size` "Width") or rows ("Height") of the sensor that can be read out."""
        length, offset = self.read(size), self.read("OffsetX" if size == "Width" else "OffsetY")
        end = int(length or 0) + int(offset or 0)
        for name in (f"{size}Max", f"Sensor{size}"):
            if value := self.read(name):
                return max(int(value), end)
        return int(self.limits(size)[1] or end)

    def region(self) -> tuple[int, int, int, int]:
        """(x, y, width, height) of the frames, in pixels of the sensor; without offsets x and y are 0."""
        x, y, width_px, height_px = (
            int(self.read(name) or 0) for name in ("OffsetX", "OffsetY", "Width", "Height")
        )
        return x, y, width_px, height_px

    def set_region(self, requested: CameraSettings) -> None:
        """Set those of offset and size that are not None, in pixels of the sensor."""
        x, y, width_px, height_px = self.region()
        for offset, size, start, length, old_start, old_length in (
            ("OffsetX", "Width", requested.offset_x_px, requested.width_px, x, width_px),
            ("OffsetY", "Height", requested.offset_y_px, requested.height_px, y, height_px),
        ):
            start, length = old_start if start is None else start, length or old_length
            check_end(self.name, f"{size.lower()}_px", start, length, self.sensor_size(size))
            try:
                if length != old_length:
                    if old_start:
                        self.put(offset, 0)  # the old offset may not allow a size that fits at the new one
                    self.put(size, length)
            except BaseException:
                start = old_start
                raise
            finally:
                if start != int(self.read(offset) or 0):
                    self.put(offset, start)

    def max_rate_hz(self) -> float | None:
        """Highest rate in Hz that exposure, size and bus allow; None: unknown."""
        rates_hz = (float(self.read(name) or 0) for name in _RESULTING_RATES)
        return next(filter(None, rates_hz), None)

    def expected_rate_hz(self) -> float | None:
        """Highest frame rate in Hz to expect, triggered or not; None if the camera states none."""
        return min(filter(None, (self.number("frame_rate_hz"), self.max_rate_hz())), default=None)

    def free_rate_hz(self) -> float | None:
        """Frame rate in Hz without a trigger; None: unknown."""
        return self.expected_rate_hz()

    def info(self, driver: str, vendor: str, model: str, serial: str, *, has_clock: bool) -> CameraInfo:
        """Identity and sensor of the camera at its present pixel format."""
        present = format_of(self.format_name(), None) or format_of(self.format_name(), "red")
        return CameraInfo(
            driver=driver,
            vendor=vendor,
            model=model,
            serial=serial,
            width_px=self.sensor_size("Width"),
            height_px=self.sensor_size("Height"),
            full_scale_dn=255 if present is None else present.full_scale_dn,
            has_clock=has_clock,
            shutter=str(self.read("SensorShutterMode") or self.read("ShutterMode") or ""),
        )

    def format_name(self) -> str:
        """The camera's name of its present pixel format."""
        return str(self.read("PixelFormat"))

    def offered_formats(self) -> tuple[str, ...]:
        """Names of the pixel formats that the camera offers now and the driver can read."""
        return self.choices("PixelFormat")

    def _choose(self, feature: str, choice: str, key: str) -> None:
        """Set an enumeration for ``camera.KEY``; DeviceError with the choices if `choice` is not one."""
        if not self.writable(feature):
            raise DeviceError(f"{self.name}: has no {feature} that can be set; leave camera.{key} out")
        offered = self.choices(feature)
        if choice not in offered:
            listed = ", ".join(offered)
            raise DeviceError(
                f"{self.name}: camera.{key}: its {feature} cannot be {choice}; it can be {listed}"
            )
        self.write(feature, choice)

    def _choose_if_possible(self, feature: str, choice: str) -> None:
        """Set an enumeration, if the camera has it, it can be set, and it offers this value."""
        if choice in self.choices(feature) and self.writable(feature):
            self.write(feature, choice)


def is_on(value: FeatureValue | None) -> bool:
    """Whether a switch is on, from the value as the library returns it: true, "true", 1 or "On"."""
    return str(value).lower() in ("true", "1", "on")
