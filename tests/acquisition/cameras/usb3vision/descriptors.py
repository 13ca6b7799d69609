"""USB 3 descriptors of the test camera."""

import struct

STRINGS = {1: "Testwerk", 2: "Pendulum Eye", 3: "", 4: "2F1E0000DEAD", 5: "Test family", 6: "1.0"}
SERIAL_STRING = 3
CONTROL_OUT, CONTROL_IN, EVENT_IN, STREAM_IN = 0x01, 0x81, 0x82, 0x83
VENDOR_ID, PRODUCT_ID = 0x1D6B, 0x0105
PACKET = 1024


def device_descriptor() -> bytes:
    """Eighteen bytes: USB 3.0, class EF/02/01 (interface association)."""
    return struct.pack(
        "<BBHBBBBHHHBBBB", 18, 1, 0x0300, 0xEF, 2, 1, 9, VENDOR_ID, PRODUCT_ID, 0x0100, 1, 2, SERIAL_STRING, 1
    )


def _endpoint(address: int) -> bytes:
    return struct.pack("<BBBBHB", 7, 5, address, 2, PACKET, 0) + struct.pack("<BBBBH", 6, 0x30, 0, 0, 0)


def _interface(number: int, protocol: int, endpoints: tuple[int, ...], extra: bytes = b"") -> bytes:
    head = struct.pack("<9B", 9, 4, number, 0, len(endpoints), 0xEF, 5, protocol, 0)
    return head + extra + b"".join(_endpoint(address) for address in endpoints)


def vision_descriptor() -> bytes:
    """Twenty bytes of the control interface: versions and string indices."""
    #            len type sub  GenCP 1.0   U3V 1.0    guid vendor model family version info serial user speeds
    return struct.pack(
        "<BBBIIBBBBBBBBB", 20, 0x24, 1, 0x00010000, 0x00010000, 4, 1, 2, 5, 6, 6, SERIAL_STRING, 0, 8
    )


def configuration_descriptor() -> bytes:
    """One configuration with control, event and stream interface."""
    association = struct.pack("<8B", 8, 11, 0, 3, 0xEF, 5, 0, 0)
    body = (
        association
        + _interface(0, 0, (CONTROL_IN, CONTROL_OUT), vision_descriptor())
        + _interface(1, 1, (EVENT_IN,))
        + _interface(2, 2, (STREAM_IN,))
    )
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 3, 1, 0, 0x80, 50) + body


def bos_descriptor() -> bytes:
    """Binary object store: the SuperSpeed capability that a USB 3 device must have."""
    usb2 = struct.pack("<BBBI", 7, 16, 2, 0)
    super_speed = struct.pack("<BBBBHBBH", 10, 16, 3, 0, 0x000E, 3, 10, 0x07FF)
    return struct.pack("<BBHB", 5, 15, 5 + len(usb2) + len(super_speed), 2) + usb2 + super_speed


def string_descriptor(index: int, serial: str) -> bytes:
    """A string descriptor; index 0 is the list of languages."""
    if index == 0:
        return struct.pack("<BBH", 4, 3, 0x0409)
    text = (serial if index == SERIAL_STRING else STRINGS[index]).encode("utf-16-le")
    return struct.pack("<BB", 2 + len(text), 3) + text
