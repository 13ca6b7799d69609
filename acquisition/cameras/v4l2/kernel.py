"""The kernel's Video4Linux calls needed for a grey camera (linux/videodev2.h, 64 bit). All raise OSError."""

import contextlib
import errno
import math
import os
import struct
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

try:
    import fcntl
except ImportError:
    # on Windows nothing of this module is called, because the search for cameras refuses earlier
    fcntl = None  # type: ignore[assignment]

CAPTURE: Final = 1
MEMORY_MAPPED: Final = 1
STREAMING_CAPTURE: Final = 0x0400_0001
FLAG_ERROR: Final = 0x40
CROP, CROP_BOUNDS = 0, 2
CONTROL_OFF: Final = 0x1 | 0x4 | 0x10  # disabled, read only, inactive: cannot be set at present
NEXT_CONTROL: Final = 0x8000_0000
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
AUTO_GAIN, GAIN = 0x00980912, 0x00980913
MANUAL_EXPOSURE: Final = 1
AUTO_WHITE_BALANCE, AUTO_HUE, AUTO_BRIGHTNESS, BACKLIGHT = 0x0098090C, 0x00980919, 0x00980920, 0x0098091C
AUTOMATIC: Final = {EXPOSURE_AUTO: MANUAL_EXPOSURE} | dict.fromkeys(
    (EXPOSURE_PRIORITY, AUTO_GAIN, AUTO_WHITE_BALANCE, AUTO_HUE, AUTO_BRIGHTNESS, BACKLIGHT), 0
)
"""Values that switch off the camera's automatic exposure, gain, white balance and brightness."""


