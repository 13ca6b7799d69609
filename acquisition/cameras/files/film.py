"""A film as a source of frames: decoded strictly, in one thread, each frame placed by its own time.

What a decoder conceals is not delivered: after a packet that is damaged, everything that may build on it, up
to the next key frame, is unreadable.
"""

import logging
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from acquisition.cameras.files.film_index import FilmIndex, ffmpeg_error, film_index, opened_film, pyav
from acquisition.cameras.files.film_pixels import film_pixels
from acquisition.cameras.files.formats import is_whole, slices_of
from acquisition.cameras.files.frame_source import FrameSource, FrameTimes, Stored, Unreadable
from processing.errors import DeviceError

if TYPE_CHECKING:
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_log = logging.getLogger(__name__)
_LOSSLESS: Final = (
    "ffv1", "huffyuv", "ffvhuff", "rawvideo", "v210", "v410", "v308", "v408", "r210", "r10k", "png", "tiff",
    "bmp", "utvideo", "magicyuv", "qtrle", "zlib", "zmbv", "lagarith", "gif", "pgm", "pgmyuv", "ppm", "y41p",
    "yuv4", "targa", "dpx", "apng", "sgi", "pam", "pbm", "exr", "fits",
)  # fmt: skip
_STRICT: Final = {"err_detect": "crccheck+bitstream+buffer+explode"}
"""Without concealment, which tells what it conceals, H.264 of several slices is all marked as damaged."""
_FAR: Final = 1 << 62
_ORDER_SEEN: Final = 40
"""First frames by which it is seen whether a film keeps the times at which they are shown."""
_LOOKED_AT: Final = 5
"""First packets of FFV1 that are looked at for checksums; one of them may itself be damaged."""


class FilmSource(FrameSource):
    """A film in any container and codec that FFmpeg reads, in a pixel format whose layout is known here."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        index = film_index(path, _LOOKED_AT)
        self._index: Final[FilmIndex] = index
        self.count = len(index.time_ns)
        self.times = FrameTimes(index.time_ns, index.sequence)
        self.tick_s = float(index.tick_s)
        self.pixel_aspect = float(index.pixel_aspect)
        self.said = index.said
        self.lossy = "" if index.codec in _LOSSLESS else index.codec
        self._checksums = index.codec == "ffv1" and any(map(slices_of, index.first_packets))
        if index.codec == "ffv1" and not self._checksums:
            _log.warning("%s: was written without checksums; damaged frames cannot be recognised", path)
        rate = "changing" if index.rate_hz is None else f"{float(index.rate_hz):.9g} frames/s"
        lasts = f"{len(index.ticks)} frames in {index.time_ns[-1] / 1e9:.6g} s"
        self.summary = f"{lasts}, {rate}, {index.codec}, {index.pixel_format}"
        self._places = {tick: place for place, tick in enumerate(index.ticks)}
        self._container: Any = None
        self._frames: Iterator[tuple[int, VideoFrame]] = iter(())
        self._held: tuple[int, VideoFrame] | None = None
        self._position = 0
        self._spoilt: dict[int, str] = {}
        # raises at once what would else come in the midst of a run
        self._container = opened_film(path)
        for _ in zip(self._decoded(), range(_ORDER_SEEN), strict=False):
            pass
        self.close()

    def read(self, index: int) -> Stored:
        if self._container is None or index < self._position:
            self.close()
            self._container = opened_film(self._path)
            self._frames = self._decoded()
        self._position = index
        if index >= len(self._index.ticks):
            raise Unreadable("the film is cut off before this frame; copy it again")
        while self._held is None or self._held[0] < index:
            self._held = next(self._frames, (_FAR, None))  # type: ignore[assignment]
        place, frame = self._held
        if place != index or index in self._spoilt:
            raise Unreadable(self._spoilt.get(index, "the decoder delivers no picture of this packet"))
        return Stored(*film_pixels(frame, self.label(index)))

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
        self._container = None
        self._frames, self._held = iter(()), None
        self._position = 0
        self._spoilt = {}

    def _decoded(self) -> Iterator[tuple[int, "VideoFrame"]]:
        """Frames with their places, in the order of their times; fills `_spoilt` ahead of what it names."""
        stream = self._container.streams.video[0]
        context = stream.codec_context
        # with more threads an error is told packets later than where it is
        context.thread_count = 1
        context.options = dict(_STRICT)
        spoilt_by = after_key = ""
        key_tick = -_FAR
        before = -1
        for packet in _packets(self._container, stream):
            if packet.size and packet.pts is not None:
                fault, frames = self._decode(context, packet)
                if packet.is_keyframe:
                    # frames shown before a key frame, and stored after it, build on the pictures before
                    key_tick = packet.pts if spoilt_by else -_FAR
                    after_key, spoilt_by = spoilt_by, ""
                if fault:
                    spoilt_by, key_tick = fault, -_FAR
                reason = spoilt_by or (after_key if packet.pts < key_tick else "")
                if reason and packet.pts in self._places:
                    self._spoilt.setdefault(self._places[packet.pts], reason)
            else:
                _, frames = self._decode(context, None)
            for frame in frames:
                place = self._places.get(frame.pts) if frame.pts is not None else None
                if place is None:
                    continue
                if place < before and self._spoilt:
                    continue
                if place < before:
                    raise DeviceError(
                        f"{self._path}: stores its frames in another order than they are shown in, without "
                        "display times; put them into another container "
                        "(ffmpeg -fflags +genpts -i FILM -c copy NEW.mkv)"
                    )
                before = place
                if frame.is_corrupt:
                    self._spoil_to_next_key(place)
                yield place, frame

    def _spoil_to_next_key(self, place: int) -> None:
        keys, ticks = self._index.key_ticks, self._index.ticks
        following = bisect_right(keys, ticks[place])
        end = self._places[keys[following]] if following < len(keys) else len(ticks)
        for one in range(place, end):
            self._spoilt.setdefault(one, "the decoder marks it, or one it builds on, as damaged")

    def _decode(self, context: Any, packet: "Packet[VideoStream] | None") -> tuple[str, list["VideoFrame"]]:
        """What is wrong with a packet, and the frames that the decoder gives for it."""
        logs = pyav().logging
        fault, frames = "", list["VideoFrame"]()
        logs.set_level(logs.ERROR)
        try:
            with logs.Capture() as messages:
                frames = context.decode(packet)
        except ffmpeg_error() as error:
            fault = f"it, or a frame it builds on, is damaged: {getattr(error, 'strerror', None) or error}"
        finally:
            logs.set_level(None)
        if packet is None:
            return "", frames
        if messages and not fault:
            fault = f"it, or a frame it builds on, is damaged: {messages[0][2].strip()}"
        if packet.is_corrupt:
            fault = "the container marks it, or one it builds on, as damaged"
        if self._checksums and not is_whole(bytes(packet)):
            fault = "its checksum, or that of a frame it builds on, does not match"
        return fault, frames


def _packets(container: Any, stream: Any) -> Iterator["Packet[VideoStream]"]:
    """The packets, the flushing one last, also of a container that breaks off."""
    flushed, broken = False, ffmpeg_error()
    try:
        for packet in container.demux(stream):
            flushed = not packet.size and packet.pts is None
            if packet.size or flushed:
                yield packet
    except broken:
        # the index has said so, and ends here too
        pass
    if not flushed:
        yield pyav().Packet(0)
