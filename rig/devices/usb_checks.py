"""Whether this computer is fit for a USB camera: plain values for a table."""

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
    """Permission, and the speed that the port has agreed on."""
    rule = udev_rule()
    allowed = Verdict(
        "camera permission",
        camera.accessible,
        camera.name if camera.accessible else f"{camera.name} may not be opened",
        ""
        if camera.accessible
        else f"Linux gives USB devices to root alone until a rule says otherwise: sudo cp {rule} "
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
    """Every USB3 Vision camera that may be the one with this serial number; nothing where there is none."""
    try:
        cameras = find_cameras()
    except DeviceError as missing:
        yield Verdict("libusb", False, str(missing), "pip install libusb-package")
        return
    for camera in cameras:
        if serial is None or not camera.serial or camera.serial == serial:
            yield from check_usb_camera(camera)


def check_usb_memory(frame_bytes: int, memory: Path = _USBFS_MEMORY) -> tuple[Verdict, ...]:
    """Whether Linux lends enough memory to USB transfers for several frames under way at the same time."""
    if sys.platform != "linux" or not memory.is_file():
        return ()
    limit_mb = int(memory.read_text())
    wanted_mb = -(-_BUFFERED_FRAMES * frame_bytes // 2**20)
    # 0 means without a limit
    enough = limit_mb == 0 or limit_mb >= wanted_mb
    return (
        Verdict(
            "USB buffer memory",
            enough,
            f"{limit_mb} MB for all USB devices, {wanted_mb} MB hold {_BUFFERED_FRAMES} frames",
            "" if enough else f"echo {2 * wanted_mb} | sudo tee {memory}",
        ),
    )
