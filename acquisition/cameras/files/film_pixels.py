"""From the pixel format of a decoded film to grey values or colours, exactly as they are stored.

Of a film in luminance and chroma the luminance is taken as it is, of one in RGB the channels. A format that
is not listed here is refused: rows read with a wrong layout look like a picture, and put every spot
elsewhere.
"""

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.errors import DeviceError

if TYPE_CHECKING:
    from av.video.frame import VideoFrame
    from av.video.plane import VideoPlane

_FULL_RANGE: Final = 2
"""FFmpeg's AVCOL_RANGE_JPEG."""
_NEUTRAL_WITHIN: Final = 4
"""Steps of 8 bits by which the chroma of a grey film is off the middle once it has been compressed."""


class _Kind(Enum):
    LUMA = "the luminance, in a plane of its own or between chroma"
    RGB = "three planes, green, blue, red"
    PACKED_RGB = "pixels of three or four samples"
    PALETTE = "numbers of colours"


class _Layout(NamedTuple):
    """How the samples lie: `bits` of each are used, after `shift` to the right.

    `places` are the places within a pixel (or pair of pixels) of what is taken: the luminance, or blue, green
    and red. `step` is the number of samples from one pixel to the next in that plane.
    """

    kind: _Kind
    bits: int = 8
    big_endian: bool = False
    shift: int = 0
    step: int = 1
    places: tuple[int, ...] = (0,)
    grey: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        if self.bits <= 8:
            return np.dtype(np.uint8)
        return np.dtype(">u2" if self.big_endian else "<u2")


def _deep(name: str, layout: _Layout) -> dict[str, _Layout]:
    return {f"{name}{end}": layout._replace(big_endian=end == "be") for end in ("le", "be")}


def _layouts() -> Mapping[str, _Layout]:
    luma, rgb, packed = _Layout(_Kind.LUMA), _Layout(_Kind.RGB), _Layout(_Kind.PACKED_RGB)
    grey = luma._replace(grey=True)
    found = {"gray": grey, "ya8": grey._replace(step=2), "pal8": _Layout(_Kind.PALETTE)}
    for bits in (9, 10, 12, 14, 16):
        found |= _deep(f"gray{bits}", grey._replace(bits=bits))
    found |= _deep("ya16", grey._replace(bits=16, step=2))
    for ratio in ("410", "411", "420", "422", "440", "444"):
        found |= {f"yuv{ratio}p": luma, f"yuvj{ratio}p": luma, f"yuva{ratio}p": luma}
        for bits in (9, 10, 12, 14, 16):
            for name in ("yuv", "yuva"):
                found |= _deep(f"{name}{ratio}p{bits}", luma._replace(bits=bits))
    found |= dict.fromkeys(("nv12", "nv21", "nv16", "nv24", "nv42"), luma)
    found |= _deep("nv20", luma._replace(bits=10))
    for ratio in "024":
        for bits in (10, 12, 16):
            found |= _deep(f"p{ratio}{bits}", luma._replace(bits=bits, shift=16 - bits))
    found |= dict.fromkeys(("yuyv422", "yvyu422"), luma._replace(step=2))
    found["uyvy422"] = luma._replace(step=2, places=(1,))
    for bits in (10, 12):
        found[f"y2{bits}le"] = luma._replace(bits=bits, shift=16 - bits, step=2)
    found |= {"gbrp": rgb, "gbrap": rgb}
    for bits in (9, 10, 12, 14, 16):
        for name in ("gbrp", "gbrap"):
            found |= _deep(f"{name}{bits}", rgb._replace(bits=bits))
    for order in ("rgb24", "bgr24", "rgba", "bgra", "argb", "abgr", "rgb0", "bgr0", "0rgb", "0bgr"):
        letters = order.removesuffix("24")
        places = tuple(letters.index(letter) for letter in "bgr")
        found[order] = packed._replace(step=len(letters), places=places)
    for order in ("rgb48", "bgr48", "rgba64", "bgra64"):
        letters = order[:-2]
        places = tuple(letters.index(letter) for letter in "bgr")
        found |= _deep(order, packed._replace(bits=16, step=len(letters), places=places))
    return found


