"""Index of a film: one entry a packet, with its time as the container states it, without any decoding.

A frame rate that the file states is used only if all packets' times agree with it; it then replaces the
times, which are rounded to the container's ticks (1 ms in Matroska).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from statistics import median_high
from typing import TYPE_CHECKING, Any

from acquisition.cameras.files.frame_source import ONE_IMAGE, missing_frames, numbers_by_steps
from processing.errors import DeviceError, optional_module

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

_SECOND_NS = 1_000_000_000


def pyav() -> Any:
    """The module av. Raises MissingPackage if it is missing."""
    av = optional_module("av", "a film", "av", "video", "convert it to a folder of images")
    # FFmpeg's own messages are suppressed, because the readers of a film report its faults
    av.logging.set_level(None)
    # a repeated message must not be skipped, because it is a second fault
    av.logging.set_skip_repeated(False)
    return av


def open_film(path: Path) -> "InputContainer":
    """Open a film. Raises DeviceError if FFmpeg cannot read it as one."""
    av = pyav()
    try:
        container: InputContainer = av.open(str(path))
    except (av.FFmpegError, OSError) as error:
        raise DeviceError(
            f"{path}: cannot be read as a video ({error.strerror}); use a folder of images, or a .tif or "
            ".npy stack"
        ) from None
    return container


def ffmpeg_error() -> type[Exception]:
    """FFmpeg's class of errors."""
    error: type[Exception] = pyav().FFmpegError
    return error


@dataclass(frozen=True, slots=True)
class FilmIndex:
    """Packets of a film that are displayed, in the order of their times."""

    ticks: Sequence[int]
    """Times of the packets in units of `tick_s`."""
    time_ns: Sequence[int]
    """Times since the first frame, also of the frames that the container announces beyond its last packet."""
    sequence: Sequence[int]
    """Numbers of the same frames as `time_ns`; they count missing frames, too."""
    tick_s: Fraction
    rate_hz: Fraction | None
    """Constant rate with which all times agree; None without one."""
    key_ticks: Sequence[int]
    """Times of key frames in units of `tick_s`."""
    warnings: tuple[str, ...]
    codec: str
    pixel_format: str
    pixel_aspect: Fraction


def film_index(path: Path) -> FilmIndex:
    """Index of a film, read once. Raises DeviceError for another file, and for packets without times."""
    container = open_film(path)
    try:
        if not container.streams.video:
            raise DeviceError(f"{path}: holds no picture; name a film")
        # FFmpeg invents times for images, which state none
        if container.format.name == "image2" or container.format.name.endswith("_pipe"):
            raise DeviceError(f"{path}: {ONE_IMAGE}")
        stream = container.streams.video[0]
        return _index(path, container, stream)
    finally:
        container.close()