def _code(direction: int, number: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("V") << 8 | number


_QUERY_CAPABILITIES = _code(2, 0, 104)
_ENUM_FORMAT = _code(3, 2, 64)
_GET_FORMAT, _SET_FORMAT = _code(3, 4, 208), _code(3, 5, 208)
_REQUEST_BUFFERS, _QUERY_BUFFER = _code(3, 8, 20), _code(3, 9, 88)
_QUEUE, _DEQUEUE = _code(3, 15, 88), _code(3, 17, 88)
_STREAM_ON, _STREAM_OFF = _code(1, 18, 4), _code(1, 19, 4)
_GET_PARAMETERS, _SET_PARAMETERS = _code(3, 21, 204), _code(3, 22, 204)
_GET_CONTROL, _SET_CONTROL, _QUERY_CONTROL = _code(3, 27, 8), _code(3, 28, 8), _code(3, 36, 68)
_ENUM_SIZES, _ENUM_INTERVALS = _code(3, 74, 44), _code(3, 75, 52)
_GET_SELECTION, _SET_SELECTION = _code(3, 94, 64), _code(3, 95, 64)

_BUFFER = struct.Struct("<5I4xqq16sIIQI2I4x")


class Capabilities(NamedTuple):
    """Identity of a video device, and whether it streams images."""

    driver: str
    card: str
    bus: str
    captures: bool


class PixelLayout(NamedTuple):
    """Format of the images in memory; `fourcc` is its four-character code."""

    width_px: int
    height_px: int
    fourcc: str
    row_bytes: int


class Control(NamedTuple):
    """One control of the device, with its range."""

    number: int
    name: str
    lowest: int
    highest: int
    can_be_set: bool


class Rectangle(NamedTuple):
    """A region of the sensor, in px."""

    left: int
    top: int
    width: int
    height: int


class FilledBuffer(NamedTuple):
    """Number of a buffer that the driver has filled; `time_ns` is the driver's timestamp of the frame."""

    buffer: int
    bytes_used: int
    flags: int
    time_ns: int
    sequence: int


def capabilities(device: int) -> Capabilities:
    """Identity of a device, and whether it streams images."""
    data = _call(device, _QUERY_CAPABILITIES, bytes(104))
    driver, card, bus, _, all_flags, device_flags = struct.unpack_from("<16s32s32s3I", data)
    flags = device_flags if all_flags & 0x8000_0000 else all_flags
    captures = flags & STREAMING_CAPTURE == STREAMING_CAPTURE
    return Capabilities(_text(driver), _text(card), _text(bus), captures)


def formats(device: int) -> list[str]:
    """Four-character codes of the formats that a device offers."""
    found = _enumerated(device, _ENUM_FORMAT, lambda index: struct.pack("<II56x", index, CAPTURE))
    return [data[44:48].decode("latin-1") for data in found]


def sizes(device: int, fourcc: str) -> list[tuple[int, int]]:
    """Sizes (width, height) of a format in px; only the largest if there is a continuous range."""
    found = []
    code = fourcc.encode("latin-1")
    for data in _enumerated(device, _ENUM_SIZES, lambda index: struct.pack("<I4s36x", index, code)):
        kind, *values = struct.unpack_from("<7I", data, 8)
        found.append((values[0], values[1]) if kind == 1 else (values[1], values[4]))
        if kind != 1:
            break
    return found


def highest_rate_hz(device: int, fourcc: str, width_px: int, height_px: int) -> float:
    """The highest frame rate for a size; NaN if the driver does not report it."""
    best = float("nan")
    size = (fourcc.encode("latin-1"), width_px, height_px)
    for data in _enumerated(device, _ENUM_INTERVALS, lambda index: struct.pack("<I4sII36x", index, *size)):
        kind, numerator, denominator = struct.unpack_from("<III", data, 16)
        if numerator:
            rate = denominator / numerator
            best = rate if math.isnan(best) else max(best, rate)
        if kind != 1:
            break
    return best


def get_layout(device: int) -> PixelLayout:
    """The present format."""
    return _layout(_call(device, _GET_FORMAT, struct.pack("<I204x", CAPTURE)))


def set_layout(device: int, width_px: int, height_px: int, fourcc: str) -> PixelLayout:
    """Set the format; returns the format that the driver has set, which may differ."""
    progressive = 1
    code = fourcc.encode("latin-1")
    request = struct.pack("<I4xII4sI", CAPTURE, width_px, height_px, code, progressive)
    return _layout(_call(device, _SET_FORMAT, request.ljust(208, b"\0")))


def get_rate_hz(device: int) -> float:
    """The present frame rate; NaN if the driver does not report it."""
    try:
        data = _call(device, _GET_PARAMETERS, struct.pack("<I200x", CAPTURE))
    except OSError:
        return float("nan")
    numerator, denominator = struct.unpack_from("<II", data, 12)
    return denominator / numerator if numerator else float("nan")


def set_rate_hz(device: int, rate_hz: float) -> None:
    """Set the frame rate; the driver may set another one."""
    request = struct.pack("<IIIII", CAPTURE, 0, 0, 1000, round(rate_hz * 1000))
    _call(device, _SET_PARAMETERS, request.ljust(204, b"\0"))


def controls(device: int) -> list[Control]:
    """All controls, in the driver's order."""
    found: list[Control] = []
    number = NEXT_CONTROL
    while True:
        try:
            data = _call(device, _QUERY_CONTROL, struct.pack("<I64x", number))
        except OSError:
            return found
        identity, kind, name, lowest, highest, _, _, flags = struct.unpack_from("<II32s4iI", data)
        if kind != 6:  # the title of a group of controls
            found.append(Control(identity, _text(name), lowest, highest, not flags & CONTROL_OFF))
        number = identity | NEXT_CONTROL


def get_control(device: int, number: int) -> int:
    """Value of a control."""
    value: int = struct.unpack_from("<Ii", _call(device, _GET_CONTROL, struct.pack("<Ii", number, 0)))[1]
    return value


def set_control(device: int, number: int, value: int) -> None:
    """Set a control; the driver may set another value."""
    _call(device, _SET_CONTROL, struct.pack("<Ii", number, value))


def get_selection(device: int, target: int) -> Rectangle | None:
    """The region that is read out (`target` CROP) or its bounds (CROP_BOUNDS); None if not supported."""
    try:
        data = _call(device, _GET_SELECTION, struct.pack("<II56x", CAPTURE, target))
    except OSError:
        return None
    return Rectangle(*struct.unpack_from("<iiII", data, 12))


def set_selection(device: int, region: Rectangle) -> None:
    """Set the region that is read out."""
    request = struct.pack("<IIIiiII", CAPTURE, CROP, 0, *region)
    _call(device, _SET_SELECTION, request.ljust(64, b"\0"))


def request_buffers(device: int, count: int) -> int:
    """Make the driver allocate buffers (0 frees them); returns the number allocated."""
    allocated: int = struct.unpack_from(
        "<I", _call(device, _REQUEST_BUFFERS, struct.pack("<III8x", count, CAPTURE, MEMORY_MAPPED))
    )[0]
    return allocated


def buffer_place(device: int, index: int) -> tuple[int, int]:
    """Offset for mmap and length of a buffer in bytes."""
    values = _BUFFER.unpack(_call(device, _QUERY_BUFFER, _buffer(index)))
    return values[10] & 0xFFFF_FFFF, values[11]


def queue(device: int, index: int) -> None:
    """Give a buffer to the driver to be filled."""
    _call(device, _QUEUE, _buffer(index))


def dequeue(device: int) -> FilledBuffer | None:
    """The next filled buffer; None if there is none yet."""
    try:
        values = _BUFFER.unpack(_call(device, _DEQUEUE, _buffer(0)))
    except OSError as error:
        if error.errno == errno.EAGAIN:
            return None
        raise
    return FilledBuffer(
        values[0], values[2], values[3], values[5] * 1_000_000_000 + values[6] * 1000, values[8]
    )


def stream(device: int, on: bool) -> None:
    """Start or stop the stream; stopping it returns all buffers."""
    _call(device, _STREAM_ON if on else _STREAM_OFF, struct.pack("<i", CAPTURE))


def open_device(path: str) -> int:
    """Open a device in non-blocking mode; returns the file descriptor."""
    return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)


def _buffer(index: int) -> bytes:
    return _BUFFER.pack(index, CAPTURE, 0, 0, 0, 0, 0, bytes(16), 0, MEMORY_MAPPED, 0, 0, 0, 0)


def _layout(data: bytes) -> PixelLayout:
    width_px, height_px, fourcc, _, row_bytes = struct.unpack_from("<II4s2I", data, 8)
    return PixelLayout(width_px, height_px, fourcc.decode("latin-1"), row_bytes)


def _enumerated(device: int, code: int, request: Callable[[int], bytes]) -> Iterator[bytes]:
    """Replies to the requests for numbers 0, 1, ... until the driver has no more."""
    with contextlib.suppress(OSError):
        for index in range(256):
            yield _call(device, code, request(index))


def _call(device: int, code: int, request: bytes) -> bytes:
    data = bytearray(request)
    while True:
        try:
            fcntl.ioctl(device, code, data)
        except InterruptedError:
            continue
        return bytes(data)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("utf-8", "replace")
