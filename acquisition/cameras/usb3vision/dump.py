"""What a camera shows of itself, as files that an owner can send as evidence of how it behaves.

Serial numbers and names given by a user are left out.
"""

import json
import time
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from acquisition.cameras.usb3vision.gencp import RegisterRefused
from acquisition.cameras.usb3vision.open_camera import UsbConnection, read_description
from acquisition.cameras.usb3vision.transfers import BlockingTransfers
from processing.errors import DeviceError

_TRANSFERS: Final = 24
_READ_S: Final = 0.5
_HEAD: Final = 64
_LARGEST: Final = 1 << 30
# Registers: address relative to the base, length. The serial number (0x144, 64 bytes) and the
# name given by the user (0x184, 64 bytes) of the first block are not among them.
_ABRM: Final = ((0x0, 0x144), (0x1C4, 0x3C))
_SBRM: Final = ((0x0, 0x48),)
_SIRM: Final = ((0x0, 0x30),)
_SBRM_ADDRESS: Final = 0x1D8
_PRIVATE: Final = ("serial", "deviceid", "userid", "username", "macaddress", "ipaddress")


def dump(session: UsbConnection, values: dict[str, Any]) -> dict[str, bytes]:
    """Files by name: descriptors, registers, description, features (`values`), first transfers."""
    channel, identity = session.channel, session.identity
    sbrm = int.from_bytes(channel.read(_SBRM_ADDRESS, 8), "little")
    registers = {
        "abrm": _registers(session, 0, _ABRM),
        "sbrm": _registers(session, sbrm, _SBRM),
        "sirm": _registers(session, identity.stream_address, _SIRM),
        "manifest": _registers(session, identity.manifest_address, ((0x0, 72),)),
    }
    public = {name: value for name, value in values.items() if not _is_private(name)}
    return {
        "descriptors.json": _json(_descriptors(session.link.device)),
        "registers.json": _json(registers),
        "description.xml": read_description(channel, identity.manifest_address, session.link.name).encode(),
        "features.json": _json(public),
        "transfers.json": _json(_transfers(session)),
    }


def _json(tree: Any) -> bytes:
    return json.dumps(tree, indent=1).encode()


def _is_private(name: str) -> bool:
    return any(word in name.lower().replace("_", "") for word in _PRIVATE)


def _registers(session: UsbConnection, base: int, places: Iterable[tuple[int, int]]) -> dict[str, str]:
    found = {}
    for start, length in places:
        for at in range(start, start + length, 4):
            try:
                found[f"0x{base + at:X}"] = session.channel.read(base + at, 4).hex()
            except RegisterRefused as refused:
                found[f"0x{base + at:X}"] = f"refused, status 0x{refused.status:04X}"
    return found


def _descriptors(device: Any) -> dict[str, Any]:
    return {
        "vendor": f"{device.idVendor:04x}",
        "product": f"{device.idProduct:04x}",
        "usb": f"{device.bcdUSB:04x}",
        "speed": device.speed,
        "interfaces": [
            {
                "number": interface.bInterfaceNumber,
                "kind": [
                    interface.bInterfaceClass,
                    interface.bInterfaceSubClass,
                    interface.bInterfaceProtocol,
                ],
                "extra": bytes(interface.extra_descriptors).hex(),
                "endpoints": [
                    {"address": one.bEndpointAddress, "packet": one.wMaxPacketSize} for one in interface
                ],
            }
            for configuration in device
            for interface in configuration
        ],
    }


def _transfers(session: UsbConnection) -> list[dict[str, Any]]:
    """Sizes, times and beginnings of the first transfers, each read into a buffer that holds it whole."""
    registers, link = session.registers, session.link
    session.features.run_on()
    registers.enable(False)
    link.reset_stream()
    plan = registers.set_up(_LARGEST, 1 << 20)
    session.set_locked(True)
    registers.enable(True)
    transfers, found = BlockingTransfers(link), []
    buffer = np.empty(max(sum(plan.payload), 1 << 20), np.uint8)
    try:
        session.features.execute("AcquisitionStart")
        begin_s = time.monotonic()
        for _ in range(_TRANSFERS):
            transfers.submit(buffer)
            count = transfers.wait(_READ_S).byte_count
            found.append(
                {
                    "time_s": round(time.monotonic() - begin_s, 6),
                    "bytes": count,
                    "begins": buffer[: min(count, _HEAD)].tobytes().hex(),
                    "ends": buffer[max(count - _HEAD, 0) : count].tobytes().hex(),
                }
            )
    except (TimeoutError, DeviceError) as ended:
        found.append({"ended": str(ended) or "no more within half a second"})
    finally:
        session.halt_leftovers()
    return found
