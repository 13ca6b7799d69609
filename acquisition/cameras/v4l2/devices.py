"""Search for connected Video4Linux devices, and choice of one."""

import errno
import os
import sys
from pathlib import Path
from typing import NamedTuple

from acquisition.camera import PluggedCamera
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.layouts import LAYOUTS, possible
from processing.errors import DeviceError

_SYSFS = Path("/sys/class/video4linux")


class VideoDevice(NamedTuple):
    """One device that delivers images.

    `formats` are four-character codes, `modes` the supported ones with size and largest rate as text.
    `problem` is the reason for which it cannot be opened, empty if it can.
    """

    path: str
    name: str
    bus: str
    serial: str
    formats: tuple[str, ...]
    modes: tuple[str, ...]
    problem: str = ""


def list_devices() -> list[VideoDevice]:
    """All devices that capture images, in order of their number, including those in use."""
    if not _SYSFS.is_dir():
        return []
    nodes = sorted(
        (entry.name for entry in _SYSFS.iterdir() if entry.name.startswith("video")),
        key=lambda name: int(name.removeprefix("video")),
    )
    found = [_look_at(f"/dev/{node}", _serial(_SYSFS / node)) for node in nodes]
    return [device for device in found if device is not None]


def list_cameras() -> list[PluggedCamera]:
    """The same for ``rig doctor``; DeviceError on systems without Video4Linux."""
    if sys.platform != "linux":
        raise DeviceError("v4l2: there are such cameras on Linux only")
    cameras = []
    for found in list_devices():
        problem = found.problem
        if not problem and not found.modes:
            problem = f"no grey or uncompressed format, only {', '.join(found.formats)}"
        cameras.append(PluggedCamera("v4l2", found.name, found.serial, found.path, found.modes, problem))
    return cameras


def find_device(path: str | None, serial: str | None) -> VideoDevice:
    """The device with this path (or number) or this serial number; without either, the only one connected.

    Raises
    ------
    DeviceError
        No such device; several, of which none is selected (the message lists them); or no permission.
    """
    there = list_devices()
    listed = "; ".join(f"{device.path} {device.name} {device.serial}".strip() for device in there)
    chosen = there
    if path is not None:
        path = f"/dev/video{path}" if path.isdigit() else path
        real = os.path.realpath(path)
        chosen = [device for device in there if device.path == real]
        if not chosen:
            raise DeviceError(f"{path}: is not a camera; there are: {listed or 'none'}")
    elif serial is not None:
        chosen = [device for device in there if device.serial == serial]
        if not chosen:
            raise DeviceError(
                f"no video device has the serial number {serial!r}; there are: {listed or 'none'}"
            )
    if not chosen:
        raise DeviceError("no video device was found; is the camera plugged in, and does lsusb show it?")
    usable = [device for device in chosen if _is_readable(list(device.formats))] or chosen
    if len(usable) > 1:
        raise DeviceError(f"several video devices: {listed}; set camera.v4l2.device to one of them")
    if usable[0].problem:
        raise DeviceError(usable[0].problem)
    return usable[0]


def find_again(known: VideoDevice) -> VideoDevice:
    """The device that was open before: whoever holds its old number, it may have come back with another.

    Raises DeviceError while it is not there, or cannot be opened.
    """
    same = [one for one in list_devices() if (one.name, one.serial) == (known.name, known.serial)]
    # of two cameras of one kind without serial numbers their place on the bus tells which is which
    for told in ("bus", "path"):
        if len(same) > 1:
            same = [one for one in same if getattr(one, told) == getattr(known, told)]
    if not same:
        who = f"{known.name} {known.serial}".strip()
        raise DeviceError(f"{known.path}: {who} is not connected any more; plug it in again")
    if same[0].problem:
        raise DeviceError(same[0].problem)
    return same[0]


def _is_readable(formats: list[str]) -> bool:
    return bool(possible(formats) or possible(formats, mosaic=True))


def refusal(path: str, error: OSError) -> str:
    """Error message for a device that cannot be opened."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return (
            f"{path}: no permission; add yourself to the group 'video' "
            "(sudo usermod -aG video $USER), log in again"
        )
    if error.errno == errno.EBUSY:
        return f"{path}: is in use by another program; close it"
    return f"{path}: {error.strerror or error}"


def _look_at(path: str, serial: str) -> VideoDevice | None:
    try:
        device = kernel.open_device(path)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            return None
        return VideoDevice(path, "", "", serial, (), (), refusal(path, error))
    try:
        who = kernel.capabilities(device)
        if not who.captures:
            return None
        formats = kernel.formats(device)
        modes = [
            f"{LAYOUTS[fourcc].pixel_format} ({fourcc.strip()}) {width} x {height}"
            + (f" at {rate:g} Hz" if rate == rate else "")
            for fourcc in formats
            if fourcc in LAYOUTS
            for width, height in kernel.sizes(device, fourcc)
            for rate in [kernel.highest_rate_hz(device, fourcc, width, height)]
        ]
        return VideoDevice(path, who.card, who.bus, serial, tuple(formats), tuple(modes))
    except OSError:
        return None
    finally:
        os.close(device)


def _serial(entry: Path) -> str:
    """Serial number of the USB device to which this entry of sysfs belongs; empty if it has none."""
    try:
        place = (entry / "device").resolve()
        for folder in (place, *place.parents):
            if (folder / "serial").is_file():
                return (folder / "serial").read_text(encoding="utf-8").strip()
    except OSError:
        pass
    return ""
