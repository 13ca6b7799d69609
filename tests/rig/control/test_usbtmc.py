"""USBTMC instruments are found by their USB numbers; tests/kernel tries the line itself."""

from pathlib import Path

import pytest

from rig.control.serial_port import PortLost
from rig.control.usbtmc import UsbTmcLine, find_usbtmc, is_usbtmc


def plugged(folder: Path, number: int, vendor: str, serial: str) -> None:
    """As the kernel shows an instrument: the class device of an interface below the USB device."""
    usb = folder / f"usb{number}"
    (usb / "1:1.0").mkdir(parents=True)
    (usb / "idVendor").write_text(vendor + "\n")
    (usb / "serial").write_text(serial + "\n")
    node = folder / "class" / f"usbtmc{number}"
    node.mkdir(parents=True)
    (node / "device").symlink_to(usb / "1:1.0")


def test_an_instrument_is_found_by_vendor_and_serial_number(tmp_path: Path) -> None:
    devices = tmp_path / "class"
    plugged(tmp_path, 0, "0957", "MY1")
    plugged(tmp_path, 1, "1313", "M1")
    assert find_usbtmc("usbtmc", 0x1313, devices) == "/dev/usbtmc1"
    plugged(tmp_path, 2, "1313", "M2")
    assert find_usbtmc("usbtmc:M2", 0x1313, devices) == "/dev/usbtmc2"
    with pytest.raises(
        PortLost, match="2 USBTMC instruments of vendor 1313 fit, there is usbtmc:M1, usbtmc:M2"
    ):
        find_usbtmc("usbtmc", 0x1313, devices)
    with pytest.raises(PortLost, match="usbtmc:M3: 0 USBTMC instruments"):
        find_usbtmc("usbtmc:M3", 0x1313, devices)
    assert find_usbtmc("/dev/usbtmc7", 0x1313, devices) == "/dev/usbtmc7"


def test_serial_ports_are_told_apart_and_a_missing_instrument_is_named() -> None:
    ports = ("usbtmc", "usbtmc:M1", "/dev/usbtmc0", "/dev/ttyUSB0", "socket://box:7000")
    assert [is_usbtmc(port) for port in ports] == [True, True, True, False, False]
    with pytest.raises(PortLost, match="/dev/usbtmc99: cannot open the instrument: No such file"):
        UsbTmcLine("/dev/usbtmc99", 0.5)