def _index(path: Path, container: Any, stream: "VideoStream") -> FilmIndex:
    warnings: list[str] = []
    is_key: dict[int, bool] = {}
    last_dts: int | None = None
    total = duplicates = 0
    last_duration = 0
    tick_s: Fraction = stream.time_base or Fraction(1, _SECOND_NS)
    try:
        for packet in container.demux(stream):
            # in AVI a packet without bytes repeats a frame; the last packet of any film flushes the decoder
            if not packet.size:
                continue
            total += 1
            if packet.pts is None:
                raise DeviceError(
                    f"{path}: packet {total} has no display time; put the film into another container "
                    "(ffmpeg -fflags +genpts -i FILM -c copy NEW.mkv), or convert it to images and state "
                    "their rate"
                )
            if packet.dts is not None:
                if last_dts is not None and packet.dts < last_dts:
                    raise DeviceError(
                        f"{path}: the times go back at packet {total}, as in films that were joined; cut "
                        "it there"
                    )
                last_dts = packet.dts
            if packet.is_discard:
                continue
            if packet.pts in is_key:
                duplicates += 1
                continue
            is_key[packet.pts] = packet.is_keyframe
            last_duration = packet.duration or 0
    except ffmpeg_error() as error:
        warnings.append(f"cannot be read beyond packet {total}: {error}")
    if not is_key:
        raise DeviceError(f"{path}: holds no frame; name another film")
    if duplicates:
        warnings.append(f"{duplicates} packets have the time of another and are left out")
    ticks = sorted(is_key)
    rate_hz, numbers = _constant_rate(
        ticks, tick_s, [stream.average_rate, stream.base_rate, stream.guessed_rate]
    )
    if rate_hz is not None:
        time_ns = [round(number * _SECOND_NS / rate_hz) for number in numbers]
    else:
        numbers = numbers_by_steps(ticks)
        time_ns = [round((tick - ticks[0]) * tick_s * _SECOND_NS) for tick in ticks]
    warnings += missing_frames(time_ns, numbers, "the container's times")
    missing = _missing_at_end(container, stream, ticks, total, tick_s, last_duration)
    if missing:
        warnings.append(f"ends {missing} frames early: it is cut off, copy it again")
        step_ns = time_ns[-1] // numbers[-1] if numbers[-1] else _SECOND_NS
        time_ns += [time_ns[-1] + step_ns * (k + 1) for k in range(missing)]
        numbers += [numbers[-1] + k + 1 for k in range(missing)]
    context, aspect = stream.codec_context, stream.sample_aspect_ratio or Fraction(1)
    displayed_nx = round(context.width * aspect)
    if displayed_nx != context.width:
        warnings.append(
            f"pixels are not square, {aspect.numerator}:{aspect.denominator} wide to high: a viewer shows "
            f"{displayed_nx}x{context.height} px instead of {context.width}x{context.height}"
        )
    return FilmIndex(
        ticks=ticks,
        time_ns=time_ns,
        sequence=numbers,
        tick_s=tick_s,
        rate_hz=rate_hz,
        key_ticks=[tick for tick in ticks if is_key[tick]],
        warnings=tuple(warnings),
        codec=context.name,
        pixel_format=context.pix_fmt or "",
        pixel_aspect=aspect,
    )


def _constant_rate(
    ticks: Sequence[int], tick_s: Fraction, rates_hz: Iterable[Fraction | None]
) -> tuple[Fraction | None, list[int]]:
    """The rate with which all times agree to the rounding of a tick, and the frames' numbers at it."""
    for rate_hz in dict.fromkeys(rates_hz):
        if not rate_hz or rate_hz * tick_s > 1 or len(ticks) < 3:
            continue
        for offset_ticks in (Fraction(0), Fraction(1, 2), Fraction(-1, 2)):
            positions = [(tick - ticks[0] + offset_ticks) * tick_s * rate_hz for tick in ticks]
            numbers = [round(position) for position in positions]
            errors = [position - number for position, number in zip(positions, numbers, strict=True)]
            steps = [later - earlier for earlier, later in pairwise(numbers)]
            # a microsecond more than a tick, because some files state rates to nine digits only
            tolerance_s = tick_s + Fraction(1, 1_000_000) if tick_s * rate_hz != 1 else 0
            rounding = max(errors) - min(errors)
            if min(steps) > 0 and median_high(steps) == 1 and rounding <= tolerance_s * rate_hz:
                return Fraction(rate_hz), [number - numbers[0] for number in numbers]
    return None, []


def _missing_at_end(
    container: Any, stream: "VideoStream", ticks: Sequence[int], total: int, tick_s: Fraction, last_ticks: int
) -> int:
    """Number of frames announced beyond the last packet; 0 for containers that do not state it exactly."""
    steps = [later - earlier for earlier, later in pairwise(ticks)]
    step = median_high(steps) if steps else last_ticks
    start, container_name = stream.start_time or 0, container.format.name
    if "avi" in container_name and stream.average_rate and tick_s * stream.average_rate == 1:
        # a chunk without bytes, which repeats a frame, counts too
        return max(stream.frames - 1 - ticks[-1], 0)
    if step and stream.duration and stream.frames:
        missing = int((start + stream.duration - ticks[-1] - max(last_ticks, step)) / step + 0.25)
        return max(min(missing, stream.frames - total), 0)
    if step and "matroska" in container_name and container.duration and len(container.streams) == 1:
        # the container's duration begins at time zero, not at the first frame
        announced = round(container.duration / (1_000_000 * tick_s))
        return max(int((announced - ticks[-1] - max(last_ticks, step)) / step + 0.25), 0)
    return 0
