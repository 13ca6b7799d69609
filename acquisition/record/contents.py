"""Table of contents of an MCAP file: its chunks, topics and attached files, and what is damaged."""

from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.writer import MCAP0_MAGIC as MAGIC


class Damage(NamedTuple):
    """A damaged part of a record: topics and times (UTC) of the chunk, and a description."""

    start_ns: int
    end_ns: int
    topics: tuple[str, ...]
    what: str


class ChunkPlace(NamedTuple):
    """Position of a chunk in the file, its range of log times, and the channels in it, as far as known."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


class ChunkPlaces:
    """The chunks in the order of the file, 34 bytes each: a record of one day has 170,000."""

    def __init__(self) -> None:
        self._numbers = array("Q")
        self._sets = array("H")
        self._known: dict[frozenset[int], int] = {}

    def append(self, place: ChunkPlace) -> None:
        """Add the next chunk."""
        self._numbers.extend(place[:4])
        self._sets.append(self._known.setdefault(place.channels, len(self._known)))

    def __len__(self) -> int:
        return len(self._sets)

    def __iter__(self) -> Iterator[ChunkPlace]:
        return self.since(0)

    def since(self, first: int) -> Iterator[ChunkPlace]:
        """The chunks from this one on, counted from 0."""
        channels = list(self._known)
        rows = zip(*[iter(self._numbers[4 * first :])] * 4, self._sets[first:], strict=True)
        for offset, length, start_ns, end_ns, known in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[known])


@dataclass
class Contents:
    """Table of contents of a file.

    `whole` is False for a file without an ending; `readable_bytes` is the end of its last complete record.
    `indexed` is True if the chunks come from a summary with a correct checksum, so that their channels are
    reliable. `counts` are the numbers of messages by channel. `attachments` are the sizes of attached files,
    `attachment_places` where their copies are. `damage` describes parts of the structure that could not be
    read.
    """

    size: int = 0
    library: str = ""
    whole: bool = False
    indexed: bool = False
    readable_bytes: int = len(MAGIC)
    channels: dict[int, str] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    attachment_places: dict[str, list[int]] = field(default_factory=dict)
    chunks: ChunkPlaces = field(default_factory=ChunkPlaces)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int = 0
    end_ns: int = 0
    data_end: int = 0
    data_crc: int = 0
    damage: list[str] = field(default_factory=list)

    def add_chunk(self, place: ChunkPlace) -> None:
        """Note the next chunk."""
        self.start_ns = min(self.start_ns, place.start_ns) if len(self.chunks) else place.start_ns
        self.end_ns = max(self.end_ns, place.end_ns)
        self.chunks.append(place)

    def add_attachment(self, name: str, size: int, place: int) -> None:
        """Note an attached file; its checksum is verified when it is read."""
        self.attachments[name] = size
        self.attachment_places.setdefault(name, []).append(place)
