"""What is plugged in: cameras through each driver, serial ports."""

import importlib.util
import sys
from typing import NamedTuple

from processing.errors import DeviceError

_OPTIONAL = {
    "pylon": ("pypylon", "pip install 'optical-pendulum-rig[pylon]'"),
    "aravis": ("gi", "Debian: apt install gir1.2-aravis-0.8 python3-gi"),
}


class CameraLine(NamedTuple):
    """One camera as a driver finds it. `problem` says why it can't be used, empty where it can."""

    driver: str
    name: str
    serial: str
    place: str
    modes: tuple[str, ...]
    problem: str = ""


def list_cameras() -> tuple[list[CameraLine], list[str]]:
    """Cameras that are plugged in, and one line for each driver that can't look for them."""
    cameras: list[CameraLine] = []
    notes: list[str] = []
    for look in (_usb3vision, _video, _pylon, _aravis):
        try:
            cameras += look()
        except DeviceError as error:
            notes.append(str(error))
    if sys.platform != "linux":
        notes.append("v4l2: OpenCV can't list devices; try camera.v4l2.device = '0', '1', ...")
    for driver, (module, remedy) in _OPTIONAL.items():
        if importlib.util.find_spec(module) is None:
            notes.append(f"{driver}: {module} is not installed, this driver is not looked through; {remedy}")
    return cameras, notes


def _usb3vision() -> list[CameraLine]:
    from acquisition.cameras.usb3vision.discovery import find_cameras, udev_rule

    remedy = f"no permission: copy {udev_rule()} to /etc/udev/rules.d and plug the camera in again"
    return [
        CameraLine(
            "usb3vision",
            f"{found.vendor} {found.model}".strip(),
            found.serial,
            found.usb_speed,
            (),
            "" if found.accessible else remedy,
        )
        for found in find_cameras()
    ]


def _video() -> list[CameraLine]:
    from acquisition.cameras.v4l2.devices import list_devices

    lines = []
    for found in list_devices():
        problem = found.problem
        if not problem and not found.modes:
            problem = f"no grey or uncompressed format, only {', '.join(found.formats)}"
        lines.append(CameraLine("v4l2", found.name, found.serial, found.path, found.modes, problem))
    return lines


def _pylon() -> list[CameraLine]:
    if importlib.util.find_spec("pypylon") is None:
        return []
    from acquisition.cameras.pylon import list_cameras as listed

    return [CameraLine("pylon", model, serial, place, ()) for model, serial, place in listed()]


def _aravis() -> list[CameraLine]:
    if importlib.util.find_spec("gi") is None:
        return []
    from acquisition.cameras.aravis.library import find_cameras

    return [
        CameraLine("aravis", f"{found.vendor} {found.model}", found.serial, found.place, ())
        for found in find_cameras()
    ]
