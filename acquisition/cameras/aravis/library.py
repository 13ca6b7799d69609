"""Loading of libaravis through PyGObject when it is needed, and search for cameras."""

import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

from acquisition.camera import PluggedCamera
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
