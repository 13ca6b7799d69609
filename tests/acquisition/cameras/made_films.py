"""Films with known truth, encoded through PyAV: a round spot that swings, in any codec, container and pixel
format.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

NY, NX = 96, 160
SIGMA_PX = 5.0
FULL = 200.0
BLACK = 20.0


@dataclass(frozen=True)
class Film:
    """How a film is made. `pts` are in `tick_s`; None: one a frame. `black` and `full` are grey values of 8
    bits.
    """

    codec: str = "ffv1"
    ending: str = "mkv"
    pixels: str = "gray"
    rate_hz: Fraction = Fraction(30)
    tick_s: Fraction | None = None
    pts: Sequence[int] | None = None
    options: dict[str, str] = field(default_factory=dict)
    full_range: bool = False
    hue: float = 0.0
    muxing: dict[str, str] = field(default_factory=dict)
    leave_out: frozenset[int] = frozenset()
    pixel_aspect: Fraction = Fraction(1)


def places(times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """True centre (n, 2) in px of the spot: a decaying swing along x, a slight one along y."""
    swing = 40.0 * np.exp(-times_s / 20.0) * np.sin(2.0 * np.pi * times_s / 1.7)
    return np.column_stack([80.3 + swing, 47.8 + 0.1 * swing])


def picture(place: NDArray[np.float64], bits: int = 8) -> NDArray[Any]:
    """Grey values of one frame."""
    y, x = np.mgrid[:NY, :NX]
    light = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * SIGMA_PX**2))
    grey = np.rint((BLACK + FULL * light) * 2 ** (bits - 8))
    return grey.astype(np.uint8 if bits <= 8 else np.uint16)


def write_film(path: Path, pictures: Sequence[NDArray[Any]], film: Film) -> Path:
    """Encode the pictures; the samples are laid down as they are, without a conversion."""
    container = av.open(str(path), "w", options=dict(film.muxing))
    stream: Any = container.add_stream(film.codec, rate=film.rate_hz)
    stream.width, stream.height, stream.pix_fmt = NX, NY, film.pixels
    stream.options = dict(film.options)
    # several threads encode slices, whose number differs from machine to machine
    stream.codec_context.thread_count = 1
    stream.codec_context.sample_aspect_ratio = film.pixel_aspect
    tick_s = film.tick_s or 1 / film.rate_hz
    stream.codec_context.time_base = tick_s
    if film.full_range:
        stream.codec_context.color_range = 2
    number = 0
    for index, grey in enumerate(pictures):
        frame = laid_down(grey, film)
        frame.pts = film.pts[index] if film.pts is not None else index
        frame.time_base = tick_s
        for packet in stream.encode(frame):
            number += 1
            if number - 1 not in film.leave_out:
                container.mux(packet)
    for packet in stream.encode(None):
        number += 1
        if number - 1 not in film.leave_out:
            container.mux(packet)
    container.close()
    return path


def laid_down(grey: NDArray[Any], film: Film) -> Any:
    """A frame whose luminance, or all of whose channels, are these grey values."""
    frame = av.VideoFrame(grey.shape[1], grey.shape[0], film.pixels)
    if film.full_range:
        frame.color_range = 2
    kind = frame.format
    deep = kind.components[0].bits > 8
    order = ">u2" if kind.name.endswith("be") else "<u2"
    dtype = np.dtype(order) if deep else np.dtype(np.uint8)
    shift = 16 - kind.components[0].bits if kind.name.startswith(("p0", "p2", "y21")) else 0
    values = (grey.astype(np.uint16) << shift).astype(dtype) if deep else grey
    middle = (1 << (kind.components[0].bits - 1)) << shift
    packed = {"yuyv422": (0, 2), "yvyu422": (0, 2), "uyvy422": (1, 2), "y210le": (0, 2)}
    for number, plane in enumerate(frame.planes):
        rows = np.zeros((plane.height, plane.line_size // dtype.itemsize), dtype)
        if kind.name == "pal8":
            if number == 0:
                rows[:, : plane.width] = values
            else:
                level = np.arange(256, dtype=np.uint32)
                plane.update((level * 0x010101 | 0xFF000000).astype("<u4").tobytes()[: plane.buffer_size])
                continue
        elif kind.name in packed:
            place, step = packed[kind.name]
            rows[:, 1 - place :: 2] = middle
            rows[:, place : step * plane.width : step] = values
        elif kind.is_rgb and len(frame.planes) == 1:
            channels = kind.padded_bits_per_pixel // (8 * dtype.itemsize)
            for channel in range(channels):
                rows[:, channel : channels * plane.width : channels] = values
        elif number == 0 or kind.is_rgb:
            step = 2 if kind.name.startswith("ya") else 1
            rows[:, : step * plane.width : step] = values
        else:
            rows[:] = middle + film.hue
        plane.update(rows.tobytes()[: plane.buffer_size])
    return frame
