"""Loading of pypylon when it is needed, and search for cameras."""

import warnings
from typing import Any

from acquisition.camera import PluggedCamera
from processing.errors import DeviceError, MissingPackage


def load_pylon() -> Any:
    """pypylon's module; DeviceError that says how to install it."""
    try:
        with warnings.catch_warnings():
            # importing its binary module raises warnings, and would fail if warnings are errors
            warnings.simplefilter("ignore")
            from pypylon import pylon
    except ImportError:
        raise DeviceError(str(MissingPackage("camera.driver = 'pylon'", "pypylon"))) from None
    return pylon


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by pylon, with the transport layer as `place`."""
    devices = load_pylon().TlFactory.GetInstance().EnumerateDevices()
    return [
        PluggedCamera("pylon", device.GetModelName(), device.GetSerialNumber(), device.GetDeviceClass())
        for device in devices
    ]
