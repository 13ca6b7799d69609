"""In which order the chunks of a file that somebody has put together belong, and which do not belong to it.

A chunk belongs to the run where the run's offset turns the times in its messages into their log times, and
where its frames lie, by number and by time, between those of its neighbours.
"""

import hashlib
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record.chunk_builder import MESSAGE_HEAD
from acquisition.record.chunk_reader import ChunkDamage, ChunkPlace, OpenedChunk, message_heads
from acquisition.record.reader import RecordReader
from acquisition.record.records import HEAD
from acquisition.record.topics import SPOT, WINDOW


class Frames(NamedTuple):
    """The frames of one topic in a chunk: first and last number and log time."""

    first: int
    last: int
    first_ns: int
    last_ns: int
    rising: bool

    @property
    def most(self) -> int:
        """How many there are at most."""
        return self.last - self.first + 1


class _Found(NamedTuple):
    place: ChunkPlace
    digest: bytes
    frames: Mapping[int, Frames]
    fits: bool

    @property
    def time_ns(self) -> int:
        return min((item.first_ns for item in self.frames.values()), default=self.place.start_ns)


class Arranged(NamedTuple):
    """Sound chunks in their order, and in lines which were left out as doubles or as another run's.

    `moved` is how many do not stand where they belong in the file.
    """

    places: Sequence[ChunkPlace]
    doubles: Sequence[str]
    foreign: Sequence[str]
    moved: int


def arranged(reader: RecordReader, opened: Callable[[ChunkPlace], OpenedChunk]) -> Arranged:
    """The chunks of a record by the numbers of their frames; damaged ones are noted and left out."""
    sound: list[_Found] = []
    doubles: list[str] = []
    known: dict[bytes, int] = {}
    followed = _followed(reader)
    for place in reader.contents.chunks:
        try:
            found = _look(reader, place, opened(place), followed)
        except ChunkDamage as damage:
            reader.note_damage(place, str(damage))
            continue
        first = known.setdefault(found.digest, place.offset)
        if first == place.offset:
            sound.append(found)
        else:
            doubles.append(f"{_name(reader, found)}: the same as the one at byte {first}")
    # where most do not fit it is the offset that is wrong, of which nothing else is known
    is_told = 2 * sum(item.fits for item in sound) > len(sound)
    kept = [item for item in sound if item.fits or not is_told]
    foreign = [
        f"{_name(reader, item)}: its times are of another run" for item in sound if is_told and not item.fits
    ]
    if all(_rises([item.frames[channel] for item in kept if channel in item.frames]) for channel in followed):
        return Arranged([item.place for item in kept], doubles, foreign, 0)
    for channel in followed:
        of_topic = [item for item in kept if channel in item.frames]
        chain = longest_chain([item.frames[channel] for item in of_topic])
        astray = [item for number, item in enumerate(of_topic) if number not in chain]
        foreign += [
            f"{_name(reader, item)}: its frames {item.frames[channel].first} to {item.frames[channel].last} "
            "do not lie between their neighbours"
            for item in astray
        ]
        gone = {item.place.offset for item in astray}
        kept = [item for item in kept if item.place.offset not in gone]
    ordered = sorted(kept, key=lambda item: item.time_ns)
    moved = sum(a is not b for a, b in zip(kept, ordered, strict=True))
    return Arranged([item.place for item in ordered], doubles, foreign, moved)


def longest_chain(frames: Sequence[Frames]) -> set[int]:
    """Positions of those that follow one another by number and by time and hold the most frames together.

    Of two that hold as many, the one that stands first in the file.
    """
    times = sorted({item.last_ns for item in frames})
    best: list[tuple[int, int]] = [(0, -1)] * (len(times) + 1)
    before, total = [-1] * len(frames), [0] * len(frames)
    by_end = sorted(range(len(frames)), key=lambda number: (frames[number].last, number))
    ended = 0
    for number in sorted(range(len(frames)), key=lambda number: (frames[number].first, number)):
        item = frames[number]
        while ended < len(by_end) and frames[by_end[ended]].last < item.first:
            done = by_end[ended]
            _raise_best(best, bisect_left(times, frames[done].last_ns) + 1, (total[done], done))
            ended += 1
        weight, before[number] = _best_below(best, bisect_left(times, item.first_ns))
        total[number] = weight + (item.most if item.rising else 0)
    number = max(range(len(frames)), key=lambda number: (total[number], -number), default=-1)
    chain = set()
    while number >= 0:
        chain.add(number)
        number = before[number]
    return chain


def _raise_best(best: list[tuple[int, int]], at: int, value: tuple[int, int]) -> None:
    while at < len(best):
        if value[0] > best[at][0]:
            best[at] = value
        at += at & -at


def _best_below(best: Sequence[tuple[int, int]], at: int) -> tuple[int, int]:
    """The largest of the first `at`."""
    found = (0, -1)
    while at > 0:
        if best[at][0] > found[0]:
            found = best[at]
        at -= at & -at
    return found


def _rises(frames: Sequence[Frames]) -> bool:
    return all(item.rising for item in frames) and all(
        before.last < after.first and before.last_ns <= after.first_ns for before, after in pairwise(frames)
    )


def _followed(reader: RecordReader) -> dict[int, str]:
    topics = (SPOT.topic, WINDOW.topic)
    return {
        number: channel.topic
        for number, channel in sorted(reader.contents.channels.items())
        if channel.topic in topics and channel.schema_id in reader.contents.schemas
    }


def _look(reader: RecordReader, place: ChunkPlace, chunk: OpenedChunk, followed: Mapping[int, str]) -> _Found:
    starts, heads = message_heads(chunk)
    frames: dict[int, Frames] = {}
    fits = True
    for channel, topic in followed.items():
        of_topic = np.flatnonzero(heads["channel"] == channel)
        if not len(of_topic):
            continue
        frames[channel] = _frames(heads[of_topic])
        kind = reader.message_type(topic)
        if kind is not None and "time_ns" in kind.names:
            at, head = int(starts[of_topic[0]]), heads[of_topic[0]]
            content = chunk.data[at + MESSAGE_HEAD.size : at + HEAD.size + int(head["length"])]
            try:
                said = dict(zip(kind.names, kind.decode(content), strict=True))
            except ValueError as error:
                raise ChunkDamage(f"a message of {topic} cannot be read ({error})") from None
            fits &= int(said["time_ns"]) + reader.epoch_offset_ns == int(head["log_time_ns"])
    return _Found(place, hashlib.sha256(chunk.data).digest(), frames, fits)


def _frames(heads: NDArray[np.void]) -> Frames:
    numbers = heads["sequence"].astype(np.int64)
    times_ns = heads["log_time_ns"]
    rising = bool(np.all(np.diff(numbers) > 0)) and bool(np.all(times_ns[1:] >= times_ns[:-1]))
    return Frames(int(numbers[0]), int(numbers[-1]), int(times_ns[0]), int(times_ns[-1]), rising)


def _name(reader: RecordReader, found: _Found) -> str:
    channels = reader.contents.channels
    topics = " ".join(sorted(channels[number].topic for number in found.place.channels if number in channels))
    return f"chunk at byte {found.place.offset} ({topics or 'topics unknown'})"
