"""Supported pixel formats, and kernels that unpack the packed ones.

A colour plane of a sensor with a Bayer mosaic is one pixel of each square of four, as it was read; it equals
a grey sensor of twice the pitch. Planes are not combined, because pixels of other colours than the laser's
receive little light but have the full noise, and interpolated pixels are correlated.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import BAYER_PERIOD_PX, CameraSettings, ColourPlane, Image, PixelFormat
from processing.errors import DeviceError
from processing.kernel import kernel

Bytes = NDArray[np.uint8]
_Kernel = Callable[[Bytes, NDArray[np.uint16]], None]


@kernel
def unpack_10p(packed: Bytes, pixels: NDArray[np.uint16]) -> None:
    """Four pixels of 10 bits in five bytes, least significant bits first."""
    groups = pixels.size // 4
    for group in range(groups):
        b, p = 5 * group, 4 * group
        b0, b1, b2, b3, b4 = packed[b], packed[b + 1], packed[b + 2], packed[b + 3], packed[b + 4]
        pixels[p] = np.uint16(b0) | (np.uint16(b1 & 0x03) << np.uint16(8))
        pixels[p + 1] = np.uint16(b1 >> 2) | (np.uint16(b2 & 0x0F) << np.uint16(6))
        pixels[p + 2] = np.uint16(b2 >> 4) | (np.uint16(b3 & 0x3F) << np.uint16(4))
        pixels[p + 3] = np.uint16(b3 >> 6) | (np.uint16(b4) << np.uint16(2))
    for pixel in range(4 * groups, pixels.size):
        first = pixel * 10 // 8
        word = np.uint16(packed[first]) | (np.uint16(packed[first + 1]) << np.uint16(8))
        pixels[pixel] = (word >> np.uint16(pixel * 10 % 8)) & np.uint16(0x3FF)


@kernel
def unpack_10_packed(packed: Bytes, pixels: NDArray[np.uint16]) -> None:
    """Two pixels of 10 bits in three bytes: high bits, low bits of both, high bits."""
    for pixel in range(pixels.size):
        pair, second = pixel // 2, pixel % 2
        high, low = packed[3 * pair + 2 * second], packed[3 * pair + 1] >> (4 * second)
        pixels[pixel] = (np.uint16(high) << np.uint16(2)) | np.uint16(low & 0x03)


@kernel
def unpack_12p(packed: Bytes, pixels: NDArray[np.uint16]) -> None:
    """Two pixels of 12 bits in three bytes, least significant bits first."""
    pairs = pixels.size // 2
    for pair in range(pairs):
        b0, b1, b2 = packed[3 * pair], packed[3 * pair + 1], packed[3 * pair + 2]
        pixels[2 * pair] = np.uint16(b0) | (np.uint16(b1 & 0x0F) << np.uint16(8))
        pixels[2 * pair + 1] = np.uint16(b1 >> 4) | (np.uint16(b2) << np.uint16(4))
    if pixels.size % 2:
        last = 3 * pairs
        pixels[pixels.size - 1] = np.uint16(packed[last]) | (
            np.uint16(packed[last + 1] & 0x0F) << np.uint16(8)
        )


@kernel
def unpack_12_packed(packed: Bytes, pixels: NDArray[np.uint16]) -> None:
    """Two pixels of 12 bits in three bytes: high bits, low bits of both, high bits."""
    pairs = pixels.size // 2
    for pair in range(pairs):
        b0, b1, b2 = packed[3 * pair], packed[3 * pair + 1], packed[3 * pair + 2]
        pixels[2 * pair] = (np.uint16(b0) << np.uint16(4)) | np.uint16(b1 & 0x0F)
        pixels[2 * pair + 1] = (np.uint16(b2) << np.uint16(4)) | np.uint16(b1 >> 4)
    if pixels.size % 2:
        last = 3 * pairs
        pixels[pixels.size - 1] = (np.uint16(packed[last]) << np.uint16(4)) | np.uint16(
            packed[last + 1] & 0x0F
        )


@dataclass(frozen=True, slots=True)
class Format:
    """One pixel format of the naming convention."""

    name: str
    code: int
    depth: PixelFormat
    transport_bits: int
    """Bits of a pixel on the bus."""
    full_scale_dn: int
    kernel: _Kernel | None = None
    """Function that unpacks pixels which are not whole bytes."""
    colours: str = ""
    """Colours of the first two pixels of the first row of a Bayer mosaic."""

    def prepare(self) -> None:
        """Compile the kernel now; compilation at the first frame would block the reading thread."""
        if self.kernel is not None:
            self.kernel(np.zeros(2, np.uint8), np.zeros(1, np.uint16))

    def rows_end_with_bytes(self, width_px: int) -> bool:
        """Whether each row is a whole number of bytes; only then can a row be followed by padding."""
        return width_px * self.transport_bits % 8 == 0

    def byte_count(self, width_px: int, height_px: int, x_padding: int = 0) -> int:
        """Number of bytes of an image on the bus, with `x_padding` bytes after each row."""
        return -(-width_px * height_px * self.transport_bits // 8) + x_padding * height_px

    def image(self, raw: Bytes, width_px: int, height_px: int, x_padding: int = 0) -> Image:
        """The image in these bytes, shape (height, width); a view if it is neither packed nor padded.

        With padding, `rows_end_with_bytes` must hold.
        """
        raw = raw[: self.byte_count(width_px, height_px, x_padding)]
        if x_padding:
            rows = raw.reshape(height_px, -1)
            raw = np.ascontiguousarray(rows[:, : rows.shape[1] - x_padding]).reshape(-1)
        if self.kernel is None:
            unpacked = raw if self.transport_bits == 8 else raw.view(np.uint16)
            return unpacked.reshape(height_px, width_px)
        pixels = np.empty(width_px * height_px, np.uint16)
        self.kernel(raw, pixels)
        return pixels.reshape(height_px, width_px)


# in order of preference for a requested bit depth, fewer bytes on the bus first
FORMATS: Final = (
    Format("Mono8", 0x01080001, "mono8", 8, 255),
    Format("Mono10p", 0x010A0046, "mono10", 10, 1023, unpack_10p),
    Format("Mono10Packed", 0x010C0004, "mono10", 12, 1023, unpack_10_packed),
    Format("Mono10", 0x01100003, "mono10", 16, 1023),
    Format("Mono12p", 0x010C0047, "mono12", 12, 4095, unpack_12p),
    Format("Mono12Packed", 0x010C0006, "mono12", 12, 4095, unpack_12_packed),
    Format("Mono12", 0x01100005, "mono12", 16, 4095),
    Format("Mono14", 0x01100025, "mono14", 16, 16383),
    Format("Mono16", 0x01100007, "mono16", 16, 65535),
)
_REGION: Final = ("width_px", "height_px", "offset_x_px", "offset_y_px")
_SECOND_ROW: Final = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}
"""Colours of the second row of a mosaic, by those of the first."""
# suffix of the name, depth, bits on the bus, full scale in DN, codes by the colours of the first row
_BAYER_ROWS: Final[tuple[tuple[str, PixelFormat, int, int, dict[str, int]], ...]] = (
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
    for suffix, depth, bits, full_scale_dn, codes in _BAYER_ROWS
    for first, code in codes.items()
)


class KnownFormat(Protocol):
    """A pixel format that a driver can read, under the name that its cameras have for it."""

    @property
    def depth(self) -> PixelFormat:
        """Bits of a pixel, as the configuration names them."""

    @property
    def colours(self) -> str:
        """Colours of the first two pixels of a Bayer mosaic; empty for grey pixels."""


KnownFormats = Mapping[str, KnownFormat]
"""Formats by their names, in order of preference."""
_GENICAM: Final = {item.name: item for item in (*FORMATS, *BAYER_FORMATS)}


def format_of(name: str, plane: ColourPlane | None) -> Format | None:
    """The supported pixel format of this name: of grey pixels, or, with a `plane`, of a mosaic; else None."""
    found = _GENICAM.get(name)
    return found if found is not None and bool(found.colours) == bool(plane) else None


def names_by_depth(
    offered: Collection[str], plane: ColourPlane | None, known: KnownFormats = _GENICAM
) -> dict[PixelFormat, list[str]]:
    """Names of the offered formats that can be read, by their depth, the preferred ones first."""
    found: dict[PixelFormat, list[str]] = {}
    for name, item in known.items():
        if name in offered and bool(item.colours) == bool(plane):
            found.setdefault(item.depth, []).append(name)
    return found


def preferred_name(
    camera: str,
    offered: Collection[str],
    wanted: PixelFormat | None,
    plane: ColourPlane | None,
    known: KnownFormats = _GENICAM,
) -> str:
    """Name of the preferred offered format of the depth `wanted` (None: of any).

    Raises DeviceError, which names the `camera` and what there is, where it offers none.
    """
    found = names_by_depth(offered, plane, known)
    if not found:
        what, remedy = "grey pixel format", ""
        if plane:
            what, remedy = "Bayer format", "; leave camera.colour_plane out"
        elif names_by_depth(offered, "red", known):
            remedy = "; set camera.colour_plane to the laser's colour"
        raise DeviceError(f"{camera}: has no {what}, only {', '.join(sorted(offered))}{remedy}")
    depth = wanted or next(iter(found))
    if depth not in found:
        raise DeviceError(f"{camera}: pixel format {depth} is not supported; there are {', '.join(found)}")
    return found[depth][0]


def place_in_mosaic(colours: str, plane: ColourPlane) -> tuple[int, int]:
    """Row and column of the first pixel of a colour in a mosaic with these `colours` in its first row.

    Of the two green pixels of a square, the one in the row of the red pixel is used.
    """
    rows = (colours, _SECOND_ROW[colours])
    row = next(i for i, letters in enumerate(rows) if ("B" if plane == "blue" else "R") in letters)
    return row, rows[row].index(plane[0].upper())


@dataclass(frozen=True, slots=True)
class ExpectedFrames:
    """Format and size of every frame of a run, and whether the camera has a clock."""

    format: Format
    width_px: int
    height_px: int
    has_clock: bool
    plane: ColourPlane | None
    """Colour plane to deliver; None: all pixels."""

    def image_bytes(self, x_padding: int = 0) -> int:
        """Number of bytes of the image on the bus, with `x_padding` bytes after each row."""
        return self.format.byte_count(self.width_px, self.height_px, x_padding)

    def can_strip_padding(self, x_padding: int) -> bool:
        """Whether `x_padding` bytes after each row can be left out."""
        return not x_padding or self.format.rows_end_with_bytes(self.width_px)

    def refuse_padding(self, camera: str, x_padding: int) -> None:
        """Raise DeviceError, which names the `camera`, where padding cannot be left out."""
        if not self.can_strip_padding(x_padding):
            raise DeviceError(
                f"{camera}: pads rows of {self.width_px} px in {self.format.name}; set a width that is a "
                "multiple of 4, or another pixel format"
            )

    def image(self, raw: Bytes, x_padding: int = 0) -> Image:
        """The image in these bytes, of the colour plane to deliver; read-only."""
        image = self.format.image(raw, self.width_px, self.height_px, x_padding)
        if self.plane is not None:
            row, column = place_in_mosaic(self.format.colours, self.plane)
            image = image[row::BAYER_PERIOD_PX, column::BAYER_PERIOD_PX].copy()
        image.flags.writeable = False
        return image


def region_to_sensor_px(settings: CameraSettings) -> CameraSettings:
    """Settings with the region converted from pixels of the plane to those of the sensor, for the camera."""
    if settings.colour_plane is None:
        return settings
    return settings.model_copy(update={name: px * BAYER_PERIOD_PX for name, px in _region(settings).items()})


def region_to_plane_px(applied: CameraSettings, plane: ColourPlane | None) -> CameraSettings:
    """Settings as read back, with the region converted from pixels of the sensor to those of the plane."""
    if plane is None:
        return applied
    region = {name: px // BAYER_PERIOD_PX for name, px in _region(applied).items()}
    return applied.model_copy(update={**region, "colour_plane": plane})


def _region(settings: CameraSettings) -> dict[str, int]:
    return {name: px for name in _REGION if (px := getattr(settings, name)) is not None}
