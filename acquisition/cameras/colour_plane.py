"""One colour of a sensor with a Bayer mosaic: one pixel of each square of four, as it was read.

The pixels of a plane are those of a grey sensor of twice the pitch. Planes are not mixed: where the laser's
colour is not theirs, pixels hold little light and all of their noise, and interpolated ones are correlated.
"""

from collections.abc import Iterable
from typing import Final

from acquisition.camera import CameraSettings, ColourPlane, PixelFormat
from acquisition.cameras.pixel_formats import FORMATS, Format, unpack_10p, unpack_12p
from acquisition.frame import Image
from processing.errors import DeviceError

PITCH: Final = 2
"""Distance of neighbouring pixels of a plane, in those of the sensor."""
_REGION: Final = ("width_px", "height_px", "offset_x_px", "offset_y_px")
_BELOW: Final = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}
"""Colours of the second row of a mosaic, by those of the first."""
_DEPTHS: Final[tuple[tuple[str, PixelFormat, int, int, dict[str, int]], ...]] = (
    ("8", "mono8", 8, 255, {"GR": 0x01080008, "RG": 0x01080009, "GB": 0x0108000A, "BG": 0x0108000B}),
    ("10p", "mono10", 10, 1023, {"BG": 0x010A0052, "GB": 0x010A0054, "GR": 0x010A0056, "RG": 0x010A0058}),
    ("10", "mono10", 16, 1023, {"GR": 0x0110000C, "RG": 0x0110000D, "GB": 0x0110000E, "BG": 0x0110000F}),
    ("12p", "mono12", 12, 4095, {"BG": 0x010C0053, "GB": 0x010C0055, "GR": 0x010C0057, "RG": 0x010C0059}),
    ("12", "mono12", 16, 4095, {"GR": 0x01100010, "RG": 0x01100011, "GB": 0x01100012, "BG": 0x01100013}),
    ("16", "mono16", 16, 65535, {"GR": 0x0110002E, "RG": 0x0110002F, "GB": 0x01100030, "BG": 0x01100031}),
)
_KERNELS: Final = {"10p": unpack_10p, "12p": unpack_12p}
BAYER_FORMATS: Final = tuple(
    Format(f"Bayer{first}{suffix}", code, depth, bits, full_scale_dn, _KERNELS.get(suffix), first)
    for suffix, depth, bits, full_scale_dn, codes in _DEPTHS
    for first, code in codes.items()
)
_BAYER_BY_NAME: Final = {item.name: item for item in BAYER_FORMATS}
_BY_NAME: Final = {item.name: item for item in FORMATS}


def format_of(name: str, plane: ColourPlane | None) -> Format | None:
    """The pixel format of this name, if it is one of grey pixels, or with a `plane` one of a mosaic."""
    return (_BAYER_BY_NAME if plane else _BY_NAME).get(name)


def names_by_depth(offered: set[str], plane: ColourPlane | None) -> dict[PixelFormat, list[str]]:
    """Those of the offered formats that can be read, by their depth, the preferred ones first."""
    found: dict[PixelFormat, list[str]] = {}
    for item in BAYER_FORMATS if plane else FORMATS:
        if item.name in offered:
            found.setdefault(item.pixel_format, []).append(item.name)
    return found


def preferred_names(camera: str, offered: Iterable[str], plane: ColourPlane | None) -> dict[PixelFormat, str]:
    """The best of the offered formats of each depth; DeviceError that names the `camera` if there is none."""
    there = set(offered)
    found = {depth: names[0] for depth, names in names_by_depth(there, plane).items()}
    if not found:
        what = "Bayer format" if plane else "grey pixel format"
        mosaic = not plane and names_by_depth(there, "red")
        raise DeviceError(
            f"{camera}: has no {what}, only {', '.join(sorted(there))}"
            + ("; set camera.colour_plane to the laser's colour" if mosaic else "")
        )
    return found


def plane_of(image: Image, colours: str, plane: ColourPlane | None) -> Image:
    """The pixels of one colour of a mosaic with these `colours` in its first row; all without a plane."""
    if plane is None:
        return image
    row, column = place_in_mosaic(colours, plane)
    part: Image = image[row::PITCH, column::PITCH].copy()
    return part


def place_in_mosaic(colours: str, plane: ColourPlane) -> tuple[int, int]:
    """Row and column of the first pixel of a colour, by the first row's colours; of green, in the red row."""
    rows = (colours, _BELOW[colours])
    row = next(i for i, letters in enumerate(rows) if ("B" if plane == "blue" else "R") in letters)
    return row, rows[row].index(plane[0].upper())


def in_sensor_px(settings: CameraSettings) -> CameraSettings:
    """Settings with the region in pixels of the sensor, as the camera takes them."""
    if settings.colour_plane is None:
        return settings
    stated = {name: getattr(settings, name) for name in _REGION}
    whole = {name: value * PITCH for name, value in stated.items() if value is not None}
    return settings.model_copy(update=whole)


def in_plane_px(applied: CameraSettings, plane: ColourPlane | None) -> CameraSettings:
    """Settings as read back, with the region in pixels of the plane."""
    if plane is None:
        return applied
    stated = {name: getattr(applied, name) for name in _REGION}
    part = {name: value // PITCH for name, value in stated.items() if value is not None}
    return applied.model_copy(update=part | {"colour_plane": plane})
