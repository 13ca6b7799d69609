"""A record without its windows of pixels, or with them in fewer bytes, made from one that proves itself.

Everything else is copied byte by byte. The new record states the SHA-256 of the one that was measured, by
which results still know it (`acquisition.record.proof`), and which pixels each dropped window held.
"""

import hashlib
import shutil
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.chunk_reader import RawMessage, messages_in
from acquisition.record.container import McapFile, new_record
from acquisition.record.digest import sha256_of
from acquisition.record.pixels import decode_window
from acquisition.record.proof import THINNED, Thinning, is_sound, thinning_of
from acquisition.record.reader import RecordReader
from acquisition.record.recover import copy_head
from acquisition.record.schemas import MessageType, message_type_of
from acquisition.record.topics import IMAGE_TOPIC, PACKAGE, WINDOW, RecordedWindow
from processing.errors import RecordError


class Obstacle(StrEnum):
    """Why a record cannot be thinned, or need not be."""

    CUT = "is cut short, and is left as it is; rig recover makes a complete record of it"
    DAMAGED = "is damaged, and is left as it is; rig check says where"
    NO_WINDOWS = "holds no windows of pixels"
    RECOMPRESSED = "its windows were recompressed before"

    @property
    def is_fault(self) -> bool:
        """The record is at fault, and somebody has to look."""
        return self in (Obstacle.CUT, Obstacle.DAMAGED)


_RESERVE_BYTES = 1024 * 1024
_CHUNK_BYTES = 4 * 1024 * 1024
_ZSTD_LEVEL = 19
"""A record of the demonstration becomes 13 % smaller, in 2.5 ms a frame; at level 12 5 %, at level 3 none."""


class WindowPlace(NamedTuple):
    """Which pixels of the sensor a dropped window held, and the CRC-32 of their bytes, row by row."""

    sequence: int
    time_ns: int
    x0_px: int
    y0_px: int
    width_px: int
    height_px: int
    bytes_per_pixel: int
    crc32: int


PLACE: MessageType = message_type_of(WindowPlace, f"{PACKAGE}.WindowPlace", "/window_place")


@dataclass(frozen=True, slots=True)
class Thinned:
    """A thinned copy: the SHA-256 of the record as it was measured, windows, and bytes before and after."""

    measured_sha256: str
    windows: int
    source_bytes: int
    bytes: int


def why_not_thinned(reader: RecordReader, thinning: Thinning) -> Obstacle | None:
    """Why a record cannot be thinned so, or need not be; None if it can."""
    before = thinning_of(reader)
    if reader.truncated:
        return Obstacle.CUT
    if not reader.counts.get(WINDOW.topic):
        return Obstacle.NO_WINDOWS
    if before is not None and thinning is Thinning.RECOMPRESSED:
        return Obstacle.RECOMPRESSED
    if not is_sound(reader.file, reader.contents):
        return Obstacle.DAMAGED
    return None


def thin(
    source: Path,
    path: Path,
    thinning: Thinning,
    said: Mapping[str, str],
    attachments: Mapping[str, bytes],
    *,
    agreed: Callable[[Thinned], None] | None = None,
    replaces: bool = False,
) -> Thinned:
    """Write a thinned copy of a record into a new file, and read it again to prove it.

    The source is not changed, unless the copy `replaces` it: then it takes the place of `path` at once, when
    it is proved and `agreed` has not raised. `said` is added to the metadata `thinned`, `attachments` to
    those of the record. Every message but those of windows is proved to be the same, and every pixel of
    windows that are kept.

    Raises
    ------
    RecordError
        The source is not sound or holds no windows; the new file exists, cannot be written, or does not hold
        what it should. No file is left then.
    """
    with RecordReader(source) as reader:
        why = why_not_thinned(reader, thinning)
        if why is not None:
            raise RecordError(f"{source}: {why}")
        copied: list[_Copied] = []

        def proved(beside: Path) -> None:
            _prove(beside, copied[0])
            if agreed is not None:
                agreed(Thinned(*copied[0][:2], reader.contents.size, beside.stat().st_size))
            if replaces:
                shutil.copymode(source, beside)

        with new_record(path, source, _RESERVE_BYTES, _ZSTD_LEVEL, prove=proved, replaces=replaces) as file:
            copied.append(_copy(reader, file, thinning, said, attachments))
            file.finish()
        return Thinned(*copied[0][:2], reader.contents.size, path.stat().st_size)