_LAYOUTS: Final = _layouts()


class FilmPixels(NamedTuple):
    """Grey values (ny, nx), or blue, green and red (ny, nx, 3), and their largest possible value.

    `coloured`: beside these grey values the film has chroma that is not neutral.
    """

    pixels: NDArray[Any]
    full_scale: int
    coloured: bool


def known_pixel_format(label: str, name: str) -> None:
    """Raise DeviceError for a pixel format whose samples nothing here can place."""
    if name not in _LAYOUTS:
        raise DeviceError(
            f"{label}: its pixels are stored as {name}, which is not read here; convert the film: "
            "ffmpeg -i FILM -c:v ffv1 -pix_fmt gray NEW.mkv"
        )


def film_pixels(frame: "VideoFrame", label: str) -> FilmPixels:
    """The samples of a decoded frame, as stored.

    Raises DeviceError for a pixel format that is not listed, and for interlaced frames.
    """
    known_pixel_format(label, frame.format.name)
    if frame.interlaced_frame:
        raise DeviceError(
            f"{label}: is interlaced: its odd and even rows are of two moments; film in progressive mode"
        )
    layout = _LAYOUTS[frame.format.name]
    if layout.kind is _Kind.PALETTE:
        numbers, palette = frame.planes[0], np.frombuffer(bytes(frame.planes[1]), dtype="<u4")
        colours = palette.view(np.uint8).reshape(-1, 4)[:, :3]
        return FilmPixels(colours[_rows(numbers, np.dtype(np.uint8), frame.width)], 255, False)
    full_scale = 2**layout.bits - 1
    if layout.kind is _Kind.RGB:
        # planes are in the order green, blue, red
        planes = [_samples(frame.planes[k], layout, frame.width, 0) for k in (1, 0, 2)]
        return FilmPixels(np.dstack(planes), full_scale, False)
    parts = [_samples(frame.planes[0], layout, frame.width, place) for place in layout.places]
    if layout.kind is _Kind.PACKED_RGB:
        return FilmPixels(np.dstack(parts), full_scale, False)
    if layout.grey or frame.format.name.startswith("yuvj") or frame.color_range == _FULL_RANGE:
        return FilmPixels(parts[0], full_scale, not layout.grey and _has_chroma(frame, layout))
    # of the limited range 16 is black and 235 white, in 8 bits
    return FilmPixels(parts[0], 235 << (layout.bits - 8), _has_chroma(frame, layout))


def _rows(plane: "VideoPlane", dtype: np.dtype[Any], samples: int) -> NDArray[Any]:
    """The samples (ny, `samples`) of a plane, whose rows may be longer than the picture."""
    stride = abs(plane.line_size) // dtype.itemsize
    flat = np.frombuffer(memoryview(plane), dtype=dtype)
    rows: NDArray[Any] = flat[: stride * plane.height].reshape(plane.height, stride)[:, :samples]
    return rows


def _samples(plane: "VideoPlane", layout: _Layout, width: int, place: int) -> NDArray[Any]:
    """One sample of every pixel, as uint8 or native uint16."""
    rows = _rows(plane, layout.dtype, width * layout.step)[:, place :: layout.step]
    if layout.bits <= 8:
        return np.ascontiguousarray(rows)
    native: NDArray[Any] = rows.astype(np.uint16)
    return native >> np.uint16(layout.shift) if layout.shift else native


def _has_chroma(frame: "VideoFrame", layout: _Layout) -> bool:
    """Whether any chroma is off the middle by more than compression makes of grey."""
    middle, within = 1 << (layout.bits - 1), _NEUTRAL_WITHIN << (layout.bits - 8)
    if layout.step > 1:
        chroma = [_rows(frame.planes[0], layout.dtype, 2 * frame.width)[:, 1 - layout.places[0] :: 2]]
    else:
        per_pixel = 1 if len(frame.planes) > 2 else 2
        chroma = [_rows(plane, layout.dtype, plane.width * per_pixel) for plane in frame.planes[1:3]]
    for plane in chroma:
        values = plane.astype(np.int32) >> layout.shift
        if np.abs(values - middle).max() > within:
            return True
    return False
