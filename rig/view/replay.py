"""The replay of a record through the pipeline of a run, at any speed and from any position."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from acquisition.record import pixels_beside
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW, RecordedWindow
from processing.deflections import Deflections
from processing.errors import ConfigurationError, RecordError
from processing.spot import BeamUse, Spot, SpotFlag
from processing.swing import HalfCycle
from processing.units import nanoseconds, seconds
from rig.instrument import Block, Pipeline, frame_shape, optics_of, recorded_configuration, shutter_of
from rig.settings import Configuration
from rig.view.replay_comparison import ReplayComparison, ReplayDifferences

_LOST = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


class ReplayStep(NamedTuple):
    """Results of some frames: the pipeline's block, and the recorded whole frames.

    `sequences` are the frame numbers (n,), in the order of the times of the block.
    """

    sequences: NDArray[np.int64]
    block: Block
    pictures: list[Frame]


class ReplayResult(NamedTuple):
    """Results of a replay; `dropped_frames` counts frames missing between the first and the last.

    `beam` counts spots by model of the beam. `deflections` are in the pieces in which they were processed.
    """

    swings: list[HalfCycle]
    deflections: list[Deflections]
    dropped_frames: int
    comparison: ReplayDifferences
    beam: BeamUse


class Replay:
    """The replay of a record.

    Without `retrack` the recorded spots are used, and their deflections as they were recorded
    unless lever or axes have been changed; with it the spots are tracked again in the recorded
    windows. A frame whose spot was lost has no window and stays lost.

    The state of the pipeline depends on all frames before. Going forwards therefore processes every
    frame; going backwards starts a new pipeline (`restart`), whose results are not compared with the
    record.

    Parameters
    ----------
    reader
        Must stay open during the replay.
    config
        The recorded or a changed configuration.
    from_s, to_s
        The part to be replayed, in seconds from the first frame.
    pictures
        Whether to return whole frames.

    Raises
    ------
    RecordError
        There are no spots in the record or in the wanted part, or data that are needed are missing.
    ConfigurationError
        The wanted part begins after the end of the record.
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
        self._retrack = retrack
        self._pictures = pictures
        recorded = recorded_configuration(reader)
        # only the tracker uses the sensor's noise, and without --retrack it has nothing to do
        self._config = config if retrack else config.model_copy(update={"sensor": recorded.sensor})
        if retrack and not reader.counts.get(WINDOW.topic):
            why = "" if recorded.record.windows else " (it was made with record.windows = false)"
            if recorded.record.windows and len(reader.files) == 1:
                why = f" ({pixels_beside(reader.path).name} is not beside it)"
            raise RecordError(
                f"{reader.path}: contains no windows of raw pixels{why}, the spot cannot be tracked again; "
                "replay it without --retrack"
            )
        self._same_deflections = (config.lever, config.axes, shutter_of(config)) == (
            recorded.lever,
            recorded.axes,
            shutter_of(recorded),
        )
        self._shape = frame_shape(reader)
        head = next(reader.spot_blocks(), None)
        if head is None:
            raise RecordError(f"{reader.path}: contains no spots; there is nothing to replay")
        self.start_ns = int(head["time_ns"][0])
        self._last_ns = max(reader.numbers.end_ns - reader.epoch_offset_ns, self.start_ns)
        if from_s > seconds(self._last_ns - self.start_ns):
            length_s = seconds(self._last_ns - self.start_ns)
            raise ConfigurationError(
                f"--from {from_s:g}: beyond the end of {reader.path}, which goes from 0 to {length_s:.1f} s"
            )
        self._from_ns = self.start_ns + nanoseconds(from_s)
        self._to_ns = self._last_ns if math.isinf(to_s) else self.start_ns + nanoseconds(to_s)
        self.partial = from_s > 0 or self._to_ns < self._last_ns
        self.was_restarted = False
        self._table: NDArray[Any] = head[:0]
        self._row = 0
        self._begin(self._from_ns)

    @property
    def length_s(self) -> float:
        """Time at which the replay ends, in seconds from the record's first frame."""
        return seconds(min(self._to_ns, self._last_ns) - self.start_ns)

    @property
    def position_s(self) -> float:
        """Time of the last processed frame, in seconds from the record's first frame."""
        return seconds(self._position_ns - self.start_ns)

    @property
    def pipeline_start_s(self) -> float:
        """Time at which the pipeline was started, in seconds from the record's first frame."""
        return seconds(self._pipeline_start_ns - self.start_ns)

    @property
    def next_s(self) -> float:
        """Time of the next frame; infinite at the end."""
        if self._row >= len(self._table):
            table = next(self._tables, None)
            if table is None:
                return math.inf
            self._table, self._row = table, 0
        next_ns = int(self._table["time_ns"][self._row])
        return math.inf if next_ns > self._to_ns else seconds(next_ns - self.start_ns)

    @property
    def next_sequence(self) -> int:
        """Number of the next frame; 0 at the end."""
        return 0 if math.isinf(self.next_s) else int(self._table["sequence"][self._row])

    def restart(self, time_s: float) -> None:
        """Start again at a time; the results so far are discarded."""
        self.was_restarted = True
        self._begin(self.start_ns + nanoseconds(max(time_s, 0.0)))

    def advance(self, until_s: float, most: int) -> ReplayStep | None:
        """Process the next frames up to and including a time, at most `most` of them.

        Returns None if no frame is due or none is left (`next_s` distinguishes the two).
        """
        next_s = self.next_s
        if next_s > until_s or math.isinf(next_s):
            return None
        limit_ns = self._to_ns
        if until_s < self.length_s:
            limit_ns = min(limit_ns, self.start_ns + nanoseconds(until_s))
        rows = self._table[self._row : self._row + most]
        rows = rows[: max(1, int(np.searchsorted(rows["time_ns"], limit_ns, side="right")))]
        self._row += len(rows)
        self._position_ns = int(rows["time_ns"][-1])
        spots = self._track_again(rows) if self._retrack else _spots(rows)
        block = self._block(rows, spots)
        self._collect(rows, block)
        self._comparison.spots(rows, spots)
        return ReplayStep(rows["sequence"].astype(np.int64), block, self._pictures_in(rows))

    def finish(self) -> ReplayResult:
        """Complete the last half-cycles; returns all results since the start."""
        swings = self._pipeline.finish()
        whole_end = math.isinf(self.next_s) and self._to_ns >= self._last_ns
        self._swings += swings
        first = self._first_sequence if self.partial or self.was_restarted else 0
        dropped = self._last_sequence + 1 - first - sum(map(len, self._deflections))
        # at the end of a part the last half-cycle lacks samples that the recorded one had
        compared = self._swings if whole_end else self._swings[: len(self._swings) - len(swings)]
        comparison = self._comparison.finish(
            self._reader.swings(),
            compared,
            from_start=self._pipeline_start_ns == self.start_ns,
            to_end=whole_end,
        )
        return ReplayResult(self._swings, self._deflections, dropped, comparison, self._beam)

    def _begin(self, time_ns: int) -> None:
        shape = self._shape
        self._pipeline = Pipeline(optics_of(self._config, self._reader.full_scale_dn), shape)
        from_ns = None if time_ns <= self.start_ns else time_ns
        self._tables = self._reader.spot_blocks(from_ns)
        self._table, self._row = self._table[:0], 0
        self._windows: Iterator[RecordedWindow] = self._reader.windows(from_ns)
        self._window: RecordedWindow | None = None
        self._images = self._reader.images(from_ns)
        self._image: Frame | None = None
        self._pipeline_start_ns = self._position_ns = max(time_ns, self.start_ns)
        self._swings: list[HalfCycle] = []
        self._deflections: list[Deflections] = []
        self._beam = BeamUse()
        self._first_sequence, self._last_sequence = -1, -1
        is_one_unit = self._config.deflection_unit is self._reader.deflection_unit
        self._comparison = ReplayComparison(self.start_ns, is_one_unit=is_one_unit)

    def _block(self, rows: NDArray[Any], spots: list[Spot]) -> Block:
        if self._retrack or not self._same_deflections:
            # the recorded time is that of the spot's rows; from the frame's time the shutter shifts it anew
            has_clock = rows["device_time_ns"] >= 0
            frame_times_ns = np.where(has_clock, rows["device_time_ns"], rows["host_time_ns"])
            return self._pipeline.measure(frame_times_ns.astype(np.int64), spots)
        return self._pipeline.detect(spots, self._reader.deflections(rows))

    def _collect(self, rows: NDArray[Any], block: Block) -> None:
        self._swings += block.swings
        self._deflections.append(block.deflections)
        self._beam.take(rows["sequence"], [spot.flags for spot in block.spots])
        if self._first_sequence < 0:
            self._first_sequence = int(rows["sequence"][0])
        self._last_sequence = int(rows["sequence"][-1])

    def _track_again(self, rows: NDArray[Any]) -> list[Spot]:
        """Track the spots again; windows and rows are both in the order of the frames."""
        spots: list[Spot] = []
        for sequence in rows["sequence"].tolist():
            # skip windows whose spots were in a damaged chunk
            while self._window is None or self._window.sequence < sequence:
                self._window = next(self._windows, None)
                if self._window is None:
                    break
            window = self._window
            if window is not None and window.sequence == sequence:
                spots.append(
                    self._pipeline.tracker.track(
                        window.image, window.origin_px, self._pipeline.spots.pendulum_shape(self._shape)
                    )
                )
            else:
                spots.append(_LOST)
        return spots

    def _pictures_in(self, rows: NDArray[Any]) -> list[Frame]:
        found: list[Frame] = []
        while self._pictures:
            self._image = self._image or next(self._images, None)
            if self._image is None or self._image.sequence > int(rows["sequence"][-1]):
                break
            row = int(np.searchsorted(rows["sequence"], self._image.sequence))
            if row < len(rows) and rows["sequence"][row] == self._image.sequence:
                found.append(self._image)
            self._image = None
        return found


def _spots(table: NDArray[Any]) -> list[Spot]:
    columns = [table[name].tolist() for name in Spot._fields]
    return [Spot(*row) for row in zip(*columns, strict=True)]
