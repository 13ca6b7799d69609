"""A film as a source of frames: decoding, detection of damaged frames, and pixel formats as arrays."""

import math
import re
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Mapping
from enum import Enum, auto
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.cameras.files.film_index import FilmIndex, ffmpeg_error, film_index, open_film, pyav
from acquisition.cameras.files.frame_source import FrameSource, FrameTimes, StoredImage, UnreadableFrame
from processing.errors import DeviceError

if TYPE_CHECKING:
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.plane import VideoPlane
    from av.video.stream import VideoStream


_FULL_RANGE: Final = 2
"""FFmpeg's AVCOL_RANGE_JPEG."""
_MAX_GREY_CHROMA: Final = 4
"""Largest distance of the chroma from neutral in a compressed grey film, in steps of 8 bits."""


class _Kind(Enum):
    LUMA = auto()
    """The luminance, in a plane of its own or between chroma."""
    RGB = auto()
    """Three planes: green, blue, red."""
    PACKED_RGB = auto()
    """Pixels of three or four samples."""
    PALETTE = auto()
    """Indices into a palette of colours."""


class _Layout(NamedTuple):
    """Layout of the samples of a pixel format."""

    kind: _Kind
    bits: int = 8
    """Number of bits that are used, the lowest of the shifted sample."""
    big_endian: bool = False
    shift: int = 0
    """Number of bits by which a sample is shifted to the right."""
    step: int = 1
    """Number of samples from one pixel to the next in their plane."""
    sample_offsets: tuple[int, ...] = (0,)
    """Positions of the used samples (luminance, or blue, green and red) within a pixel or pair of pixels."""
    grey: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        if self.bits <= 8:
            return np.dtype(np.uint8)
        return np.dtype(">u2" if self.big_endian else "<u2")


def _both_byte_orders(name: str, layout: _Layout) -> dict[str, _Layout]:
    return {f"{name}{order}": layout._replace(big_endian=order == "be") for order in ("le", "be")}


def _layouts() -> Mapping[str, _Layout]:
    luma, rgb, packed = _Layout(_Kind.LUMA), _Layout(_Kind.RGB), _Layout(_Kind.PACKED_RGB)
    grey = luma._replace(grey=True)
    layouts = {"gray": grey, "ya8": grey._replace(step=2), "pal8": _Layout(_Kind.PALETTE)}
    for bits in (9, 10, 12, 14, 16):
        layouts |= _both_byte_orders(f"gray{bits}", grey._replace(bits=bits))
    layouts |= _both_byte_orders("ya16", grey._replace(bits=16, step=2))
    for ratio in ("410", "411", "420", "422", "440", "444"):
        layouts |= {f"yuv{ratio}p": luma, f"yuvj{ratio}p": luma, f"yuva{ratio}p": luma}
        for bits in (9, 10, 12, 14, 16):
            for name in ("yuv", "yuva"):
                layouts |= _both_byte_orders(f"{name}{ratio}p{bits}", luma._replace(bits=bits))
    layouts |= dict.fromkeys(("nv12", "nv21", "nv16", "nv24", "nv42"), luma)
    layouts |= _both_byte_orders("nv20", luma._replace(bits=10))
    for ratio in "024":
        for bits in (10, 12, 16):
            layouts |= _both_byte_orders(f"p{ratio}{bits}", luma._replace(bits=bits, shift=16 - bits))
    layouts |= dict.fromkeys(("yuyv422", "yvyu422"), luma._replace(step=2))
    layouts["uyvy422"] = luma._replace(step=2, sample_offsets=(1,))
    for bits in (10, 12):
        layouts[f"y2{bits}le"] = luma._replace(bits=bits, shift=16 - bits, step=2)
    layouts |= {"gbrp": rgb, "gbrap": rgb}
    for bits in (9, 10, 12, 14, 16):
        for name in ("gbrp", "gbrap"):
            layouts |= _both_byte_orders(f"{name}{bits}", rgb._replace(bits=bits))
    orders = ("rgb24", "bgr24", "rgba", "bgra", "argb", "abgr", "rgb0", "bgr0", "0rgb", "0bgr")
    for name in (*orders, "rgb48", "bgr48", "rgba64", "bgra64"):
        letters, is_wide = re.sub("24|48|64", "", name), name.endswith(("48", "64"))
        offsets = tuple(letters.index(letter) for letter in "bgr")
        layout = packed._replace(bits=16 if is_wide else 8, step=len(letters), sample_offsets=offsets)
        layouts |= _both_byte_orders(name, layout) if is_wide else {name: layout}
    return layouts


_LAYOUTS: Final = _layouts()