class _Digests:
    """SHA-256 of the messages of each topic, and of the pixels of all windows; in the order of their time."""

    def __init__(self) -> None:
        self.of_topics: dict[str, Any] = {}
        self.of_windows = hashlib.sha256()
        self.windows = self.places = 0

    def add(self, topic: str, message: RawMessage) -> None:
        digest = self.of_topics.setdefault(topic, hashlib.sha256())
        digest.update(b"%d %d %d\n" % (message.sequence, message.log_time_ns, len(message.data)))
        digest.update(message.data)

    def add_window(self, window: RecordedWindow) -> None:
        head = (
            window.sequence,
            window.time_ns,
            *window.origin_px,
            *window.image.shape,
            window.image.itemsize,
        )
        self.of_windows.update(b"%d %d %d %d %d %d %d\n" % head)
        self.of_windows.update(window.image.tobytes())
        self.windows += 1

    def topics(self) -> dict[str, str]:
        return {topic: digest.hexdigest() for topic, digest in self.of_topics.items()}


class _Copied(NamedTuple):
    measured: str
    windows: int
    thinning: Thinning
    digests: _Digests


def _copy(
    reader: RecordReader,
    file: McapFile,
    thinning: Thinning,
    said: Mapping[str, str],
    attachments: Mapping[str, bytes],
) -> _Copied:
    contents, before = reader.contents, thinning_of(reader)
    numbers = copy_head(reader, file)
    for name, data in attachments.items():
        if name not in contents.attachment_places:
            file.add_attachment(name, "application/json", data, contents.start_ns)
    dropped = thinning is Thinning.DROPPED
    places = file.add_channel(PLACE.topic, PLACE.full_name, PLACE.descriptor) if dropped else 0
    kind, digests = reader.message_type(WINDOW.topic), _Digests()
    builders = {True: ChunkBuilder(), False: ChunkBuilder()}
    for topic, message in _messages(reader):
        sequence, log_time_ns, data = message.sequence, message.log_time_ns, message.data
        builder, channel = builders[topic in (WINDOW.topic, IMAGE_TOPIC)], numbers[message.channel]
        if topic == WINDOW.topic:
            window = _window(reader.path, kind, message)
            digests.add_window(window)
            if dropped:
                builder, channel, data = builders[False], places, PLACE.encode(*_place(window))
        else:
            digests.add(topic, message)
        builder.add(channel, sequence, log_time_ns, data)
        if len(builder.data) >= _CHUNK_BYTES:
            file.add_chunk(builder)
    for builder in builders.values():
        file.add_chunk(builder)
    if reader.damages:
        raise RecordError(f"{reader.path}: {reader.damages[0].what}; it is left as it is")
    source = sha256_of(reader.path)
    measured = source if before is None else before["measured_sha256"]
    texts = {
        "measured_sha256": measured,
        "measured_bytes": str(contents.size) if before is None else before["measured_bytes"],
        "source_sha256": source,
        "windows": thinning,
        "window_count": str(digests.windows),
        "windows_sha256": digests.of_windows.hexdigest(),
        **said,
    }
    earlier = sum(name.startswith(THINNED) for name in contents.metadata)
    name = f"{THINNED} {earlier + 1}" if earlier else THINNED
    file.add_metadata({**contents.metadata, name: texts}, contents.start_ns)
    return _Copied(measured, digests.windows, thinning, digests)


def _prove(path: Path, copied: _Copied) -> None:
    """Read the copy: every byte is as it was written, and what was to be kept is the same."""
    found = _Digests()
    with RecordReader(path) as reader:
        kind = reader.message_type(WINDOW.topic)
        for topic, message in _messages(reader):
            if topic == WINDOW.topic:
                found.add_window(_window(path, kind, message))
            elif topic == PLACE.topic:
                found.places += 1
            else:
                found.add(topic, message)
        same = found.topics() == copied.digests.topics() and (
            (found.windows, found.places) == (0, copied.windows)
            if copied.thinning is Thinning.DROPPED
            else found.of_windows.digest() == copied.digests.of_windows.digest()
        )
        if not same or reader.damages or not is_sound(reader.file, reader.contents):
            raise RecordError(f"{path}: does not hold what was written; the record is left as it is")


def _messages(reader: RecordReader) -> Iterator[tuple[str, RawMessage]]:
    """Every message with its topic, in the order of the file."""
    for messages in reader.by_chunk(lambda chunk, channels: list(messages_in(chunk, channels)), frozenset()):
        for message in messages:
            yield reader.contents.channels[message.channel].topic, message


def _window(path: Path, kind: MessageType | None, message: RawMessage) -> RecordedWindow:
    if kind is None:
        raise RecordError(f"{path}: the description of {WINDOW.topic} is damaged")
    try:
        return decode_window(kind, message.data)
    except ValueError as error:
        raise RecordError(f"{path}: window {message.sequence} cannot be read ({error})") from None


def _place(window: RecordedWindow) -> WindowPlace:
    height, width = window.image.shape
    crc = zlib.crc32(window.image.tobytes())
    place = (*window.origin_px, width, height, window.image.itemsize, crc)
    return WindowPlace(window.sequence, window.time_ns, *place)
