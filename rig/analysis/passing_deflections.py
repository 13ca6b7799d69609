"""Deflections of a run while they pass, and what its results say of all of them."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from processing.deflections import Deflections, DeflectionUnit

_SHORT = 300_000
"""Most frames of a run that are kept whole: some twenty megabytes, fifty minutes at 100 frames/s."""


class PassingDeflections:
    """The deflections of a run, in order, some thousand frames at a time.

    Of a long run only the coordinates of the frames that have passed are kept, 16 bytes a frame: a day's
    deflections with their times and uncertainties would be several hundred megabytes. A short one is not read
    again by who passes through once more.

    Parameters
    ----------
    blocks
        Consecutive frames. They are asked for again by who passes through more than once.
    unit
        Of every block.

    Attributes
    ----------
    frames, lost_spots
        How many have passed, and how many of them without a spot.
    first_ns, last_ns
        Times of the first and of the last of them; 0 where none has.
    """

    def __init__(self, blocks: Iterable[Deflections], unit: DeflectionUnit) -> None:
        self.unit = unit
        self.frames = 0
        self.lost_spots = 0
        self.first_ns = 0
        self.last_ns = 0
        self._source = blocks
        self._blocks = iter(blocks)
        self._passed = False
        self._kept: list[Deflections] | None = []
        self._x: list[NDArray[np.float64]] = []
        self._y: list[NDArray[np.float64]] = []

    def __iter__(self) -> Iterator[Deflections]:
        """The first time all frames are counted; afterwards they pass once more."""
        if self._passed:
            yield from filter(len, self._source if self._kept is None else self._kept)
            return
        for block in self._blocks:
            if not len(block):
                continue
            if not self.frames:
                self.first_ns = int(block.times_ns[0])
            self.last_ns = int(block.times_ns[-1])
            self.frames += len(block)
            self.lost_spots += len(block) - int(np.count_nonzero(block.found))
            self._x.append(block.x)
            self._y.append(block.y)
            if self.frames > _SHORT:
                self._kept = None
            if self._kept is not None:
                self._kept.append(block)
            yield block
        self._passed = True

    def fast_ratio(self) -> float:
        """Fast over slow motion (r.m.s. about the median, NaN left out) of all frames, those left included.

        0 where there is nothing to compare. What has passed is forgotten.
        """
        if not self._passed:
            for _ in self:
                pass
        spread_x, spread_y = _spread(self._x), _spread(self._y)
        return spread_x / spread_y if spread_y > 0 else 0.0


def _spread(blocks: list[NDArray[np.float64]]) -> float:
    """Root mean square about the median; `blocks` is emptied."""
    # Joined twice, because the median sorts and would need a copy of its own while the blocks are there.
    if not any(np.isfinite(block).any() for block in blocks):
        return 0.0
    median = np.median(_finite(blocks), overwrite_input=True)
    values = _finite(blocks)
    blocks.clear()
    values -= median
    return float(np.sqrt(np.mean(np.square(values, out=values))))


def _finite(blocks: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    values = np.empty(sum(map(len, blocks)))
    count = 0
    for block in blocks:
        good = block[np.isfinite(block)]
        values[count : count + len(good)] = good
        count += len(good)
    return values[:count]