def film_pixels(frame: "VideoFrame", label: str) -> StoredImage:
    """The samples of a decoded frame, as stored: grey, or blue, green and red.

    Raises DeviceError for a pixel format that is not listed, and for interlaced frames.
    """
    if frame.format.name not in _LAYOUTS:
        raise DeviceError(
            f"{label}: its pixels are stored as {frame.format.name}, which is not read here; convert the "
            "film: ffmpeg -i FILM -c:v ffv1 -pix_fmt gray NEW.mkv"
        )
    if frame.interlaced_frame:
        raise DeviceError(
            f"{label}: is interlaced: its odd and even rows are of two moments; film in progressive mode"
        )
    layout = _LAYOUTS[frame.format.name]
    if layout.kind is _Kind.PALETTE:
        indices = _rows(frame.planes[0], np.dtype(np.uint8), frame.width)
        palette = np.frombuffer(bytes(frame.planes[1]), dtype=np.uint8).reshape(-1, 4)
        return StoredImage(palette[:, :3][indices], 255, False)
    full_scale = 2**layout.bits - 1
    if layout.kind is _Kind.RGB:
        # planes are in the order green, blue, red
        planes = [_samples(frame.planes[k], layout, frame.width, 0) for k in (1, 0, 2)]
        return StoredImage(np.dstack(planes), full_scale, False)
    samples = [_samples(frame.planes[0], layout, frame.width, offset) for offset in layout.sample_offsets]
    if layout.kind is _Kind.PACKED_RGB:
        return StoredImage(np.dstack(samples), full_scale, False)
    if not (layout.grey or frame.format.name.startswith("yuvj") or frame.color_range == _FULL_RANGE):
        # in the limited range 16 is black and 235 is white, in 8 bits
        full_scale = 235 << (layout.bits - 8)
    return StoredImage(samples[0], full_scale, not layout.grey and _has_chroma(frame, layout))


def _rows(plane: "VideoPlane", dtype: np.dtype[Any], samples: int) -> NDArray[Any]:
    """The samples (ny, `samples`) of a plane, whose rows may be longer than the picture."""
    stride = abs(plane.line_size) // dtype.itemsize
    flat = np.frombuffer(memoryview(plane), dtype=dtype)
    rows: NDArray[Any] = flat[: stride * plane.height].reshape(plane.height, stride)[:, :samples]
    return rows


def _samples(plane: "VideoPlane", layout: _Layout, width: int, offset: int) -> NDArray[Any]:
    """One sample of every pixel, as uint8 or native uint16."""
    rows = _rows(plane, layout.dtype, width * layout.step)[:, offset :: layout.step]
    if layout.bits <= 8:
        return np.ascontiguousarray(rows)
    native: NDArray[Any] = rows.astype(np.uint16)
    return native >> np.uint16(layout.shift) if layout.shift else native


def _has_chroma(frame: "VideoFrame", layout: _Layout) -> bool:
    """Whether any chroma is farther from neutral than that of a compressed grey film."""
    middle, limit = 1 << (layout.bits - 1), _MAX_GREY_CHROMA << (layout.bits - 8)
    if layout.step > 1:
        chroma = [_rows(frame.planes[0], layout.dtype, 2 * frame.width)[:, 1 - layout.sample_offsets[0] :: 2]]
    else:
        per_pixel = 1 if len(frame.planes) > 2 else 2
        chroma = [_rows(plane, layout.dtype, plane.width * per_pixel) for plane in frame.planes[1:3]]
    for plane in chroma:
        values = plane.astype(np.int32) >> layout.shift
        if np.abs(values - middle).max() > limit:
            return True
    return False


_LOSSLESS: Final = (
    "ffv1", "huffyuv", "ffvhuff", "rawvideo", "v210", "v410", "v308", "v408", "r210", "r10k", "png", "tiff",
    "bmp", "utvideo", "magicyuv", "qtrle", "zlib", "zmbv", "lagarith", "gif", "pgm", "pgmyuv", "ppm", "y41p",
    "yuv4", "targa", "dpx", "sgi", "pam", "pbm", "exr", "fits",
)  # fmt: skip
_STRICT_DECODING: Final = {"err_detect": "crccheck+bitstream+buffer+explode"}
"""Strict decoding, but with concealment of errors (which it reports): without it FFmpeg marks all H.264
frames of several slices as damaged.
"""
_NO_FRAME: Final = 1 << 62
"""Index of a frame beyond the end of any film."""
_ORDER_CHECK_FRAMES: Final = 40
"""Number of first frames on which the order of the film's display times is checked."""


