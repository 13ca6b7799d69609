"""A pyusb backend with test cameras, without a kernel."""

import errno
import struct
from array import array
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import usb.backend
import usb.core
from usb.backend import libusb1

from acquisition.cameras.drivers import Usb3VisionSettings
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from tests.acquisition.cameras.usb3vision import descriptors
from tests.acquisition.cameras.usb3vision.device import (
    OverrunError,
    StalledError,
    UnpluggedError,
    VisionDevice,
)

WITHOUT_GENICAM = "USB3 Vision cameras need genicam: pip install '.[usb3vision]'"


def _fields(structure: Any, count: int) -> list[str]:
    """Names of the first fields of a descriptor, as pyusb has them."""
    return [name for name, _ in structure._fields_[:count]]


DEVICE_FIELDS = _fields(libusb1._libusb_device_descriptor, 14)
CONFIGURATION_FIELDS = _fields(libusb1._libusb_config_descriptor, 8)
INTERFACE_FIELDS = _fields(libusb1._libusb_interface_descriptor, 9)
ENDPOINT_FIELDS = _fields(libusb1._libusb_endpoint_descriptor, 6)


def _usb_error(error: Exception) -> usb.core.USBError:
    if isinstance(error, TimeoutError):
        return usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
    if isinstance(error, UnpluggedError):
        return usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
    if isinstance(error, OverrunError):
        return usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
    return usb.core.USBError("Pipe error", -9, errno.EPIPE)


class InProcessBackend(usb.backend.IBackend):  # type: ignore[misc]
    """Serves test cameras to pyusb; `denied` cameras can't be opened."""

    def __init__(self, *devices: VisionDevice) -> None:
        pytest.importorskip("genicam.genapi", reason=WITHOUT_GENICAM)
        super().__init__()
        self.devices = list(devices)
        self.denied: set[str] = set()

    def enumerate_devices(self) -> Iterator[VisionDevice]:
        return iter([device for device in self.devices if not device.unplugged])

    def get_device_descriptor(self, dev: VisionDevice) -> Any:
        raw = struct.unpack("<BBHBBBBHHHBBBB", descriptors.device_descriptor())
        fields = dict(zip(DEVICE_FIELDS, raw, strict=True))
        return SimpleNamespace(
            **fields, address=self.devices.index(dev) + 1, bus=1, port_number=1, port_numbers=(1,), speed=4
        )

    def _descriptors(self) -> Iterator[bytes]:
        raw = descriptors.configuration_descriptor()
        while raw:
            yield raw[: raw[0]]
            raw = raw[raw[0] :]

    def get_configuration_descriptor(self, dev: VisionDevice, config: int) -> Any:
        if config:
            raise IndexError(config)
        raw = descriptors.configuration_descriptor()
        values = struct.unpack("<BBHBBBBB", raw[:9])
        fields = dict(zip(CONFIGURATION_FIELDS, values, strict=True))
        return SimpleNamespace(**fields, extra_descriptors=[])

    def get_interface_descriptor(self, dev: VisionDevice, intf: int, alt: int, config: int) -> Any:
        if alt:
            raise IndexError(alt)
        found, extra, endpoints = None, b"", 0
        for raw in self._descriptors():
            if raw[1] == 4:
                if found is not None and found[2] == intf:
                    break
                found, extra, endpoints = raw, b"", 0
            elif raw[1] == 5:
                endpoints += 1
            elif not endpoints and found is not None:
                extra += raw
        if found is None or found[2] != intf:
            raise IndexError(intf)
        return SimpleNamespace(
            **dict(zip(INTERFACE_FIELDS, found, strict=True)), extra_descriptors=array("B", extra)
        )

    def get_endpoint_descriptor(self, dev: VisionDevice, ep: int, intf: int, alt: int, config: int) -> Any:
        current, endpoints = -1, []
        for raw in self._descriptors():
            if raw[1] == 4:
                current = raw[2]
            elif raw[1] == 5 and current == intf:
                endpoints.append(raw)
        values = struct.unpack("<BBBBHB", endpoints[ep])
        fields = dict(zip(ENDPOINT_FIELDS, values, strict=True))
        return SimpleNamespace(**fields, bRefresh=0, bSynchAddress=0, extra_descriptors=[])

    def open_device(self, dev: VisionDevice) -> Any:
        if dev.serial in self.denied:
            raise usb.core.USBError("Access denied (insufficient permissions)", -3, errno.EACCES)
        if dev.unplugged:
            raise _usb_error(UnpluggedError())
        return SimpleNamespace(device=dev)

    def close_device(self, dev_handle: Any) -> None:
        if dev_handle.device.owner is dev_handle:
            dev_handle.device.owner = None

    def set_configuration(self, dev_handle: Any, config_value: int) -> None:
        dev_handle.device.configuration = config_value

    def get_configuration(self, dev_handle: Any) -> int:
        return int(dev_handle.device.configuration)

    def claim_interface(self, dev_handle: Any, intf: int) -> None:
        device = dev_handle.device
        if device.unplugged:
            raise _usb_error(UnpluggedError())
        if device.owner is not None and device.owner is not dev_handle:
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)
        device.owner = dev_handle

    def release_interface(self, dev_handle: Any, intf: int) -> None:
        if dev_handle.device.owner is dev_handle:
            dev_handle.device.owner = None

    def bulk_write(self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int) -> int:
        assert ep == descriptors.CONTROL_OUT
        try:
            dev_handle.device.control_out(bytes(data))
        except (UnpluggedError, StalledError, TimeoutError) as error:
            raise _usb_error(error) from None
        return len(data)

    def bulk_read(self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        device: VisionDevice = dev_handle.device
        timeout_s = timeout / 1000 if timeout else 1e6
        target = memoryview(buff).cast("B")
        try:
            if ep == descriptors.STREAM_IN:
                return device.stream_in(target, timeout_s)
            if ep == descriptors.CONTROL_IN:
                reply = device.control_in(len(target), timeout_s)
            else:
                reply = device.event_in(timeout_s)
        except (UnpluggedError, StalledError, OverrunError, TimeoutError) as error:
            raise _usb_error(error) from None
        target[: len(reply)] = reply
        return len(reply)

    def ctrl_transfer(
        self,
        dev_handle: Any,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,
    ) -> int:
        """Strings and halts, the only control requests that the driver makes."""
        device: VisionDevice = dev_handle.device
        if device.unplugged:
            raise _usb_error(UnpluggedError())
        if (bmRequestType, bRequest, wValue) == (0x02, 3, 0):
            device.halt(wIndex)
            return 0
        assert (bmRequestType, bRequest, wValue >> 8) == (0x80, 6, 3)
        raw = descriptors.string_descriptor(wValue & 0xFF, dev_handle.device.serial)
        count = min(len(raw), len(data))
        memoryview(data).cast("B")[:count] = raw[:count]
        return count

    def clear_halt(self, dev_handle: Any, ep: int) -> None:
        try:
            dev_handle.device.clear_halt(ep)
        except UnpluggedError as error:
            raise _usb_error(error) from None

    def is_kernel_driver_active(self, dev_handle: Any, intf: int) -> bool:
        return False


def camera_on(device: VisionDevice, **settings: object) -> Usb3VisionCamera:
    """The driver on a bus with this camera alone."""
    return Usb3VisionCamera(Usb3VisionSettings.model_validate(settings), InProcessBackend(device))
