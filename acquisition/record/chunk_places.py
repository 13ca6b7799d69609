"""Where the chunks of a record are."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ChunkPlace(NamedTuple):
    """Position of a chunk in the file. `channels` are those listed in its index."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass
class ChunkPlaces:
    """Chunks in the order of the file, 34 bytes each: a record of one day has 200,000."""

    _numbers: "array[int]" = field(default_factory=lambda: array("Q"))
    _sets: "array[int]" = field(default_factory=lambda: array("H"))
    _known: dict[frozenset[int], int] = field(default_factory=dict)

    def append(self, place: ChunkPlace) -> None:
        """Add the next chunk."""
        self._numbers.extend(place[:4])
        self._sets.append(self._known.setdefault(place.channels, len(self._known)))

    def __len__(self) -> int:
        return len(self._sets)

    def __getitem__(self, index: int) -> ChunkPlace:
        at = 4 * range(len(self))[index]
        offset, length, start_ns, end_ns = self._numbers[at : at + 4]
        return ChunkPlace(offset, length, start_ns, end_ns, list(self._known)[self._sets[index]])

    def __iter__(self) -> Iterator[ChunkPlace]:
        channels = list(self._known)
        rows = zip(*[iter(self._numbers)] * 4, self._sets, strict=True)
        for offset, length, start_ns, end_ns, known in rows:
            yield ChunkPlace(offset, length, start_ns, end_ns, channels[known])

    def extents(self) -> NDArray[np.uint64]:
        """(offset, length) of every chunk, a row each."""
        return np.array(self._numbers, dtype=np.uint64).reshape(-1, 4)[:, :2]