class FilmSource(FrameSource):
    """A film in any container and codec that FFmpeg reads, in a pixel format whose layout is known here."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        index = film_index(path)
        self._film_index: Final[FilmIndex] = index
        self.count = len(index.time_ns)
        self.times = FrameTimes(index.time_ns, index.sequence)
        self.tick_s = float(index.tick_s)
        self.pixel_aspect = float(index.pixel_aspect)
        self.warnings = index.warnings
        self.lossy = "" if index.codec in _LOSSLESS else index.codec
        rate = "changing" if index.rate_hz is None else f"{float(index.rate_hz):.9g} frames/s"
        stored = len(index.ticks)
        length = f"{stored} frames in {index.time_ns[stored - 1] / 1e9:.6g} s"
        self.summary = f"{length}, {rate}, {index.codec}, {index.pixel_format}"
        self._index_by_tick: dict[int | None, int] = {tick: k for k, tick in enumerate(index.ticks)}
        self._frames: Iterator[tuple[int, VideoFrame]] = iter(())
        self._pending: tuple[int, VideoFrame] | None = None
        self._position = 0
        self._damaged: dict[int, str] = {}
        # decoding the first frames raises errors now which would otherwise come in the middle of a run
        self._container: Any = open_film(path)
        deque(islice(self._decoded(), _ORDER_CHECK_FRAMES), maxlen=0)
        self.close()

    def read(self, index: int) -> StoredImage:
        if self._container is None or index < self._position:
            self.close()
            self._container = open_film(self._path)
            self._frames = self._decoded()
        self._position = index
        if index >= len(self._film_index.ticks):
            raise UnreadableFrame("the film is cut off before this frame; copy it again")
        while self._pending is None or self._pending[0] < index:
            self._pending = next(self._frames, (_NO_FRAME, None))  # type: ignore[assignment]
        decoded_index, frame = self._pending
        if decoded_index != index or index in self._damaged:
            raise UnreadableFrame(self._damaged.get(index, "the decoder delivers no picture of this packet"))
        return film_pixels(frame, self.label(index))

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
        self._container = None
        self._frames, self._pending = iter(()), None
        self._position = 0
        self._damaged = {}

    def _decoded(self) -> Iterator[tuple[int, "VideoFrame"]]:
        """Frames with their indices, in the order of their times; fills `_damaged` before a damaged one."""
        stream = self._container.streams.video[0]
        context = stream.codec_context
        # with more threads an error is reported some packets after the damaged one
        context.thread_count = 1
        context.options = dict(_STRICT_DECODING)
        # a fault damages the frames up to the next key frame, and those after it that are displayed before it
        fault_since_key = fault_before_key = ""
        key_tick = -math.inf
        last_index = -1
        for packet in _packets(self._container, stream):
            if packet.size and packet.pts is not None:
                fault, frames = self._decode(context, packet)
                if packet.is_keyframe:
                    key_tick = packet.pts if fault_since_key else -math.inf
                    fault_before_key, fault_since_key = fault_since_key, ""
                if fault:
                    fault_since_key, key_tick = fault, -math.inf
                reason = fault_since_key or (fault_before_key if packet.pts < key_tick else "")
                if reason and packet.pts in self._index_by_tick:
                    self._damaged.setdefault(self._index_by_tick[packet.pts], reason)
            else:
                _, frames = self._decode(context, None)
            for frame in frames:
                index = self._index_by_tick.get(frame.pts)
                if index is None or (index < last_index and self._damaged):
                    continue
                if index < last_index:
                    raise DeviceError(
                        f"{self._path}: stores its frames in another order than they are shown in, without "
                        "display times; put them into another container "
                        "(ffmpeg -fflags +genpts -i FILM -c copy NEW.mkv)"
                    )
                last_index = index
                if frame.is_corrupt:
                    self._mark_to_next_key(index)
                yield index, frame

    def _mark_to_next_key(self, index: int) -> None:
        keys, ticks = self._film_index.key_ticks, self._film_index.ticks
        next_key = bisect_right(keys, ticks[index])
        end = self._index_by_tick[keys[next_key]] if next_key < len(keys) else len(ticks)
        for damaged in range(index, end):
            self._damaged.setdefault(damaged, "the decoder marks it, or a frame it depends on, as damaged")

    def _decode(self, context: Any, packet: "Packet[VideoStream] | None") -> tuple[str, list["VideoFrame"]]:
        """The fault of a packet (empty if there is none), and the frames that the decoder returns for it."""
        logs = pyav().logging
        fault, frames = "", list["VideoFrame"]()
        logs.set_level(logs.ERROR)
        try:
            with logs.Capture() as messages:
                frames = context.decode(packet)
        except ffmpeg_error() as error:
            fault = f"it, or a frame it depends on, is damaged: {getattr(error, 'strerror', None) or error}"
        finally:
            logs.set_level(None)
        if packet is None:
            return "", frames
        if messages and not fault:
            fault = f"it, or a frame it depends on, is damaged: {messages[0][2].strip()}"
        if packet.is_corrupt:
            fault = "the container marks it, or a frame it depends on, as damaged"
        return fault, frames


def _packets(container: Any, stream: Any) -> Iterator["Packet[VideoStream]"]:
    """The packets of a container, with a flushing one last even if the container breaks off."""
    flushed, error_class = False, ffmpeg_error()
    try:
        for packet in container.demux(stream):
            flushed = not packet.size and packet.pts is None
            if packet.size or flushed:
                yield packet
    except error_class:
        # `film_index` has already reported that the container breaks off here
        pass
    if not flushed:
        yield pyav().Packet(0)
