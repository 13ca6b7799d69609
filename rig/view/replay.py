"""The replay of a record through the pipeline of a run."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record import pixels_path
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW, RecordedWindow
from processing.balance import Balance
from processing.deflections import Deflections
from processing.errors import RecordError
from processing.spot import BeamUse, Spot, SpotFlag
from processing.swing import HalfCycle
from processing.units import seconds
from rig.instrument import Block, Pipeline, frame_shape, optics_of, recorded_configuration, shutter_of
from rig.settings import Configuration
from rig.view.replay_comparison import ReplayComparison, ReplayDifferences

LOST_SPOT = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


class ReplayResult(NamedTuple):
    """Results of a replay."""

    half_cycles: list[HalfCycle]
    balances: list[Balance]
    deflections: list[Deflections]
    """Deflections in the blocks in which they were processed."""
    dropped_frames: int
    """Number of frames missing between the first and the last."""
    comparison: ReplayDifferences
    beam: BeamUse
    """Counts of spots by model of the beam."""


class Replay:
    """The replay of a record: take all `blocks`, then `finish`.

    Without `retrack` the recorded spots are used, and their recorded deflections, unless lever, axes or
    shutter have changed. With it the spots are tracked again in the recorded windows; a frame whose spot was
    lost has no window, and its spot stays lost. `reader` must stay open during the replay, `config` is the
    recorded or a changed configuration. Raises RecordError for a record without spots or windows.
    """

    def __init__(self, reader: RecordReader, config: Configuration, *, retrack: bool) -> None:
        self._reader = reader
        self._retrack = retrack
        recorded = recorded_configuration(reader)
        # only the tracker uses the sensor's noise, and it runs only with --retrack
        config = config if retrack else config.model_copy(update={"sensor": recorded.sensor})
        if retrack and not reader.counts.get(WINDOW.topic):
            reason = "" if recorded.record.windows else " (it was made with record.windows = false)"
            if recorded.record.windows and len(reader.files) == 1:
                reason = f" ({pixels_path(reader.path).name} is not beside it)"
            raise RecordError(
                f"{reader.path}: contains no windows of raw pixels{reason}, the spot cannot be tracked "
                "again; replay it without --retrack"
            )
        self._same_deflections = (config.lever, config.axes, shutter_of(config)) == (
            recorded.lever,
            recorded.axes,
            shutter_of(recorded),
        )
        self._shape = frame_shape(reader)
        first_rows = next(reader.spot_blocks(), None)
        if first_rows is None:
            raise RecordError(f"{reader.path}: contains no spots; there is nothing to replay")
        self.start_ns = int(first_rows["time_ns"][0])
        last_ns = max(reader.numbers.end_ns - reader.epoch_offset_ns, self.start_ns)
        self.duration_s = self.elapsed_s(last_ns)
        self._pipeline = Pipeline(optics_of(config, reader.full_scale_dn), self._shape)
        self._window: RecordedWindow | None = None
        self._half_cycles: list[HalfCycle] = []
        self._balances: list[Balance] = []
        self._deflections: list[Deflections] = []
        self._beam = BeamUse()
        self._last_sequence = -1
        is_one_unit = config.deflection_unit is reader.deflection_unit
        self._comparison = ReplayComparison(self.start_ns, is_one_unit=is_one_unit)

    def elapsed_s(self, time_ns: int) -> float:
        """Time from the first frame of the record."""
        return seconds(time_ns - self.start_ns)

    def blocks(self) -> Iterator[tuple[NDArray[np.int64], Block]]:
        """The numbers of some frames and the pipeline's block of them, one after the other."""
        windows = self._reader.windows()
        for rows in self._reader.spot_blocks():
            spots = self._track_again(rows, windows) if self._retrack else _spots(rows)
            block = self._block(rows, spots)
            sequences = rows["sequence"].astype(np.int64)
            self._half_cycles += block.half_cycles
            self._balances += block.balances
            self._deflections.append(block.deflections)
            self._beam.take(sequences, [spot.flags for spot in spots])
            self._comparison.spots(rows, spots)
            self._last_sequence = int(sequences[-1])
            yield sequences, block

    def finish(self) -> ReplayResult:
        """Complete the last half-cycles; returns all results."""
        half_cycles, balances = self._pipeline.finish()
        self._half_cycles += half_cycles
        self._balances += balances
        dropped = self._last_sequence + 1 - sum(map(len, self._deflections))
        comparison = self._comparison.finish(self._reader.half_cycles(), self._half_cycles)
        return ReplayResult(
            self._half_cycles, self._balances, self._deflections, dropped, comparison, self._beam
        )

    def _block(self, rows: NDArray[Any], spots: list[Spot]) -> Block:
        if self._retrack or not self._same_deflections:
            # the recorded time contains the correction for the shutter, which is calculated anew from the
            # time of the frame
            has_clock = rows["device_time_ns"] >= 0
            frame_times_ns = np.where(has_clock, rows["device_time_ns"], rows["host_time_ns"])
            deflections = self._pipeline.deflector(frame_times_ns.astype(np.int64), spots)
        else:
            deflections = self._reader.deflections(rows)
        return Block(spots, deflections, *self._pipeline.estimate(deflections))

    def _track_again(self, rows: NDArray[Any], windows: Iterator[RecordedWindow]) -> list[Spot]:
        """Track the spots again; windows and rows are both in the order of the frames."""
        tracker, (ny, nx) = self._pipeline.tracker, self._shape
        # the rows below are the reference's
        shape = min(ny, self._pipeline.reference_row or ny), nx
        spots: list[Spot] = []
        for sequence in rows["sequence"].tolist():
            # skip windows whose spots were in a damaged chunk
            while self._window is None or self._window.sequence < sequence:
                self._window = next(windows, None)
                if self._window is None:
                    break
            window = self._window
            if window is not None and window.sequence == sequence:
                spots.append(tracker.track(window.image, window.origin_px, shape))
            else:
                spots.append(LOST_SPOT)
        return spots


def _spots(table: NDArray[Any]) -> list[Spot]:
    columns = [table[name].tolist() for name in Spot._fields]
    return [Spot(*row) for row in zip(*columns, strict=True)]
