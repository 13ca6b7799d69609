"""A matrix of films with known truth: each is read right, or refused in one line, or what is lost of it is
counted.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraSettings, Frame
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from processing.errors import DeviceError
from tests.acquisition.cameras.made_films import BLACK, Film, picture, places, write_film

FRAMES = 60
WITHIN_PX = 0.02
WITHIN_TIME = 1e-6


@dataclass(frozen=True)
class Case:
    """A film, what was done to its file, and how it is read. `stated` are settings of the camera."""

    name: str
    film: Film
    damage: Callable[[bytes], bytes] | None = None
    stated: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What became of a case; `wrong` is the third case, which must not be.

    `shorter`: frames are missing at the end alone, of a stream that announces no length.
    """

    kind: str
    said: str = ""
    worst_px: float = 0.0
    worst_time: float = 0.0
    delivered: int = 0


def flipped(seed: int) -> Callable[[bytes], bytes]:
    """A single bit changed, beyond the header and before the last eighth."""

    def damage(data: bytes) -> bytes:
        changed, generator = bytearray(data), random.Random(seed)
        changed[generator.randrange(len(data) // 4, 7 * len(data) // 8)] ^= 1 << generator.randrange(8)
        return bytes(changed)

    return damage


def zeroed(share: float, length: int) -> Callable[[bytes], bytes]:
    """Bytes set to zero from a share of the file on."""

    def damage(data: bytes) -> bytes:
        begin = int(share * len(data))
        return data[:begin] + bytes(length) + data[begin + length :]

    return damage


def cut(share: float) -> Callable[[bytes], bytes]:
    """Only the first share of the file is left."""
    return lambda data: data[: int(share * len(data))]


def true_times_s(film: Film) -> NDArray[np.float64]:
    """Times at which the frames were taken."""
    ticks = film.pts if film.pts is not None else range(FRAMES)
    return np.array([float(tick * (film.tick_s or 1 / film.rate_hz)) for tick in ticks])


def judged(case: Case, folder: Path) -> Outcome:
    """Make the film, read it, and compare every frame that is delivered with the truth."""
    film = case.film
    bits = av.VideoFormat(film.pixels).components[0].bits
    times_s = true_times_s(film)
    true_px = places(times_s)
    path = folder / f"film.{film.ending}"
    write_film(path, [picture(place, bits) for place in true_px], film)
    if case.damage is not None:
        path.write_bytes(case.damage(path.read_bytes()))
    camera = FilesCamera(FilesSettings(path=path, **case.stated))
    try:
        camera.open()
        camera.configure(CameraSettings())
        camera.start()
        frames = list(iter(lambda: camera.read(1.0), None))
    except DeviceError as error:
        return Outcome("refused" if "\n" not in str(error) else "wrong", str(error))
    finally:
        camera.close()
    lost = camera.status.incomplete + camera.status.dropped_by_camera
    return compared(frames, lost, times_s, true_px, 2.0 ** (bits - 8))


def compared(
    frames: list[Frame], lost: int, times_s: NDArray[np.float64], true_px: NDArray[np.float64], scale: float
) -> Outcome:
    """Positions and times of the frames that came, and whether those that did not were counted."""
    found_px = np.array([centroid(frame.image, scale) for frame in frames])
    found_s = np.array([frame.device_time_ns for frame in frames]) * 1e-9
    # a frame is the one of the truth that is nearest in time
    since_s = times_s - times_s[0]
    which = np.argmin(np.abs(since_s[None, :] - found_s[:, None]), axis=1)
    worst_px = float(np.abs(found_px - true_px[which]).max())
    worst_time = float((np.abs(found_s - since_s[which]) / max(since_s[-1], 1e-9)).max())
    right = worst_px <= WITHIN_PX and worst_time <= WITHIN_TIME and len(set(which)) == len(which)
    missing = len(times_s) - len(frames)
    kind = "right" if right and not missing else "counted" if right and lost >= missing else "wrong"
    if kind == "wrong" and right and missing - lost == len(times_s) - 1 - max(which, default=0):
        kind = "shorter"
    said = f"{len(frames)} of {len(times_s)} delivered, {lost} counted as lost"
    return Outcome(kind, said, worst_px, worst_time, len(frames))


def centroid(image: NDArray[Any], scale: float) -> NDArray[np.float64]:
    """Centre of the light above a level, of the whole picture: anything that is not the spot moves it."""
    # the square gives the core its weight, in which compression leaves the most detail
    light = np.maximum(image.astype(np.float64) - (BLACK + 40.0) * scale, 0.0) ** 2
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    total = light.sum()
    if total <= 0.0:
        return np.array([np.inf, np.inf])
    return np.array([(x * light).sum() / total, (y * light).sum() / total])


def matrix() -> list[Case]:
    """Every case."""
    return [*_layouts(), *_codecs(), *_clocks(), *_damages()]


def _layouts() -> list[Case]:
    kinds = [
        *(("ffv1", "mkv", name) for name in (
            "gray", "gray10le", "gray12le", "gray16le", "ya8", "yuv420p", "yuv422p", "yuv444p", "yuv410p",
            "yuva420p", "yuv420p10le", "yuv422p12le", "yuv444p16le", "bgr0", "gbrp10le", "gbrp12le",
            "gbrp16le", "rgb48le")),
        *(("png", "mov", name) for name in ("gray", "gray16be", "ya8", "rgb24", "rgba", "rgb48be", "pal8")),
        *(("rawvideo", "avi", name) for name in ("gray", "yuyv422", "bgr24")),
        *(("rawvideo", "nut", name) for name in (
            "uyvy422", "yvyu422", "nv12", "nv16", "gray16le", "argb", "rgb48be", "p010le", "rgb565le")),
        ("v210", "mov", "yuv422p10le"), ("r210", "mov", "gbrp10le"), ("v410", "mov", "yuv444p10le"),
        ("huffyuv", "avi", "rgb24"), ("huffyuv", "avi", "yuv422p"), ("ffvhuff", "avi", "yuv420p"),
        ("utvideo", "avi", "gbrp"), ("utvideo", "mkv", "yuv422p"), ("magicyuv", "avi", "gray"),
        ("qtrle", "mov", "gray"), ("zlib", "avi", "bgr24"), ("zmbv", "avi", "bgr0"),
    ]  # fmt: skip
    found = [Case(f"{codec} {ending} {name}", Film(codec, ending, name)) for codec, ending, name in kinds]
    gif = Film("gif", "gif", "pal8", rate_hz=Fraction(25))
    hue = Film("ffv1", "mkv", "yuv444p", hue=40)
    return [
        *found,
        Case("gif", gif),
        Case("full range", Film("ffv1", "mkv", "yuv420p", full_range=True)),
        Case("colour, nothing stated", hue),
        Case("colour, brightness", hue, stated={"colour": "brightness"}),
        Case("colour, red", hue, stated={"colour": "red"}),
    ]


def _codecs() -> list[Case]:
    fine = {"qp": "1"}
    sliced = {**fine, "x264-params": "slices=4"}
    refreshed = {**sliced, "intra-refresh": "1", "g": "15"}
    x265 = {"x265-params": "qp=1:log-level=none"}
    x265_sliced = {"x265-params": "qp=1:log-level=none:slices=3"}
    return [
        Case("h264 mp4", Film("libx264", "mp4", "yuv420p", options=fine)),
        Case("h264 mp4, four slices", Film("libx264", "mp4", "yuv420p", options=sliced)),
        Case("h264 mkv, intra refresh", Film("libx264", "mkv", "yuv420p", options=refreshed)),
        Case("h264 mkv, no B frames", Film("libx264", "mkv", "yuv420p", options={**fine, "bf": "0"})),
        Case("h264 mov, 10 bits", Film("libx264", "mov", "yuv420p10le", options=fine)),
        Case("h264 ts", Film("libx264", "ts", "yuv420p", options=fine)),
        Case("h264 flv", Film("libx264", "flv", "yuv420p", options=fine)),
        Case("h264 avi, no times", Film("libx264", "avi", "yuv420p", options=fine)),
        Case("h264 stream, no times", Film("libx264", "h264", "yuv420p", options=fine)),
        Case("h264 lossless", Film("libx264", "mp4", "yuv444p", options={"qp": "0"})),
        Case("h265 mp4", Film("libx265", "mp4", "yuv420p", options=x265)),
        Case("h265 mp4, three slices", Film("libx265", "mp4", "yuv420p", options=x265_sliced)),
        Case("h265 mkv, 10 bits", Film("libx265", "mkv", "yuv420p10le", options=x265)),
        Case("vp9 webm", Film("libvpx-vp9", "webm", "yuv420p", options={"lossless": "1"})),
        Case("mjpeg avi", Film("mjpeg", "avi", "yuvj420p", options={"qmin": "1", "qmax": "1"})),
        Case("mpeg4 avi", Film("mpeg4", "avi", "yuv420p", options={"qmin": "1", "qmax": "1"})),
        Case("prores mov", Film("prores_ks", "mov", "yuv422p10le")),
        Case("mpeg2 mpg", Film("mpeg2video", "mpg", "yuv420p", options={"qmin": "1", "qmax": "1"})),
    ]


def _clocks() -> list[Case]:
    ms = Fraction(1, 1000)
    fine = Fraction(1, 90_000)
    steps = np.random.default_rng(1).integers(2400, 4200, FRAMES)
    uneven = np.cumsum(steps).tolist()
    gap = [i + 7 * (i > 20) + (i > 40) for i in range(FRAMES)]
    h264 = {"qp": "1"}
    later = range(1000, 1000 + 40 * FRAMES, 40)
    h264_film = Film("libx264", "mp4", "yuv420p", options=h264)
    return [
        Case("mkv, 30 frames/s in ms", Film(rate_hz=Fraction(30))),
        Case("mkv, 29.97 frames/s in ms", Film(rate_hz=Fraction(30_000, 1001))),
        Case("mkv, 239.76 frames/s in ms", Film(rate_hz=Fraction(240_000, 1001))),
        Case("mkv, 100 a second under 30", Film(tick_s=ms, pts=range(0, 10 * FRAMES, 10))),
        Case("mkv, starts at 1 s", Film(tick_s=ms, pts=later, rate_hz=Fraction(25))),
        Case("mp4, varying", Film("libx264", "mp4", "yuv420p", tick_s=fine, pts=uneven, options=h264)),
        Case("mov, varying", Film("png", "mov", "gray", tick_s=fine, pts=uneven)),
        Case("mkv, frames missing", Film(pts=gap)),
        Case("mp4, frames missing", Film("libx264", "mp4", "yuv420p", pts=gap, options=h264)),
        Case("avi, frames missing", Film("rawvideo", "avi", "gray", pts=gap)),
        Case("stated rate, the film's", Film(), stated={"frame_rate_hz": 30.0}),
        Case("stated rate, another", Film(), stated={"frame_rate_hz": 25.0}),
        Case("stated rate, nearly", Film(rate_hz=Fraction(30_000, 1001)), stated={"frame_rate_hz": 30.0}),
        Case("stated rate, a half", h264_film, stated={"frame_rate_hz": 15.0}),
    ]  # fmt: skip


def _damages() -> list[Case]:
    h264 = Film("libx264", "mp4", "yuv420p", options={"qp": "1", "g": "12"}, muxing={"movflags": "faststart"})
    sliced = replace(h264, options={**h264.options, "x264-params": "slices=4"})
    stream = Film("libx264", "ts", "yuv420p", options={"qp": "1", "g": "12"})
    return [
        *(Case(f"ffv1, bit {seed}", Film(options={"g": "8"}), flipped(seed)) for seed in range(6)),
        *(Case(f"h264 mp4, bit {seed}", h264, flipped(seed)) for seed in range(6)),
        *(Case(f"h264 mp4, four slices, bit {seed}", sliced, flipped(seed)) for seed in range(3)),
        *(Case(f"png mov, bit {seed}", Film("png", "mov", "gray"), flipped(seed)) for seed in range(3)),
        Case("ffv1, zeros", Film(options={"g": "8"}), zeroed(0.4, 3000)),
        Case("ffv1, cut off", Film(), cut(0.6)),
        Case("h264 mp4, zeros", h264, zeroed(0.5, 400)),
        Case("h264 mp4, cut off", h264, cut(0.6)),
        Case("h264 mp4, cut off, index at the end", Film("libx264", "mp4", "yuv420p"), cut(0.6)),
        Case("h264 ts, zeros", stream, zeroed(0.5, 2000)),
        Case("h264 ts, cut off", stream, cut(0.6)),
        Case("huffyuv avi, zeros", Film("huffyuv", "avi", "yuv422p"), zeroed(0.5, 6000)),
        Case("rawvideo avi, cut off", Film("rawvideo", "avi", "gray"), cut(0.6)),
        Case("h264 mkv, packets left out", Film("libx264", "mkv", "yuv420p", options={"qp": "1", "g": "12"},
             leave_out=frozenset({17, 18, 40}))),
        Case("ffv1 mkv, packets left out", Film(leave_out=frozenset({17, 18, 40}), options={"g": "1"})),
    ]  # fmt: skip
