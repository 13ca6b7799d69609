"""USB connection to one camera: claims its interfaces, reads and writes its endpoints."""

import errno
import logging
import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import usb.backend
import usb.backend.libusb1
import usb.core
import usb.util

from acquisition.camera import CameraLost, PluggedCamera
from acquisition.cameras.reading import only_camera
from acquisition.cameras.usb3vision.node_map import load_genapi
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

VISION_CLASS: Final = 0xEF
VISION_SUBCLASS: Final = 0x05
_CONTROL: Final = 0x00
_STREAM: Final = 0x02

_TO_ENDPOINT: Final = 0x02
_SET_FEATURE: Final = 3
_ENDPOINT_HALT: Final = 0

WINUSB: Final = (
    "Windows has no driver for it that programs can use: give it WinUSB, for example with Zadig "
    "(zadig.akeo.ie); the maker's program then no longer finds it until its own driver is put back"
)
UDEV_RULE: Final = (
    'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", '
    f'ENV{{ID_USB_INTERFACES}}=="*:{VISION_CLASS:02x}{VISION_SUBCLASS:02x}*"'
)
"""Condition of the udev rule for cameras of any maker, which `rig doctor --install-udev` writes."""

# Error codes of the operating systems for a device that has been unplugged
_GONE: Final = {errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN}
_LIBUSB_NO_DEVICE: Final = -4
_LIBUSB_TIMEOUT: Final = -7


class StreamHalted(DeviceError):
    """The stream endpoint has stalled or an error occurred in its transfers; clearing the halt may help."""


def _no_access() -> str:
    """Why a connected camera cannot be opened, and the remedy: on Windows it lacks a driver."""
    if sys.platform == "win32":
        return WINUSB
    return "no permission to use it; run rig doctor --install-udev, and plug the camera in again"


def is_gone(error: usb.core.USBError) -> bool:
    """Whether the error means that the device is no longer there."""
    return error.errno in _GONE or error.backend_error_code == _LIBUSB_NO_DEVICE


def is_timeout(error: usb.core.USBError) -> bool:
    """Whether the error is a timeout."""
    timeout = isinstance(error, usb.core.USBTimeoutError) or error.errno == errno.ETIMEDOUT
    return timeout or error.backend_error_code == _LIBUSB_TIMEOUT


