"""What matches our own devices in rules of udev: laser drivers on USB, the controller's board."""

from rig.control.lasers.thorlabs4000 import USB_VENDOR as THORLABS

PICO = 0x2E8A
"""Raspberry Pi's USB vendor number, under which MicroPython presents the controller's board."""


def udev_matches() -> dict[str, str]:
    """For each kind of device what matches its node, in the language of udev's rules."""
    return {
        "laser drivers that the kernel's usbtmc serves": (
            f'SUBSYSTEM=="usbmisc", KERNEL=="usbtmc*", ATTRS{{idVendor}}=="{THORLABS:04x}"'
        ),
        "serial ports on USB: the controller's board, lasers, sensors": (
            'SUBSYSTEM=="tty", KERNEL=="ttyACM[0-9]*|ttyUSB[0-9]*", SUBSYSTEMS=="usb"'
        ),
    }


def udev_board() -> str:
    """What matches the controller's board itself."""
    return f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{PICO:04x}"'
