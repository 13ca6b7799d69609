"""The features of a camera that the rig uses, found by their standard name or by names of older cameras."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from acquisition.camera import CameraLost, CameraSettings, FeatureValue, PixelFormat
from acquisition.cameras.automatic import AUTOMATIC, BENDING, RESULTING_RATES
from acquisition.cameras.pixel_formats import BY_NAME, FORMATS, Format
from acquisition.cameras.usb3vision.genapi.choice_nodes import Enumeration
from acquisition.cameras.usb3vision.genapi.node import Access
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

# names of the Standard Feature Naming Convention (SFNC) first, then those of older cameras
ALIASES: Final[dict[str, tuple[str, ...]]] = {
    "ExposureTime": ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw"),
    "Gain": ("Gain", "GainAbs", "GainRaw"),
    "AcquisitionFrameRate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs", "FrameRate"),
    "AcquisitionFrameRateEnable": (
        "AcquisitionFrameRateEnable",
        "AcquisitionFrameRateEnabled",
        "AcquisitionFrameRateControlEnabled",
    ),
    "DeviceClockFrequency": ("DeviceClockFrequency", "GevTimestampTickFrequency"),
}


@dataclass(frozen=True, slots=True)
class FeatureReading:
    """One feature for display. `value` is None if it cannot be read; `problem` is then the reason."""

    name: str
    kind: str
    value: int | float | bool | str | bytes | None
    access: str
    minimum: float | None
    maximum: float | None
    unit: str
    choices: tuple[str, ...]
    problem: str


class Features:
    """The features of one camera. Names are those of the SFNC; older names are tried as well."""

    def __init__(self, nodes: NodeMap) -> None:
        self.nodes = nodes

    def find(self, name: str) -> str | None:
        """The name of the feature in this camera, also if it is not accessible now; None if it has none."""
        present = [alias for alias in ALIASES.get(name, (name,)) if alias in self.nodes]
        for alias in present:
            if self.nodes.node(alias).access().readable or self.nodes.node(alias).access().writable:
                return alias
        return present[0] if present else None

    def get(self, name: str) -> Any:
        """Value of a feature; DeviceError if the camera has no such feature or it cannot be read."""
        found = self.find(name)
        if found is None:
            raise DeviceError(f"{self.nodes.name}: has no feature {name}")
        return self.nodes.get(found)

    def get_if_readable(self, name: str) -> Any | None:
        """Value of a feature; None if the camera has no such feature or it cannot be read at present."""
        found = self.find(name)
        if found is None or not self.nodes.node(found).access().readable:
            return None
        return self.nodes.get(found)

    def set(self, name: str, value: Any) -> Any:
        """Set a feature; return the value that the camera reports afterwards.

        Raises
        ------
        DeviceError
            The camera has no such feature, it cannot be set at present, or the value is out of range (the
            message gives the range).
        """
        found = self.find(name)
        if found is None:
            raise DeviceError(f"{self.nodes.name}: has no feature {name}; leave that setting out")
        self.nodes.set(found, value)
        self.nodes.forget()  # the camera may have changed the value that was written
        return self.nodes.get(found) if self.nodes.node(found).access().readable else value

    def readings(self) -> Iterator[FeatureReading]:
        """All implemented features of the camera and their present values; faulty ones have a `problem`."""
        self.nodes.forget()
        for name in self.nodes.features():
            node = self.nodes.node(name)
            access, value, low, high, problem = "", None, None, None, ""
            choices: tuple[str, ...] = ()
            try:
                mode = node.access()
                access = mode.value
                if mode is Access.NOT_IMPLEMENTED:
                    continue
                if mode.readable and hasattr(node, "get"):
                    value = self.nodes.get(name)
                    low, high = node.minimum(), node.maximum()
                choices = node.choices() if isinstance(node, Enumeration) else ()
            except CameraLost:
                raise
            except DeviceError as error:
                problem = str(error)
            unit = node.description.text("Unit") or ""
            kind = node.description.kind
            yield FeatureReading(name, kind, value, access, low, high, unit, choices, problem)

    def execute(self, name: str) -> None:
        """Run a command."""
        self.nodes.set(name, True)

    def _switch_off(self, name: str) -> None:
        """Set an automatic control or a trigger to "Off", if the camera has it and it can be set."""
        node = self.nodes.node(name) if name in self.nodes else None
        if isinstance(node, Enumeration) and node.access().writable and "Off" in node.choices():
            node.set("Off")

    # ---- for the rig

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None, in the order that cameras require; return all as read
        back.
        """
        self.nodes.forget()
        self._leave_images_alone()
        if settings.pixel_format is not None:
            self._set_pixel_format(settings.pixel_format)
        self._set_region(settings)
        self._set_times(settings.exposure_us, settings.frame_rate_hz)
        if settings.gain_db is not None:
            self._set_number("Gain", settings.gain_db)
        for name, value in settings.features.items():
            self.set(name, value)
        return self.read_back(tuple(settings.features))

    def _leave_images_alone(self) -> None:
        """Switch off what the camera does by itself to its images."""
        for name in AUTOMATIC:
            self._switch_off(name)
        for name in BENDING:
            node = self.nodes.node(name) if name in self.nodes else None
            if node is not None and node.access().writable and self.get_if_readable(name):
                self.nodes.set(name, False)

    def _set_times(self, exposure_us: float | None, frame_rate_hz: float | None) -> None:
        """Set exposure and frame rate in the order in which they fit: each limits the other."""
        if exposure_us is None or frame_rate_hz is None:
            self._set_exposure(exposure_us)
            self._set_rate(frame_rate_hz)
            return
        now_us = self.get_if_readable("ExposureTime")
        if now_us is None or exposure_us <= now_us:
            self._set_exposure(exposure_us)
            self._set_rate(frame_rate_hz)
        else:
            self._set_rate(frame_rate_hz)
            self._set_exposure(exposure_us)

    def _set_exposure(self, exposure_us: float | None) -> None:
        if exposure_us is not None:
            self._set_number("ExposureTime", exposure_us)

    def _set_rate(self, frame_rate_hz: float | None) -> None:
        if frame_rate_hz is None:
            return
        self._switch_off("AcquisitionFrameRateAuto")
        enable = self.find("AcquisitionFrameRateEnable")
        if enable is not None and self.nodes.node(enable).access().writable:
            self.nodes.set(enable, True)
        self._set_number("AcquisitionFrameRate", frame_rate_hz)

    def read_back(self, features: tuple[str, ...] = ()) -> CameraSettings:
        """The camera's present settings; None for a feature that it does not have or that is not in use.

        The frame rate is the one that results, where exposure or bus do not allow the one that is set.
        `features` are read too.
        """
        self.nodes.forget()
        pixel_format = self.pixel_format().pixel_format
        return CameraSettings(
            exposure_us=self._positive("ExposureTime"),
            gain_db=self._gain(),
            frame_rate_hz=self._frame_rate(),
            pixel_format=pixel_format,
            width_px=self.get("Width"),
            height_px=self.get("Height"),
            offset_x_px=self.get_if_readable("OffsetX"),
            offset_y_px=self.get_if_readable("OffsetY"),
            features={name: _plain(self.get_if_readable(name)) for name in features},
        )

    def _frame_rate(self) -> float | None:
        enabled = self.get_if_readable("AcquisitionFrameRateEnable")
        rate_hz = None if enabled is False else self.get_if_readable("AcquisitionFrameRate")
        if not rate_hz:
            return None
        for name in RESULTING_RATES:
            possible_hz = self.get_if_readable(name)
            if possible_hz:
                return float(min(rate_hz, possible_hz))
        return float(rate_hz)

    def _positive(self, name: str) -> float | None:
        value = self.get_if_readable(name)
        return float(value) if value is not None and value > 0 else None

    def _gain(self) -> float | None:
        value = self.get_if_readable("Gain")
        return None if value is None else float(value)

    def _set_number(self, name: str, wanted: float) -> None:
        found = self.find(name)
        is_whole = found is not None and self.nodes.node(found).description.kind == "Integer"
        got = self.set(name, round(wanted) if is_whole else wanted)
        if abs(got - wanted) > 1e-6 * abs(wanted):
            logger.info("%s: %s was set to %g, the camera reports %g", self.nodes.name, found, wanted, got)

    def run_freely(self) -> None:
        """Select continuous acquisition without trigger."""
        mode = self.nodes.node("AcquisitionMode") if "AcquisitionMode" in self.nodes else None
        if isinstance(mode, Enumeration) and mode.access().writable and "Continuous" in mode.choices():
            mode.set("Continuous")
        selector = self.nodes.node("TriggerSelector") if "TriggerSelector" in self.nodes else None
        if isinstance(selector, Enumeration) and selector.access().writable:
            before = selector.get()
            for choice in selector.choices():
                selector.set(choice)
                self._switch_off("TriggerMode")
            selector.set(before)
        else:
            self._switch_off("TriggerMode")

    def pixel_format(self) -> Format:
        """The present pixel format; DeviceError if the rig does not support it."""
        name = str(self.get("PixelFormat"))
        if name not in BY_NAME:
            raise DeviceError(
                f"{self.nodes.name}: pixel format {name} is not supported; "
                f"set one of: {self._usable_depths()}"
            )
        return BY_NAME[name]

    def _usable_depths(self) -> str:
        node = self.nodes.node("PixelFormat")
        choices = node.choices() if isinstance(node, Enumeration) else ()
        depths = dict.fromkeys(item.pixel_format for item in FORMATS if item.name in choices)
        return ", ".join(depths) or "none that this camera has"

    def _set_pixel_format(self, wanted: PixelFormat) -> None:
        node = self.nodes.node("PixelFormat") if "PixelFormat" in self.nodes else None
        choices = node.choices() if isinstance(node, Enumeration) else ()
        fitting = [item.name for item in FORMATS if item.pixel_format == wanted and item.name in choices]
        if not fitting:
            raise DeviceError(
                f"{self.nodes.name}: does not offer pixel format {wanted}; it offers: {self._usable_depths()}"
            )
        # a format of the same depth that is already set (packed, for example) is kept
        if self.get("PixelFormat") not in fitting:
            self.set("PixelFormat", fitting[0])

    def sensor_size(self, size: str) -> int:
        """Number of columns (`size` "Width") or rows ("Height") of the sensor that can be read out."""
        for name in (f"{size}Max", f"Sensor{size}"):
            value = self.get_if_readable(name) if self.find(name) is not None else None
            if value:
                offset = self.get_if_readable("OffsetX" if size == "Width" else "OffsetY") or 0
                return max(int(value), int(self.get(size)) + int(offset))
        largest = self.nodes.node(size).maximum()
        return int(largest if largest is not None else self.get(size))

    def _check_region(
        self, size: str, offset: str, wanted_size: int | None, wanted_offset: int | None
    ) -> None:
        end = (wanted_size or self.get(size)) + (wanted_offset or 0)
        sensor = self.sensor_size(size)
        if wanted_offset and end > sensor:
            raise DeviceError(
                f"{self.nodes.name}: {size} {end - wanted_offset} at {offset} {wanted_offset} reaches {end}; "
                f"the sensor has {sensor}. Ask for less"
            )

    def _set_region(self, settings: CameraSettings) -> None:
        """Set size and offset of the region, in the order in which the limits allow it: they limit each
        other.
        """
        for size, offset, wanted_size, wanted_offset in (
            ("Width", "OffsetX", settings.width_px, settings.offset_x_px),
            ("Height", "OffsetY", settings.height_px, settings.offset_y_px),
        ):
            self._check_region(size, offset, wanted_size, wanted_offset)
            has_offset = self.find(offset) is not None and self.nodes.node(offset).access().writable
            if wanted_size is not None and self.get(size) != wanted_size:
                before = self.get(offset) if has_offset else 0
                if has_offset and before:
                    self.set(offset, 0)  # the old offset may not allow a size that fits at the new one
                try:
                    self.set(size, wanted_size)
                except DeviceError:
                    if has_offset and before:
                        self.set(offset, before)
                    raise
                if wanted_offset is None and before:
                    self.set(offset, min(before, int(self.nodes.node(offset).maximum() or 0)))
            if wanted_offset is not None and (has_offset or wanted_offset):
                self.set(offset, wanted_offset)


def _plain(value: Any) -> FeatureValue:
    """A feature's value as a configuration states it; empty if it cannot be read."""
    return value if isinstance(value, bool | int | float | str) else "" if value is None else str(value)
