"""Converts the bytes of a buffer to a grey image; the values are not changed."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import PixelFormat
from acquisition.cameras.v4l2.kernel import PixelLayout
from acquisition.frame import Image


class Layout(NamedTuple):
    """Grey values in a buffer: their `pixel_format`, type, distance in a row and first position (in
    values).

    `packed` are the pixels of a group in MIPI's packing: a byte with the high bits of each, then one with the
    low bits of all, least significant first; 0 if pixels are whole bytes.
    """

    pixel_format: PixelFormat
    dtype: str
    step: int = 1
    offset: int = 0
    packed: int = 0


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
}


def choose(offered: list[str], wanted: PixelFormat | None) -> str | None:
    """Code of the preferred layout among the offered ones, with the wanted pixel format; None if there is
    none.
    """
    for fourcc, layout in LAYOUTS.items():
        if fourcc in offered and wanted in (None, layout.pixel_format):
            return fourcc
    return None


def possible(offered: list[str]) -> list[PixelFormat]:
    """Pixel formats that follow from the offered layouts."""
    return list(dict.fromkeys(layout.pixel_format for fourcc, layout in LAYOUTS.items() if fourcc in offered))


def image_bytes(layout: PixelLayout) -> int:
    """Number of bytes of the grey part of an image in its buffer."""
    return layout.row_bytes * layout.height_px


def to_image(data: memoryview, layout: PixelLayout) -> Image:
    """A copy of the grey values, shape (height, width); `data` holds at least `image_bytes`."""
    kind = LAYOUTS[layout.fourcc]
    rows = np.frombuffer(data, np.uint8, image_bytes(layout)).reshape(layout.height_px, layout.row_bytes)
    if kind.packed:
        return _unpacked(rows, layout.width_px, kind.packed)
    pixels = rows[:, : layout.width_px * kind.step * np.dtype(kind.dtype).itemsize]
    if kind.dtype != "u1":
        image: Image = pixels.view(kind.dtype).astype(np.uint16, copy=True)
    else:
        image = pixels[:, kind.offset :: kind.step].copy()
    image.flags.writeable = False
    return image


def _unpacked(rows: NDArray[np.uint8], width_px: int, group: int) -> Image:
    """Pixels of rows of groups of `group` bytes and one more with their low bits."""
    groups = -(-width_px // group)
    data = rows[:, : groups * (group + 1)].reshape(len(rows), groups, group + 1)
    bits = 8 // group
    low = data[:, :, group:] >> (bits * np.arange(group, dtype=np.uint8)) & np.uint8((1 << bits) - 1)
    pixels = data[:, :, :group].astype(np.uint16) << bits | low
    image: Image = np.ascontiguousarray(pixels.reshape(len(rows), -1)[:, :width_px])
    image.flags.writeable = False
    return image
