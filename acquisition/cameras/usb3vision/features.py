"""The features of a camera that the rig uses, found by their standard name or by names of older cameras."""

import logging
from collections.abc import Iterator
from typing import Any, Final

from acquisition.camera import CameraSettings, ColourPlane, FeatureValue, PixelFormat
from acquisition.cameras import preparation, wiring
from acquisition.cameras.colour_plane import format_of, in_sensor_px, names_by_depth
from acquisition.cameras.pixel_formats import Format
from acquisition.cameras.preparation import RESULTING_RATES, binning_of
from acquisition.cameras.usb3vision.feature_readings import FeatureReading, read_all
from acquisition.cameras.usb3vision.genapi.choice_nodes import Enumeration
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from acquisition.cameras.usb3vision.region import set_region
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


class Features:
    """The features of one camera. Names are those of the SFNC; older names are tried as well."""

    def __init__(self, nodes: NodeMap) -> None:
        self.nodes = nodes
        self._asked = CameraSettings()

    @property
    def plane(self) -> ColourPlane | None:
        """The colour that is read, of a sensor with a Bayer mosaic."""
        return self._asked.colour_plane

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
        return read_all(self.nodes)

    def execute(self, name: str) -> None:
        """Run a command."""
        self.nodes.set(name, True)

    # ---- as named_features.NamedFeatures

    @property
    def name(self) -> str:
        """Name of the camera in messages."""
        return self.nodes.name

    def writable(self, feature: str) -> bool:
        """Whether the camera has the feature and it can be set now."""
        return feature in self.nodes and self.nodes.node(feature).access().writable

    def choices(self, feature: str) -> tuple[str, ...]:
        """Values that an enumeration takes now; none for other features."""
        node = self.nodes.node(feature) if feature in self.nodes else None
        return node.choices() if isinstance(node, Enumeration) else ()

    def read(self, feature: str) -> FeatureValue | None:
        """Value of a feature; None if it cannot be read now."""
        value = self.get_if_readable(feature)
        return None if value is None else _plain(value)

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature, or run a command."""
        self.nodes.set(feature, value)

    # ---- for the rig

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None, in the order that cameras require; return all as read
        back.
        """
        self.nodes.forget()
        self._asked = preparation.prepare(self, settings, self._asked)
        settings = in_sensor_px(self._asked)
        if settings.pixel_format is not None or (self.plane and self._format() is None):
            self._set_pixel_format(settings.pixel_format)
        set_region(self, settings)
        if settings.trigger is None:
            self._set_times(settings.exposure_us, settings.frame_rate_hz)
        else:
            self._set_exposure(settings.exposure_us)
            self._limit_no_rate()
        if settings.gain_db is not None:
            self._set_number("Gain", settings.gain_db)
        for name, value in settings.features.items():
            self.set(name, value)
        applied = self.read_back(tuple(settings.features))
        return preparation.as_prepared(self, applied, settings, self._possible_rate())

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
        if "Off" in self.choices("AcquisitionFrameRateAuto") and self.writable("AcquisitionFrameRateAuto"):
            self.write("AcquisitionFrameRateAuto", "Off")
        enable = self.find("AcquisitionFrameRateEnable")
        if enable is not None and self.nodes.node(enable).access().writable:
            self.nodes.set(enable, True)
        self._set_number("AcquisitionFrameRate", frame_rate_hz)

    def _limit_no_rate(self) -> None:
        """Let a trigger alone decide when frames are taken."""
        enable = self.find("AcquisitionFrameRateEnable")
        if enable is not None and self.writable(enable):
            self.write(enable, False)

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
            binning=binning_of(self),
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
        possible_hz = self._possible_rate()
        return float(rate_hz if possible_hz is None else min(rate_hz, possible_hz))

    def _possible_rate(self) -> float | None:
        """Frames per second that exposure, size and bus leave, if the camera says it."""
        for name in RESULTING_RATES:
            possible_hz = self.get_if_readable(name)
            if possible_hz:
                return float(possible_hz)
        found = self.find("AcquisitionFrameRate")
        most_hz = None if found is None else self.nodes.node(found).maximum()
        return float(most_hz) if most_hz else None

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

    def run_on(self) -> None:
        """Select continuous acquisition, without a trigger unless one was asked for."""
        if "Continuous" in self.choices("AcquisitionMode") and self.writable("AcquisitionMode"):
            self.write("AcquisitionMode", "Continuous")
        if not preparation.waits(self._asked):
            wiring.run_freely(self)

    def pixel_format(self) -> Format:
        """The present pixel format; DeviceError if the rig does not support it."""
        found = self._format()
        if found is not None:
            return found
        name = str(self.get("PixelFormat"))
        mosaic = format_of(name, "red") is not None
        raise DeviceError(
            f"{self.nodes.name}: pixel format {name} is not supported; set one of: {self._usable_depths()}"
            + (", or camera.colour_plane to the laser's colour" if mosaic and not self.plane else "")
        )

    def _format(self) -> Format | None:
        return format_of(str(self.get("PixelFormat")), self.plane)

    def _names(self) -> dict[PixelFormat, list[str]]:
        return names_by_depth(set(self.choices("PixelFormat")), self.plane)

    def _usable_depths(self) -> str:
        return ", ".join(self._names()) or "none that this camera has"

    def _set_pixel_format(self, wanted: PixelFormat | None) -> None:
        """Set a format of this depth, or any."""
        names = self._names()
        fitting = names.get(wanted, []) if wanted else [name for each in names.values() for name in each]
        if not fitting:
            what = f"pixel format {wanted or 'of a Bayer mosaic'}"
            raise DeviceError(f"{self.nodes.name}: does not offer {what}; it offers: {self._usable_depths()}")
        # a format of the same depth that is already set (packed, for example) is kept
        if self.get("PixelFormat") not in fitting:
            self.set("PixelFormat", fitting[0])


def _plain(value: Any) -> FeatureValue:
    """A feature's value as a configuration states it; empty if it cannot be read."""
    return value if isinstance(value, bool | int | float | str) else "" if value is None else str(value)
