"""A record through the same pipeline again, at any pace and from any place in it."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW, RecordedWindow
from processing.deflections import Deflections, joined
from processing.errors import RecordError
from processing.spot import Spot, SpotFlag
from processing.swing import Swing
from rig.instrument import Block, frame_shape, optics_of, recorded_configuration
from rig.replay.comparison import Comparison, ReplayComparison
from rig.settings import Configuration

_LOST = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


class Step(NamedTuple):
    """What became of some frames: what the pipeline made of them, and the whole frames among them.

    `sequences` are the frames' numbers, as many as the block has times. Each picture comes with
    the spot that was found in it.
    """

    sequences: NDArray[np.int64]
    block: Block
    pictures: list[tuple[Frame, Spot]]


class Replayed(NamedTuple):
    """All that came out; `dropped_frames` are missing in the record between the first and the last."""

    swings: list[Swing]
    deflections: Deflections
    dropped_frames: int
    comparison: Comparison


class Replay:
    """A record on its way through the pipeline.

    Without `retrack` the recorded spots are used, and their deflections as they were recorded
    unless lever or axes have been changed; with it the spots are tracked again in the recorded
    windows. A frame whose spot was lost has no window and stays lost.

    The state of the pipeline is that of the frames before. Going on is therefore always done frame
    by frame, however fast; going back begins anew (`restart`), with a pipeline that knows nothing of
    what was before, and what comes out then is not compared with the record.

    Parameters
    ----------
    reader
        Open, and stays so for as long as the replay goes.
    config
        As recorded, or changed.
    from_s, to_s
        The part to be replayed, in seconds from the first frame.
    pictures
        Whether whole frames are wanted.

    Raises
    ------
    RecordError
        There are no spots, or none in the part that is wanted; the record does not hold what a replay
        needs.
    """

    def __init__(
        self,
        reader: RecordReader,
        config: Configuration,
        *,
        retrack: bool,
        from_s: float = 0.0,
        to_s: float = math.inf,
        pictures: bool = False,
    ) -> None:
        self._reader = reader
        self._config = config
        self._retrack = retrack
        self._pictures = pictures
        recorded = recorded_configuration(reader)
        if retrack and not reader.counts.get(WINDOW.topic):
            why = "" if recorded.record.windows else " (it was made with record.windows = false)"
            raise RecordError(
                f"{reader.path}: holds no windows of raw pixels{why}, so the spot cannot be tracked again; "
                "replay it without --retrack"
            )
        self._same_deflections = config.lever == recorded.lever and config.axes == recorded.axes
        self._shape = frame_shape(reader)
        head = next(reader.spot_blocks(), None)
        if head is None:
            raise RecordError(f"{reader.path}: holds no spots; there is nothing to replay")
        self.start_ns = int(head["time_ns"][0])
        self._last_ns = max(reader.contents.end_ns - reader.epoch_offset_ns, self.start_ns)
        if from_s > (self._last_ns - self.start_ns) * 1e-9:
            length_s = (self._last_ns - self.start_ns) * 1e-9
            raise RecordError(f"{reader.path}: is {length_s:.1f} s long; nothing follows {from_s:g} s")
        self._from_ns = self.start_ns + round(from_s * 1e9)
        self._to_ns = self._last_ns if math.isinf(to_s) else self.start_ns + round(to_s * 1e9)
        self.partial = from_s > 0 or self._to_ns < self._last_ns
        self.sought = False
        self._table: NDArray[Any] = head[:0]
        self._row = 0
        self._comparison = ReplayComparison(self.start_ns)
        self._begin(self._from_ns)

    @property
    def length_s(self) -> float:
        """Up to which time the record is replayed, in seconds from its first frame."""
        return (min(self._to_ns, self._last_ns) - self.start_ns) * 1e-9

    @property
    def position_s(self) -> float:
        """Time of the last frame that went through, in seconds from the record's first."""
        return (self._position_ns - self.start_ns) * 1e-9

    @property
    def begun_s(self) -> float:
        """Where the pipeline began, in seconds from the record's first frame."""
        return (self._begun_ns - self.start_ns) * 1e-9

    @property
    def next_s(self) -> float:
        """Time of the next frame; infinite at the end."""
        if self._row >= len(self._table):
            table = next(self._tables, None)
            if table is None:
                return math.inf
            self._table, self._row = table, 0
        next_ns = int(self._table["time_ns"][self._row])
        return math.inf if next_ns > self._to_ns else (next_ns - self.start_ns) * 1e-9

    @property
    def next_sequence(self) -> int:
        """Number of the next frame; 0 at the end."""
        return 0 if math.isinf(self.next_s) else int(self._table["sequence"][self._row])

    def restart(self, time_s: float) -> None:
        """Begin anew at a time; what came out so far is forgotten."""
        self.sought = True
        self._begin(self.start_ns + round(max(time_s, 0.0) * 1e9))

    def advance(self, until_s: float, most: int) -> Step | None:
        """Put the next frames through, up to a time (included), at most so many.

        None where no frame is due, or none is left (`next_s` tells the two apart).
        """
        next_s = self.next_s
        if next_s > until_s or math.isinf(next_s):
            return None
        limit_ns = self._to_ns
        if until_s < self.length_s:
            limit_ns = min(limit_ns, self.start_ns + round(until_s * 1e9))
        rows = self._table[self._row : self._row + most]
        rows = rows[: max(1, int(np.searchsorted(rows["time_ns"], limit_ns, side="right")))]
        self._row += len(rows)
        self._position_ns = int(rows["time_ns"][-1])
        spots = self._tracked_again(rows) if self._retrack else _spots(rows)
        block = self._block(rows, spots)
        self._keep(rows, block)
        self._comparison.spots(rows, spots)
        return Step(rows["sequence"].astype(np.int64), block, self._pictures_of(rows, spots))

    def finish(self) -> Replayed:
        """The last half-cycles, and everything that came out since the beginning."""
        swings = self._pipeline.finish()
        whole_end = math.isinf(self.next_s) and self._to_ns >= self._last_ns
        self._swings += swings
        deflections = joined(self._deflections, self._config.deflection_unit)
        first = self._first_sequence if self.partial or self.sought else 0
        dropped = self._last_sequence + 1 - first - len(deflections)
        # at a cut the last half-cycle lacks samples that it had when it was recorded
        compared = self._swings if whole_end else self._swings[: len(self._swings) - len(swings)]
        comparison = self._comparison.finish(
            self._reader.swings(),
            compared,
            from_start=self._begun_ns == self.start_ns,
            to_end=whole_end,
        )
        return Replayed(self._swings, deflections, dropped, comparison)

    def _begin(self, time_ns: int) -> None:
        shape = self._shape
        self._pipeline = optics_of(self._config, self._reader.full_scale_dn).pipeline(shape)
        from_ns = None if time_ns <= self.start_ns else time_ns
        self._tables = self._reader.spot_blocks(from_ns)
        self._table, self._row = self._table[:0], 0
        self._windows: Iterator[RecordedWindow] = self._reader.windows(from_ns)
        self._window: RecordedWindow | None = None
        self._images = self._reader.images(from_ns)
        self._image: Frame | None = None
        self._begun_ns = self._position_ns = max(time_ns, self.start_ns)
        self._swings: list[Swing] = []
        self._deflections: list[Deflections] = []
        self._first_sequence, self._last_sequence = -1, -1
        self._comparison = ReplayComparison(self.start_ns)

    def _block(self, rows: NDArray[Any], spots: list[Spot]) -> Block:
        if self._retrack or not self._same_deflections:
            return self._pipeline.measure(rows["time_ns"], spots)
        return self._pipeline.detect(spots, self._reader.deflections(rows))

    def _keep(self, rows: NDArray[Any], block: Block) -> None:
        self._swings += block.swings
        self._deflections.append(block.deflections)
        if self._first_sequence < 0:
            self._first_sequence = int(rows["sequence"][0])
        self._last_sequence = int(rows["sequence"][-1])

    def _tracked_again(self, rows: NDArray[Any]) -> list[Spot]:
        """Spots of the frames; windows and rows are both in the frames' order."""
        spots: list[Spot] = []
        for sequence in rows["sequence"].tolist():
            # a window whose spot was in a damaged chunk is skipped
            while self._window is None or self._window.sequence < sequence:
                self._window = next(self._windows, None)
                if self._window is None:
                    break
            window = self._window
            if window is not None and window.sequence == sequence:
                spots.append(self._pipeline.tracker.track(window.image, window.origin_px, self._shape))
            else:
                spots.append(_LOST)
        return spots

    def _pictures_of(self, rows: NDArray[Any], spots: list[Spot]) -> list[tuple[Frame, Spot]]:
        found: list[tuple[Frame, Spot]] = []
        while self._pictures:
            self._image = self._image or next(self._images, None)
            if self._image is None or self._image.time_ns > self._position_ns:
                break
            row = int(np.searchsorted(rows["sequence"], self._image.sequence))
            if row < len(rows) and rows["sequence"][row] == self._image.sequence:
                found.append((self._image, spots[row]))
            self._image = None
        return found


def _spots(table: NDArray[Any]) -> list[Spot]:
    columns = [table[name].tolist() for name in Spot._fields]
    return [Spot(*row) for row in zip(*columns, strict=True)]
