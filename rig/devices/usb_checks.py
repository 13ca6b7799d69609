"""Checks whether this computer can operate a USB camera: permission, USB speed, buffer memory."""

import sys
from collections.abc import Iterator
from pathlib import Path

from acquisition.cameras.usb3vision.discovery import FoundCamera, find_cameras, udev_rule
from processing.errors import DeviceError
from rig.presentation import Verdict

_USBFS_MEMORY = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
_SLOW = ("low", "full", "high")
_BUFFERED_FRAMES = 8


def check_usb_camera(camera: FoundCamera) -> tuple[Verdict, ...]:
    """Check the permission to open the camera, and the negotiated USB speed."""
    rule = udev_rule()
    allowed = Verdict(
        "camera permission",
        camera.accessible,
        camera.name if camera.accessible else f"no permission to open {camera.name}",
        ""
        if camera.accessible
        else f"only root may open USB devices unless a udev rule allows it: sudo cp {rule} "
        "/etc/udev/rules.d, sudo udevadm control --reload, then plug the camera in again",
    )
    slow = camera.usb_speed.split()[0].lower() in _SLOW if camera.usb_speed else False
    speed = Verdict(
        "camera USB speed",
        not slow,
        camera.usb_speed or "unknown",
        "use a USB 3 port (blue, or marked SS) and a USB 3 cable, without a hub" if slow else "",
    )
    return allowed, speed


def check_usb_cameras(serial: str | None) -> Iterator[Verdict]:
    """Check the USB3 Vision cameras that may have this serial number; None: all of them."""
    try:
        cameras = find_cameras()
    except DeviceError as missing:
        yield Verdict("libusb", False, str(missing), "pip install libusb-package")
        return
    for camera in cameras:
        if serial is None or not camera.serial or camera.serial == serial:
            yield from check_usb_camera(camera)


def check_usb_memory(frame_bytes: int, memory: Path = _USBFS_MEMORY) -> tuple[Verdict, ...]:
    """Check that Linux allows enough memory for the USB transfers of several frames at the same time."""
    if sys.platform != "linux" or not memory.is_file():
        return ()
    limit_mb = int(memory.read_text())
    wanted_mb = -(-_BUFFERED_FRAMES * frame_bytes // 2**20)
    # 0 means no limit
    enough = limit_mb == 0 or limit_mb >= wanted_mb
    return (
        Verdict(
            "USB buffer memory",
            enough,
            f"{limit_mb} MB for all USB devices, {wanted_mb} MB hold {_BUFFERED_FRAMES} frames",
            "" if enough else f"echo {2 * wanted_mb} | sudo tee {memory}",
        ),
    )
