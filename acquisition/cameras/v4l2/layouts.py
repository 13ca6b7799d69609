"""Converts the bytes of a buffer to a grey image; the values are not changed."""

from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import ColourPlane, PixelFormat
from acquisition.cameras.pixel_formats import PITCH, place_in_mosaic
from acquisition.cameras.v4l2.kernel import PixelLayout
from acquisition.frame import Image


class Layout(NamedTuple):
    """Grey values in a buffer: their `pixel_format`, type, distance in a row and first position (in
    values).

    `packed` are the pixels of a group in MIPI's packing: a byte with the high bits of each, then one with the
    low bits of all, least significant first; 0 if pixels are whole bytes. `colours` are those of the first
    two pixels of the first row of a Bayer mosaic.
    """

    pixel_format: PixelFormat
    dtype: str
    step: int = 1
    offset: int = 0
    packed: int = 0
    colours: str = ""


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


def choose(offered: list[str], wanted: PixelFormat | None, *, mosaic: bool = False) -> str | None:
    """Code of the preferred layout among the offered ones, grey or with a Bayer mosaic, with the wanted pixel
    format; None if there is none.
    """
    fitting = (code for code in _usable(offered, mosaic) if wanted in (None, LAYOUTS[code].pixel_format))
    return next(fitting, None)


def possible(offered: list[str], *, mosaic: bool = False) -> list[PixelFormat]:
    """Pixel formats that follow from the offered layouts, grey or with a Bayer mosaic."""
    return list(dict.fromkeys(LAYOUTS[fourcc].pixel_format for fourcc in _usable(offered, mosaic)))


def _usable(offered: list[str], mosaic: bool) -> list[str]:
    return [
        fourcc for fourcc, layout in LAYOUTS.items() if fourcc in offered and bool(layout.colours) == mosaic
    ]


def image_bytes(layout: PixelLayout) -> int:
    """Number of bytes of the grey part of an image in its buffer."""
    return layout.row_bytes * layout.height_px


def to_image(data: memoryview, layout: PixelLayout, plane: ColourPlane | None = None) -> Image:
    """A copy of the grey values, shape (height, width), or of those of one colour of a mosaic.

    `data` holds at least `image_bytes`.
    """
    kind = LAYOUTS[layout.fourcc]
    rows = np.frombuffer(data, np.uint8, image_bytes(layout)).reshape(layout.height_px, layout.row_bytes)
    row, column, pitch = (*place_in_mosaic(kind.colours, plane), PITCH) if plane else (0, 0, 1)
    rows = rows[row::pitch]
    if kind.packed:
        return _own(_unpacked(rows, layout.width_px, kind.packed)[:, column::pitch])
    pixels = rows[:, : layout.width_px * kind.step * np.dtype(kind.dtype).itemsize]
    if kind.dtype != "u1":
        return _own(pixels.view(kind.dtype)[:, column::pitch].astype(np.uint16))
    return _own(pixels[:, kind.offset :: kind.step][:, column::pitch])


def _own(part: NDArray[np.generic]) -> Image:
    image: Any = np.array(part, order="C")
    image.flags.writeable = False
    return cast("Image", image)


def _unpacked(rows: NDArray[np.uint8], width_px: int, group: int) -> NDArray[np.uint16]:
    """Pixels of rows of groups of `group` bytes and one more with their low bits."""
    groups = -(-width_px // group)
    data = rows[:, : groups * (group + 1)].reshape(len(rows), groups, group + 1)
    bits = 8 // group
    low = data[:, :, group:] >> (bits * np.arange(group, dtype=np.uint8)) & np.uint8((1 << bits) - 1)
    pixels = data[:, :, :group].astype(np.uint16) << bits | low
    return pixels.reshape(len(rows), -1)[:, :width_px].astype(np.uint16, copy=False)
