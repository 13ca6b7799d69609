"""Search for connected USB3 Vision cameras, and choice of one by its serial number."""

import errno
import sys
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import usb.backend
import usb.backend.libusb1
import usb.core
import usb.util

from acquisition.camera import PluggedCamera
from acquisition.cameras.usb3vision.link import (
    VISION_CLASS,
    VISION_SUBCLASS,
    WINUSB,
    no_permission,
)
from acquisition.cameras.usb3vision.node_map import load_genapi
from processing.errors import DeviceError

_DEVICE_INFO_TYPE: Final = 0x24
_DEVICE_INFO_SUBTYPE: Final = 0x01
_DEVICE_INFO_LENGTH: Final = 20
_VENDOR_INDEX: Final = 12
_MODEL_INDEX: Final = 13
_SERIAL_INDEX: Final = 17


class UsbSpeed(IntEnum):
    """The speed of a connection, as libusb numbers it."""

    UNKNOWN = 0
    LOW = 1
    FULL = 2
    HIGH = 3
    SUPER = 4
    SUPER_PLUS = 5

    @classmethod
    def _missing_(cls, value: object) -> "UsbSpeed":
        return cls.UNKNOWN

    @property
    def text(self) -> str:
        """As data sheets call it."""
        names = {UsbSpeed.SUPER: "SuperSpeed", UsbSpeed.SUPER_PLUS: "SuperSpeed+"}
        return names.get(self, f"{self.name.lower()} speed")


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera on the bus; texts are empty if they cannot be read, and `accessible` is False then.

    `device` is pyusb's object.
    """

    vendor: str
    model: str
    serial: str
    usb_speed: UsbSpeed
    accessible: bool
    device: Any

    @property
    def name(self) -> str:
        """Name of the camera in messages."""
        who = (
            f"{self.vendor} {self.model}".strip() or f"{self.device.idVendor:04x}:{self.device.idProduct:04x}"
        )
        serial = f"serial {self.serial}" if self.serial else "serial unreadable"
        return f"USB3 Vision camera {who} ({serial})"


def find_cameras(backend: usb.backend.IBackend | None = None) -> tuple[FoundCamera, ...]:
    """All connected USB3 Vision cameras.

    Raises DeviceError if libusb is missing.
    """
    devices = usb.core.find(find_all=True, backend=backend or _libusb(), custom_match=_is_vision)
    return tuple(_describe(device) for device in devices)


def list_cameras() -> list[PluggedCamera]:
    """All connected USB3 Vision cameras for ``rig doctor``, with the USB speed as `place`."""
    remedy = "no permission: run rig doctor --install-udev, and plug the camera in again"
    if sys.platform == "win32":
        remedy = WINUSB
    missing = ""
    try:
        load_genapi()
    except DeviceError as error:
        missing = str(error)
    return [
        PluggedCamera(
            driver="usb3vision",
            name=f"{found.vendor} {found.model}".strip(),
            serial=found.serial,
            place=found.usb_speed.text,
            problem=missing if found.accessible else remedy,
        )
        for found in find_cameras()
    ]


def find_camera(serial: str | None, backend: usb.backend.IBackend | None = None) -> FoundCamera:
    """The camera with this serial number; None: the only one connected.

    Raises
    ------
    DeviceError
        No camera is connected; several are and no serial number is given; none has the serial number; or
        there is no permission to open it.
    """
    cameras = find_cameras(backend)
    if not cameras:
        raise DeviceError("no USB3 Vision camera is plugged in; check cable and power, then: rig doctor")
    listed = "; ".join(camera.name for camera in cameras)
    if serial is None:
        if len(cameras) > 1:
            raise DeviceError(
                f"{len(cameras)} USB3 Vision cameras, and no serial given; set one of: {listed}"
            )
        chosen = cameras[0]
    else:
        matching = [camera for camera in cameras if camera.serial == serial]
        unreadable = [camera for camera in cameras if not camera.accessible]
        if not matching and unreadable:
            raise no_permission(unreadable[0].name)
        if not matching:
            raise DeviceError(f"no USB3 Vision camera has serial {serial!r}; plugged in: {listed}")
        if len(matching) > 1:
            raise DeviceError(
                f"{len(matching)} USB3 Vision cameras have serial {serial!r}; unplug all but one"
            )
        chosen = matching[0]
    if not chosen.accessible:
        raise no_permission(chosen.name)
    return chosen


def _libusb() -> usb.backend.IBackend:
    backend = usb.backend.libusb1.get_backend()
    if backend is None:
        try:
            import libusb_package
        except ImportError:
            pass  # some distributions do not include it
        else:
            backend = libusb_package.get_libusb1_backend()
    if backend is None:
        raise DeviceError(
            "libusb-1.0 is missing, which USB3 Vision cameras need; "
            "install it (Debian: apt install libusb-1.0-0) or: pip install libusb-package"
        )
    return backend


def _is_vision(device: Any) -> bool:
    try:
        return any(
            (interface.bInterfaceClass, interface.bInterfaceSubClass) == (VISION_CLASS, VISION_SUBCLASS)
            for configuration in device
            for interface in configuration
        )
    except usb.core.USBError:
        return False  # unplugged during the search, or without valid descriptors


def _describe(device: Any) -> FoundCamera:
    indices = _string_indices(device)
    speed = UsbSpeed(device.speed)
    try:
        vendor, model, serial = (_text(device, index) for index in indices)
        accessible = True
    except usb.core.USBError as error:
        vendor = model = serial = ""
        accessible = error.errno != errno.EACCES
    except NotImplementedError:  # Windows, for a device without the driver WinUSB
        vendor = model = serial = ""
        accessible = False
    finally:
        usb.util.dispose_resources(device)
    return FoundCamera(vendor, model, serial, speed, accessible, device)


def _text(device: Any, index: int) -> str:
    if not index:
        return ""
    try:
        return (usb.util.get_string(device, index) or "").strip("\0 ")
    except ValueError:  # raised by pyusb for a device without strings, and for one without permission
        device.get_active_configuration()  # raises an error in the second case
        return ""


def _string_indices(device: Any) -> tuple[int, int, int]:
    """String indices of vendor, model and serial, from the camera's descriptor or else the device's."""
    for configuration in device:
        for interface in configuration:
            extra = bytes(interface.extra_descriptors)
            while len(extra) >= 3 and extra[0] >= 3:
                length, kind, subtype = extra[0], extra[1], extra[2]
                if (kind, subtype) == (_DEVICE_INFO_TYPE, _DEVICE_INFO_SUBTYPE):
                    if length >= _DEVICE_INFO_LENGTH and len(extra) >= length:
                        return extra[_VENDOR_INDEX], extra[_MODEL_INDEX], extra[_SERIAL_INDEX]
                    break
                extra = extra[length:]
    return device.iManufacturer, device.iProduct, device.iSerialNumber
