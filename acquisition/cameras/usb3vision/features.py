"""The features of a camera that the rig uses, found by their standard name or by names of older cameras."""

import logging
from typing import Any, Final

from acquisition.camera import CameraSettings, FeatureValue, PixelFormat
from acquisition.cameras.genicam import GenicamFeatures, NumericFeature
from acquisition.cameras.pixel_formats import names_by_depth
from acquisition.cameras.usb3vision.node_map import NodeMap
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

# names of the Standard Feature Naming Convention (SFNC) come first, then those of older cameras
ALIASES: Final[dict[str, tuple[str, ...]]] = {
    "ExposureTime": ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw"),
    "Gain": ("Gain", "GainAbs", "GainRaw"),
    "AcquisitionFrameRate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs", "FrameRate"),
    "AcquisitionFrameRateEnable": (
        "AcquisitionFrameRateEnable",
        "AcquisitionFrameRateEnabled",
        "AcquisitionFrameRateControlEnabled",
    ),
}
_NAMES: Final[dict[NumericFeature, str]] = {
    "exposure_us": "ExposureTime",
    "gain_db": "Gain",
    "frame_rate_hz": "AcquisitionFrameRate",
}


class Features(GenicamFeatures):
    """The features of one camera. Names are those of the SFNC; older names are tried as well."""

    def __init__(self, nodes: NodeMap) -> None:
        super().__init__(nodes.name)
        self.nodes = nodes

    def find(self, name: str) -> str:
        """The name of a feature in this camera; the standard name if the camera does not have the feature."""
        present = [alias for alias in ALIASES.get(name, ()) if alias in self.nodes] or [name]
        usable = (alias for alias in present if self.nodes.readable(alias) or self.nodes.writable(alias))
        return next(usable, present[0])

    def get(self, name: str) -> Any:
        """Value of a feature; DeviceError if the camera has no such feature or it cannot be read."""
        return self.nodes.get(self.find(name))

    def get_if_readable(self, name: str) -> Any | None:
        """Value of a feature; None if the camera has no such feature or it cannot be read at present."""
        found = self.find(name)
        return self.nodes.get(found) if self.nodes.readable(found) else None

    def set(self, name: str, value: Any) -> Any:
        """Set a feature; return the value that the camera reports afterwards.

        Raises
        ------
        DeviceError
            The camera has no such feature, it cannot be set at present, or the value is out of range (the
            message gives the range).
        """
        found = self.find(name)
        if found not in self.nodes:
            raise DeviceError(f"{self.name}: has no feature {name}; leave that setting out")
        self.nodes.set(found, value)
        self.nodes.forget()  # the camera may have changed the value that was written
        return self.nodes.get(found) if self.nodes.readable(found) else value

    def execute(self, name: str) -> None:
        self.nodes.set(name, True)

    # ---- the methods of GenicamFeatures

    def writable(self, feature: str) -> bool:
        return self.nodes.writable(feature)

    def choices(self, feature: str) -> tuple[str, ...]:
        return self.nodes.choices(feature)

    def read(self, feature: str) -> FeatureValue | None:
        value = self.get_if_readable(feature)
        return value if value is None or isinstance(value, bool | int | float | str) else str(value)

    def write(self, feature: str, value: FeatureValue) -> None:
        self.nodes.set(feature, value)

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        return {
            one.name: one.value.hex() if isinstance(one.value, bytes) else one.value
            for one in self.nodes.readings()
            if one.value is not None and not one.problem and one.kind != "Command"
        }

    def set_feature(self, name: str, value: FeatureValue) -> None:
        self.set(name, value)

    def renew(self) -> None:
        self.nodes.forget()

    def number(self, key: NumericFeature) -> float | None:
        if key == "frame_rate_hz" and self.get_if_readable(self.rate_switch) is False:
            return None
        value = self.get_if_readable(_NAMES[key])
        return None if value is None else float(value)

    def set_number(self, key: NumericFeature, wanted: float) -> None:
        if key == "frame_rate_hz":
            if "Off" in self.choices("AcquisitionFrameRateAuto") and self.writable(
                "AcquisitionFrameRateAuto"
            ):
                self.write("AcquisitionFrameRateAuto", "Off")
            if self.writable(self.rate_switch):
                self.write(self.rate_switch, True)
        found = self.find(_NAMES[key])
        is_whole = found in self.nodes and self.nodes.kind(found) == "Integer"
        applied = self.set(_NAMES[key], round(wanted) if is_whole else wanted)
        if abs(applied - wanted) > 1e-6 * abs(wanted):
            logger.info("%s: %s was set to %g, the camera reports %g", self.name, found, wanted, applied)

    @property
    def rate_switch(self) -> str:
        return self.find(super().rate_switch)

    def free_rate(self, possible_hz: float | None) -> float | None:
        return super().free_rate(possible_hz) if self.number("frame_rate_hz") else None

    def possible_rate(self) -> float | None:
        found = self.find("AcquisitionFrameRate")
        highest_hz = self.nodes.limits(found)[1] if found in self.nodes else None
        return super().possible_rate() or (float(highest_hz) if highest_hz else None)

    def region(self) -> tuple[int | None, int | None, int, int]:
        x, y = self.get_if_readable("OffsetX"), self.get_if_readable("OffsetY")
        return x, y, self.get("Width"), self.get("Height")

    def sensor_size(self, size: str) -> int:
        """Number of columns (`size` "Width") or rows ("Height") of the sensor that can be read out."""
        for name in (f"{size}Max", f"Sensor{size}"):
            value = self.get_if_readable(name)
            if value:
                offset = self.get_if_readable("OffsetX" if size == "Width" else "OffsetY") or 0
                return max(int(value), int(self.get(size)) + int(offset))
        largest = self.nodes.limits(size)[1]
        return int(largest if largest is not None else self.get(size))

    def set_region(self, requested: CameraSettings) -> None:
        """Set size and offset, which limit each other, in the order in which their limits allow it."""
        for size, offset, wanted_size, wanted_offset in (
            ("Width", "OffsetX", requested.width_px, requested.offset_x_px),
            ("Height", "OffsetY", requested.height_px, requested.offset_y_px),
        ):
            length, sensor = wanted_size or self.get(size), self.sensor_size(size)
            if wanted_offset and length + wanted_offset > sensor:
                raise DeviceError(
                    f"{self.name}: {size} {length} at {offset} {wanted_offset} reaches "
                    f"{length + wanted_offset}; the sensor has {sensor}. Ask for less"
                )
            has_offset = self.writable(offset)
            before = self.get(offset) if has_offset else 0
            if wanted_size is not None and self.get(size) != wanted_size:
                if before:
                    self.set(offset, 0)  # the old offset may not allow a size that fits at the new one
                try:
                    self.set(size, wanted_size)
                except DeviceError:
                    if before:
                        self.set(offset, before)
                    raise
                if wanted_offset is None and before:
                    self.set(offset, min(before, int(self.nodes.limits(offset)[1] or 0)))
            if wanted_offset is not None and (has_offset or wanted_offset):
                self.set(offset, wanted_offset)

    def format_name(self) -> str:
        return str(self.get("PixelFormat"))

    def offered_formats(self) -> tuple[str, ...]:
        return self.choices("PixelFormat")

    def set_format_name(self, name: str) -> None:
        self.set("PixelFormat", name)

    def set_format(self, wanted: PixelFormat | None) -> None:
        """Set a format of this depth, or (None) of a mosaic; a fitting one that is set already stays."""
        if wanted is None and (not self.plane or self.present_format() is not None):
            return
        names = names_by_depth(set(self.offered_formats()), self.plane)
        fitting = names.get(wanted, []) if wanted else [name for each in names.values() for name in each]
        if not fitting:
            what = f"pixel format {wanted or 'of a Bayer mosaic'}"
            raise DeviceError(f"{self.name}: does not offer {what}; it offers: {self.usable_depths()}")
        if self.format_name() not in fitting:
            self.set_format_name(fitting[0])

    # ---- for the driver

    def select_continuous(self) -> None:
        """Select continuous acquisition, without a trigger unless one was requested."""
        if "Continuous" in self.choices("AcquisitionMode") and self.writable("AcquisitionMode"):
            self.write("AcquisitionMode", "Continuous")
        if not self.is_triggered:
            self.run_freely()
