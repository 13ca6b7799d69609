"""libaravis through PyGObject: loaded when it is needed, the cameras that it finds, and their features."""

import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from acquisition.camera import CameraSettings, FeatureValue, PluggedCamera
from acquisition.cameras import wiring
from acquisition.cameras.preparation import GenicamFeatures, Quantity
from processing.errors import DeviceError


class Library(NamedTuple):
    """libaravis's module and the class of its errors, from PyGObject."""

    aravis: Any
    error: type[Exception]


@dataclass(frozen=True, slots=True)
class AravisDevice:
    """A camera found by libaravis; `place` is its address or USB identity."""

    identity: str
    vendor: str
    model: str
    serial: str
    place: str
    protocol: str

    @property
    def name(self) -> str:
        """Name of the camera in messages."""
        return f"{self.protocol} camera {self.vendor} {self.model} (serial {self.serial or 'unknown'})"


def load_library() -> Library:
    """libaravis 0.8 through PyGObject. Raises DeviceError that names what is missing."""
    try:
        with warnings.catch_warnings():
            # PyGObject's importer uses a deprecated interface, about which Python warns
            warnings.simplefilter("ignore")
            import gi

            gi.require_version("Aravis", "0.8")
            from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as missing:
        raise DeviceError(
            "camera.driver = 'aravis' needs libaravis 0.8 and PyGObject (Debian: apt install "
            "gir1.2-aravis-0.8 python3-gi, and an environment made with --system-site-packages); "
            f"here: {missing}"
        ) from None
    return Library(Aravis, GLib.Error)


def find_cameras() -> tuple[AravisDevice, ...]:
    """All cameras that libaravis finds; the search takes about a second."""
    aravis = load_library().aravis
    aravis.update_device_list()
    return tuple(
        AravisDevice(
            identity=aravis.get_device_id(index),
            vendor=aravis.get_device_vendor(index) or "",
            model=aravis.get_device_model(index) or "",
            serial=aravis.get_device_serial_nbr(index) or "",
            place=aravis.get_device_address(index) or aravis.get_device_physical_id(index) or "",
            protocol=aravis.get_device_protocol(index) or "",
        )
        for index in range(aravis.get_n_devices())
    )


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by libaravis, for ``rig doctor``."""
    return [
        PluggedCamera("aravis", f"{found.vendor} {found.model}", found.serial, found.place)
        for found in find_cameras()
    ]


def find_camera(wanted: str | None) -> AravisDevice:
    """The camera with this serial number or id; None: the only camera connected.

    Raises DeviceError, with a list of the cameras, if there is none or the choice is ambiguous.
    """
    there = find_cameras()
    chosen = [camera for camera in there if wanted in (None, camera.serial, camera.identity)]
    listed = "; ".join(camera.name for camera in there)
    if not there:
        raise DeviceError("aravis: no camera answers; check cable, power and network, then: rig doctor")
    if not chosen:
        raise DeviceError(f"aravis: no camera has the serial number {wanted!r}; there are: {listed}")
    if len(chosen) > 1:
        raise DeviceError(
            f"aravis: several cameras: {listed}; set camera.serial to one of them "
            "(where two share one, to its id: rig doctor)"
        )
    return chosen[0]


_CALLED: Final[dict[Quantity, str]] = {
    "exposure_us": "exposure_time",
    "gain_db": "gain",
    "frame_rate_hz": "frame_rate",
}
"""What libaravis calls the quantities in the names of its functions."""


class AravisFeatures(GenicamFeatures):
    """Features of an open camera; `camera` is libaravis's object."""

    def __init__(self, camera: Any, aravis: Any, name: str) -> None:
        super().__init__(name)
        self.camera = camera
        self._aravis = aravis

    def give_up(self) -> list[Any]:
        """Return libaravis's camera in a list, no longer held here: dropping the last reference may block."""
        camera, self.camera = self.camera, None
        return [camera]

    def sensor_size(self) -> tuple[int, int]:
        """(width, height) of the sensor."""
        width_px, height_px = self.camera.get_sensor_size()
        return int(width_px), int(height_px)

    # ---- as GenicamFeatures

    def writable(self, feature: str) -> bool:
        if not self.camera.is_feature_available(feature):
            return False
        node = self.camera.get_device().get_feature(feature)
        read_only = node.get_actual_access_mode() == self._aravis.GcAccessMode.RO
        return not (read_only or node.is_locked())

    def choices(self, feature: str) -> tuple[str, ...]:
        node = self.camera.get_device().get_feature(feature)
        if not isinstance(node, self._aravis.GcEnumeration) or not node.is_available():
            return ()
        return tuple(self.camera.dup_available_enumerations_as_strings(feature))

    def read(self, feature: str) -> FeatureValue | None:
        return self.text(feature) if self.camera.is_feature_available(feature) else None

    def write(self, feature: str, value: FeatureValue) -> None:
        if isinstance(self.camera.get_device().get_feature(feature), self._aravis.GcCommand):
            self.camera.execute_command(feature)
            return
        text = str(value).lower() if isinstance(value, bool) else str(value)
        self.camera.get_device().set_features_from_string(f"{feature}={text}")

    def number(self, key: Quantity) -> float | None:
        if not getattr(self.camera, f"is_{_CALLED[key]}_available")():
            return None
        return float(getattr(self.camera, f"get_{_CALLED[key]}")())

    def set_number(self, key: Quantity, wanted: float) -> None:
        if not getattr(self.camera, f"is_{_CALLED[key]}_available")():
            raise DeviceError(f"{self.name}: does not allow it to be set; leave camera.{key} out")
        # libaravis clips values out of range without an error
        self._check(key, wanted, *getattr(self.camera, f"get_{_CALLED[key]}_bounds")())
        getattr(self.camera, f"set_{_CALLED[key]}")(wanted)

    def region(self) -> tuple[int, int, int, int]:
        x, y, width_px, height_px = self.camera.get_region()
        return int(x), int(y), int(width_px), int(height_px)

    def set_region(self, asked: CameraSettings) -> None:
        wanted = (asked.offset_x_px, asked.offset_y_px, asked.width_px, asked.height_px)
        if all(value is None for value in wanted):
            return
        x, y, width_px, height_px = (
            now if value is None else value for value, now in zip(wanted, self.region(), strict=True)
        )
        sensor_width_px, sensor_height_px = self.sensor_size()
        self._check_end("width_px", x + width_px, sensor_width_px)
        self._check_end("height_px", y + height_px, sensor_height_px)
        self.camera.set_region(x, y, width_px, height_px)

    def format_name(self) -> str:
        return str(self.camera.get_pixel_format_as_string())

    def offered_formats(self) -> list[str]:
        return list(self.camera.dup_available_pixel_formats_as_strings())

    def set_format_name(self, name: str) -> None:
        self.camera.set_pixel_format_from_string(name)

    # ---- for the driver

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
        if not self.waits:
            self.camera.clear_triggers()
        self.camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