class UsbLink:
    """Access to one camera's control and stream endpoints through pyusb.

    Errors of the bus become `CameraLost`, TimeoutError, `StreamHalted` or `DeviceError`.
    """

    def __init__(self, device: Any, name: str) -> None:
        self.device = device
        self.name = name
        self._claimed: list[int] = []
        control = self._interface(_CONTROL)
        stream = self._interface(_STREAM)
        self._control_interface: int = control.bInterfaceNumber
        self.stream_interface: int = stream.bInterfaceNumber
        self._control_in: int = self._endpoint(control, usb.util.ENDPOINT_IN).bEndpointAddress
        self._control_out: int = self._endpoint(control, usb.util.ENDPOINT_OUT).bEndpointAddress
        stream_endpoint = self._endpoint(stream, usb.util.ENDPOINT_IN)
        self.stream_in: int = stream_endpoint.bEndpointAddress
        self.packet_size = int(stream_endpoint.wMaxPacketSize) & 0x7FF or 1024

    def _interface(self, protocol: int) -> Any:
        for configuration, interface in _interfaces(self.device):
            if _is_of_vision(interface) and interface.bInterfaceProtocol == protocol:
                self._configuration = configuration
                return interface
        what = "control" if protocol == _CONTROL else "stream"
        raise DeviceError(
            f"{self.name}: has no USB3 Vision {what} interface; it cannot be used with this driver"
        )

    def _endpoint(self, interface: Any, direction: int) -> Any:
        for endpoint in interface:
            if usb.util.endpoint_direction(endpoint.bEndpointAddress) == direction:
                return endpoint
        raise DeviceError(f"{self.name}: interface {interface.bInterfaceNumber} lacks an endpoint")

    def reset_stream(self) -> None:
        """Discard old data of the stream endpoint, by halting it and clearing the halt."""
        try:
            self.device.ctrl_transfer(_TO_ENDPOINT, _SET_FEATURE, _ENDPOINT_HALT, self.stream_in)
        except usb.core.USBError as error:
            if is_gone(error):
                raise self.device_error(error, "resetting its stream") from error
            logger.debug("%s: halting the stream endpoint: %s", self.name, error)
        self.clear_halt(self.stream_in)

    def claim(self) -> None:
        """Claim the control and stream interfaces exclusively."""
        try:
            if not self._is_configured():
                self.device.set_configuration(self._configuration)
            for number in (self._control_interface, self.stream_interface):
                usb.util.claim_interface(self.device, number)
                self._claimed.append(number)
        except usb.core.USBError as error:
            self.release()
            raise self.device_error(error, "claiming it") from error

    def _is_configured(self) -> bool:
        try:
            # Setting the configuration again would reset the camera's state.
            active = self.device.get_active_configuration().bConfigurationValue
            return bool(active == self._configuration)
        except usb.core.USBError as error:
            if error.errno is None:
                return False
            raise

    def release(self) -> None:
        """Release the camera; never raises, even if it is disconnected."""
        self._claimed.clear()
        try:
            usb.util.dispose_resources(self.device)
        except usb.core.USBError as error:
            logger.debug("%s: releasing it: %s", self.name, error)

    @property
    def handle(self) -> Any:
        """The backend's handle of the open device."""
        return self.device._ctx.handle  # pyusb has no public way to it

    def send(self, packet: bytes, timeout_s: float) -> None:
        """Write one packet to the control endpoint; TimeoutError if the camera does not accept it in time."""
        try:
            self.device.write(self._control_out, packet, self._milliseconds(timeout_s))
        except usb.core.USBError as error:
            self._recover_control(error, self._control_out, "sending a command")

    def receive(self, size: int, timeout_s: float) -> bytes:
        """Read one packet of at most `size` bytes from the control endpoint; TimeoutError if none arrives."""
        # with room for whole packets, a longer reply than expected cannot cause an overflow error
        room = -(-size // 1024) * 1024
        try:
            packet: array[int] = self.device.read(self._control_in, room, self._milliseconds(timeout_s))
        except usb.core.USBError as error:
            self._recover_control(error, self._control_in, "reading a reply")
            raise TimeoutError from error
        return packet.tobytes()

    @staticmethod
    def _milliseconds(timeout_s: float) -> int:
        return max(1, round(timeout_s * 1000))  # for libusb, 0 means no timeout

    def _recover_control(self, error: usb.core.USBError, endpoint: int, doing: str) -> None:
        if is_timeout(error):
            raise TimeoutError(f"no reply ({doing})") from error
        if error.errno in (errno.EPIPE, errno.EOVERFLOW):
            self.clear_halt(endpoint)
            raise TimeoutError(f"the control endpoint stalled ({doing})") from error
        raise self.device_error(error, doing) from error

    def clear_halt(self, endpoint: int) -> None:
        """Clear the halt of a stalled endpoint."""
        try:
            self.device.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise self.device_error(error, "clearing a stalled endpoint") from error

    def unplugged(self, doing: str) -> CameraLost:
        """The error of a camera that is no longer there."""
        return CameraLost(f"{self.name}: is no longer connected ({doing}); plug it in again")

    def device_error(self, error: usb.core.USBError, doing: str) -> DeviceError:
        """A DeviceError for an error of the bus."""
        if is_gone(error):
            return self.unplugged(doing)
        if error.errno == errno.EACCES:
            return DeviceError(f"{self.name}: {_no_access()}")
        if error.errno == errno.EBUSY:
            return DeviceError(f"{self.name}: is in use by another program; close that program")
        return DeviceError(f"{self.name}: {doing}: {error}; unplug the camera and plug it in again")


_DEVICE_INFO_TYPE: Final = 0x24
_DEVICE_INFO_SUBTYPE: Final = 0x01
_DEVICE_INFO_LENGTH: Final = 20
_VENDOR_INDEX: Final = 12
_MODEL_INDEX: Final = 13
_SERIAL_INDEX: Final = 17


SUPER_SPEED: Final = 4
_SPEED_NAMES: Final = {
    1: "low speed",
    2: "full speed",
    3: "high speed",
    SUPER_SPEED: "SuperSpeed",
    5: "SuperSpeed+",
}
"""Names of the speeds in data sheets, by libusb's numbers."""


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera on the bus; texts that cannot be read are empty."""

    vendor: str
    model: str
    serial: str
    usb_speed: int
    """libusb's number of the speed; 0 if it is unknown."""
    accessible: bool
    """Whether there are permission and driver to open the camera."""
    device: Any
    """pyusb's object of the device."""

    @property
    def speed_text(self) -> str:
        """Name of the speed in data sheets."""
        return _SPEED_NAMES.get(self.usb_speed, "unknown speed")

    @property
    def name(self) -> str:
        """Name of the camera in messages."""
        maker = f"{self.vendor} {self.model}".strip()
        maker = maker or f"{self.device.idVendor:04x}:{self.device.idProduct:04x}"
        return f"USB3 Vision camera {maker} (serial {self.serial or 'unreadable'})"


def find_cameras(backend: usb.backend.IBackend | None = None) -> tuple[FoundCamera, ...]:
    """All connected USB3 Vision cameras. Raises DeviceError if libusb is missing."""
    devices = usb.core.find(find_all=True, backend=backend or _libusb(), custom_match=_is_vision)
    return tuple(_describe(device) for device in devices)


def list_cameras() -> list[PluggedCamera]:
    """All connected USB3 Vision cameras for ``rig doctor``, with the USB speed as `connection`."""
    problem = ""
    try:
        load_genapi()
    except DeviceError as error:
        problem = str(error)
    return [
        PluggedCamera(
            driver="usb3vision",
            name=f"{camera.vendor} {camera.model}".strip(),
            serial=camera.serial,
            connection=camera.speed_text,
            problem=problem if camera.accessible else _no_access(),
        )
        for camera in find_cameras()
    ]


def find_camera(serial: str | None, backend: usb.backend.IBackend | None = None) -> FoundCamera:
    """The camera with this serial number; None: the only one connected.

    Raises DeviceError as `only_camera`, and where there is no permission to open the camera.
    """
    cameras = find_cameras(backend)
    # the serial number of a camera without permission is unknown, so it may be the requested one
    refused = [camera for camera in cameras if not camera.accessible]
    if refused and serial is not None and all(camera.serial != serial for camera in cameras):
        chosen = refused[0]
    else:
        named = [(camera.name, camera.serial, camera) for camera in cameras]
        chosen = only_camera("usb3vision", named, serial)
    if not chosen.accessible:
        raise DeviceError(f"{chosen.name}: {_no_access()}")
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


def _interfaces(device: Any) -> Iterator[tuple[int, Any]]:
    """All interfaces of a device, each with the number of its configuration."""
    for configuration in device:
        for interface in configuration:
            yield configuration.bConfigurationValue, interface


def _is_of_vision(interface: Any) -> bool:
    return (interface.bInterfaceClass, interface.bInterfaceSubClass) == (VISION_CLASS, VISION_SUBCLASS)


def _is_vision(device: Any) -> bool:
    try:
        return any(_is_of_vision(interface) for _, interface in _interfaces(device))
    except usb.core.USBError:
        return False  # unplugged during the search, or without valid descriptors


def _describe(device: Any) -> FoundCamera:
    indices = _string_indices(device)
    try:
        vendor, model, serial = (_text(device, index) for index in indices)
        accessible = True
    except (usb.core.USBError, NotImplementedError) as error:
        vendor = model = serial = ""
        # on Windows, a device without the driver WinUSB raises NotImplementedError
        accessible = isinstance(error, usb.core.USBError) and error.errno != errno.EACCES
    finally:
        usb.util.dispose_resources(device)
    return FoundCamera(vendor, model, serial, device.speed or 0, accessible, device)


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
    for _, interface in _interfaces(device):
        extra = bytes(interface.extra_descriptors)
        while len(extra) >= 3 and extra[0] >= 3:
            length, kind, subtype = extra[0], extra[1], extra[2]
            if (kind, subtype) == (_DEVICE_INFO_TYPE, _DEVICE_INFO_SUBTYPE):
                if length >= _DEVICE_INFO_LENGTH and len(extra) >= length:
                    return extra[_VENDOR_INDEX], extra[_MODEL_INDEX], extra[_SERIAL_INDEX]
                break
            extra = extra[length:]
    return device.iManufacturer, device.iProduct, device.iSerialNumber
