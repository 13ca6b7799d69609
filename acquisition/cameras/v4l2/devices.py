"""Video devices of Linux, the search for them, and the layouts of their pixels."""

import errno
import os
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import BAYER_PERIOD_PX, ColourPlane, Image, PixelFormat, PluggedCamera
from acquisition.cameras.pixel_formats import place_in_mosaic
from acquisition.cameras.reading import only_camera
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.kernel import PixelLayout
from processing.errors import DeviceError


class Layout(NamedTuple):
    """Layout of the grey values in a buffer."""

    depth: PixelFormat
    dtype: str
    step: int = 1
    """Distance of neighbouring grey values in a row, in values of `dtype`."""
    offset: int = 0
    """Position of the first grey value, in values of `dtype`."""
    packed: int = 0
    """Pixels in a MIPI group, which has a byte with the high bits of each, then a byte with the low bits of
    all, least significant first; 0: pixels are whole bytes."""
    colours: str = ""
    """Colours of the first two pixels of the first row of a Bayer mosaic."""


_MOSAICS: Final = {
    Layout("mono8", "u1"): {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BA81"},
    Layout("mono10", "<u2"): {"RG": "RG10", "GR": "BA10", "GB": "GB10", "BG": "BG10"},
    Layout("mono12", "<u2"): {"RG": "RG12", "GR": "BA12", "GB": "GB12", "BG": "BG12"},
    Layout("mono14", "<u2"): {"RG": "RG14", "GR": "GR14", "GB": "GB14", "BG": "BG14"},
    Layout("mono16", "<u2"): {"RG": "RG16", "GR": "GR16", "GB": "GB16", "BG": "BYR2"},
    Layout("mono10", "u1", packed=4): {"RG": "pRAA", "GR": "pgAA", "GB": "pGAA", "BG": "pBAA"},
    Layout("mono12", "u1", packed=2): {"RG": "pRCC", "GR": "pgCC", "GB": "pGCC", "BG": "pBCC"},
}
# in order of preference: values of a grey sensor before the luminance of a colour camera
LAYOUTS: Final[dict[str, Layout]] = {
    "GREY": Layout("mono8", "u1"),
    "Y10 ": Layout("mono10", "<u2"),
    "Y12 ": Layout("mono12", "<u2"),
    "Y14 ": Layout("mono14", "<u2"),
    "Y16 ": Layout("mono16", "<u2"),
    "Y10P": Layout("mono10", "u1", packed=4),
    "Y12P": Layout("mono12", "u1", packed=2),
    "YUYV": Layout("mono8", "u1", step=2),
    "UYVY": Layout("mono8", "u1", step=2, offset=1),
    "NV12": Layout("mono8", "u1"),
} | {
    fourcc: layout._replace(colours=colours)
    for layout, fourccs in _MOSAICS.items()
    for colours, fourcc in fourccs.items()
}


def image_bytes(layout: PixelLayout) -> int:
    """Number of bytes of the grey part of an image in its buffer."""
    return layout.row_bytes * layout.height_px


def to_image(data: memoryview, layout: PixelLayout, plane: ColourPlane | None = None) -> Image:
    """A copy of the grey values, shape (height, width), or of the values of one colour of a mosaic.

    `data` holds at least `image_bytes`.
    """
    values = LAYOUTS[layout.fourcc]
    rows = np.frombuffer(data, np.uint8, image_bytes(layout)).reshape(layout.height_px, layout.row_bytes)
    row, column, period = (*place_in_mosaic(values.colours, plane), BAYER_PERIOD_PX) if plane else (0, 0, 1)
    rows = rows[row::period]
    pixels: NDArray[Any]
    if values.packed:
        pixels = _unpacked(rows, layout.width_px, values.packed)
    else:
        pixels = rows[:, : layout.width_px * values.step * np.dtype(values.dtype).itemsize]
        if values.dtype == "u1":
            pixels = pixels[:, values.offset :: values.step]
        else:
            pixels = pixels.view(values.dtype).astype(np.uint16)
    image: Any = np.array(pixels[:, column::period], order="C")
    image.flags.writeable = False
    return cast("Image", image)


def _unpacked(rows: NDArray[np.uint8], width_px: int, group: int) -> NDArray[np.uint16]:
    """Pixels from rows of groups: `group` high bytes, then one of low bits."""
    groups = -(-width_px // group)
    data = rows[:, : groups * (group + 1)].reshape(len(rows), groups, group + 1)
    bits = 8 // group
    low = data[:, :, group:] >> (bits * np.arange(group, dtype=np.uint8)) & np.uint8((1 << bits) - 1)
    pixels = data[:, :, :group].astype(np.uint16) << bits | low
    return pixels.reshape(len(rows), -1)[:, :width_px].astype(np.uint16, copy=False)


_SYSFS = Path("/sys/class/video4linux")


class VideoDevice(NamedTuple):
    """One device that delivers images."""

    path: str
    name: str
    bus: str
    serial: str
    formats: tuple[str, ...]
    """Four-character codes of the formats that the device offers."""
    modes: tuple[str, ...]
    """Texts of the supported formats, each with an image size and its highest rate."""
    problem: str = ""
    """Reason why the device cannot be opened; empty if it can."""


def list_devices() -> list[VideoDevice]:
    """All devices that capture images, in order of their number, including those in use."""
    if not _SYSFS.is_dir():
        return []
    nodes = sorted(
        (entry.name for entry in _SYSFS.iterdir() if entry.name.startswith("video")),
        key=lambda name: int(name.removeprefix("video")),
    )
    devices = [_query(f"/dev/{node}", _serial(_SYSFS / node)) for node in nodes]
    return [device for device in devices if device is not None]


def list_cameras() -> list[PluggedCamera]:
    """All cameras for ``rig doctor``; DeviceError on any system but Linux."""
    if sys.platform != "linux":
        raise DeviceError("v4l2: there are such cameras on Linux only")
    cameras = []
    for device in list_devices():
        problem = device.problem
        if not problem and not device.modes:
            problem = f"no grey or uncompressed format, only {', '.join(device.formats)}"
        cameras.append(PluggedCamera("v4l2", device.name, device.serial, device.path, device.modes, problem))
    return cameras


def find_device(path: str | None, serial: str | None) -> VideoDevice:
    """The device with this path (or number) or this serial number; without either, the only one connected.

    Raises DeviceError where the choice is not clear (the message lists the devices) or permission is missing.
    """
    devices = list_devices()
    if path is not None:
        path = f"/dev/video{path}" if path.isdigit() else path
        matching = [device for device in devices if device.path == os.path.realpath(path)]
        if not matching:
            listed = "; ".join(f"{device.path} {device.name}".strip() for device in devices)
            raise DeviceError(f"{path}: is not a camera; there are: {listed or 'none'}")
        serial = None
    else:
        matching = [device for device in devices if serial in (None, device.serial)] or devices
    readable = [device for device in matching if not LAYOUTS.keys().isdisjoint(device.formats)]
    named = [
        (f"{device.path} {device.name} {device.serial}".strip(), device.serial, device)
        for device in readable or matching
    ]
    chosen = only_camera("v4l2", named, serial, "camera.v4l2.device")
    if chosen.problem:
        raise DeviceError(chosen.problem)
    return chosen


def find_again(known: VideoDevice) -> VideoDevice:
    """Find the device `known` again, whose number may have changed.

    Raises DeviceError while it is not there, or cannot be opened.
    """
    candidates = [
        device for device in list_devices() if (device.name, device.serial) == (known.name, known.serial)
    ]
    # two cameras of one model without serial numbers are told apart by their place on the bus
    for field in ("bus", "path"):
        if len(candidates) > 1:
            candidates = [device for device in candidates if getattr(device, field) == getattr(known, field)]
    if not candidates:
        identity = f"{known.name} {known.serial}".strip()
        raise DeviceError(f"{known.path}: {identity} is not connected any more; plug it in again")
    if candidates[0].problem:
        raise DeviceError(candidates[0].problem)
    return candidates[0]


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


def _query(path: str, serial: str) -> VideoDevice | None:
    """The device at a path, as it describes itself; None where none that delivers images answers."""
    try:
        device = kernel.open_device(path)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            return None
        return VideoDevice(path, "", "", serial, (), (), refusal(path, error))
    try:
        identity = kernel.capabilities(device)
        if not identity.captures:
            return None
        formats = kernel.formats(device)
        modes = [
            f"{LAYOUTS[fourcc].depth} ({fourcc.strip()}) {width} x {height}"
            + (f" at {rate:g} Hz" if rate == rate else "")
            for fourcc in formats
            if fourcc in LAYOUTS
            for width, height in kernel.sizes(device, fourcc)
            for rate in [kernel.highest_rate_hz(device, fourcc, width, height)]
        ]
        return VideoDevice(path, identity.card, identity.bus, serial, tuple(formats), tuple(modes))
    except OSError:
        return None
    finally:
        os.close(device)


def _serial(entry: Path) -> str:
    """Serial number of the USB device to which this entry of sysfs belongs; empty if it has none."""
    try:
        device = (entry / "device").resolve()
        for folder in (device, *device.parents):
            if (folder / "serial").is_file():
                return (folder / "serial").read_text(encoding="utf-8").strip()
    except OSError:
        pass
    return ""
