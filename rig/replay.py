"""A record through the same pipeline again, and what came out differently."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from acquisition.record.topics import RecordedWindow
from calibration.axes import Axes
from processing.spot import SensorModel, Spot, SpotFlag, SpotTracker
from processing.swing import Swing
from rig.analysis import analyse_swings
from rig.config import Configuration
from rig.instrument import sensor_model
from rig.pipeline import Pipeline
from rig.provenance import frame_shape, recorded_configuration
from rig.results import results_tree, write_results
from rig.view.terminal import print_results, say

_BLOCK_SPOTS = 10_000
_BLOCK_WINDOWS = 64


@dataclass(frozen=True, slots=True)
class Comparison:
    """Replayed against recorded. Differences of positions and swings in standard uncertainties."""

    spots: int
    spots_changed: int
    largest_spot_change_u: float
    swings_recorded: int
    swings_replayed: int
    swings_changed: int
    largest_swing_change_u: float

    @property
    def identical(self) -> bool:
        """Bit for bit."""
        return (
            self.spots_changed == 0
            and self.swings_changed == 0
            and self.swings_recorded == self.swings_replayed
        )


@dataclass(frozen=True, slots=True)
class Replayed:
    """What the pipeline made of a record, and the comparison with what it had made live."""

    swings: list[Swing]
    comparison: Comparison


def replay(reader: RecordReader, config: Configuration, *, retrack: bool) -> Replayed:
    """Put a record through the pipeline.

    Without `retrack` the recorded spots are used, and their deflections as they were recorded
    unless lever or axes have been changed; with it the spots are tracked again in the recorded
    windows. A frame whose spot was lost has no window and stays lost.
    """
    recorded = recorded_configuration(reader)
    table = reader.spots()
    shape = frame_shape(reader)
    pipeline = Pipeline(SpotTracker(_sensor(config, reader)), config.lever, config.axes or Axes(), shape)
    swings: list[Swing] = []
    x_px, y_px = table["x_px"], table["y_px"]
    if retrack:
        x_px, y_px = np.full(len(table), np.nan), np.full(len(table), np.nan)
        for rows, spots in _tracked_again(reader.windows(), table, pipeline.tracker, shape):
            swings += pipeline.measure(table["time_ns"][rows], spots).swings
            x_px[rows] = [spot.x_px for spot in spots]
            y_px[rows] = [spot.y_px for spot in spots]
    else:
        same = config.lever == recorded.lever and config.axes == recorded.axes
        for start in range(0, len(table), _BLOCK_SPOTS):
            part = table[start : start + _BLOCK_SPOTS]
            if same:
                block = pipeline.detect(
                    part["time_ns"], [], part["x_rad"], part["y_rad"], part["u_x_rad"], part["u_y_rad"]
                )
            else:
                block = pipeline.measure(part["time_ns"], _spots(part))
            swings += block.swings
    swings += pipeline.finish()
    return Replayed(swings, _compare(table, x_px, y_px, reader.swings(), swings))


def replay_record(record: Path, output: Path | None, *, retrack: bool, overrides: Sequence[str]) -> int:
    """`rig replay`: replay, compare, fit what came out; results.json where a folder is named."""
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, overrides)
        result = replay(reader, config, retrack=retrack)
        if reader.truncated:
            say(f"{record}: was cut short; what is there was replayed, rig recover makes a whole file of it")
    say_comparison(result.comparison)
    run = analyse_swings(record, result.swings, config)
    print_results([run], [])
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_results(output / "results.json", results_tree([run], output, {}))
        print(f"results      {output / 'results.json'}")
    return 1 if run.problem else 0


def say_comparison(comparison: Comparison) -> None:
    """One line, or two where something differs."""
    if comparison.identical:
        print(
            f"{comparison.spots} spots and {comparison.swings_replayed} swings, "
            "equal bit for bit to the recorded ones"
        )
        return
    print(
        f"{comparison.spots_changed} of {comparison.spots} spots differ, by at most "
        f"{comparison.largest_spot_change_u:.3g} standard uncertainties"
    )
    print(
        f"{comparison.swings_changed} of {comparison.swings_recorded} swings differ, by at most "
        f"{comparison.largest_swing_change_u:.3g} standard uncertainties; "
        f"{comparison.swings_replayed} were replayed"
    )


def _tracked_again(
    windows: Iterator[RecordedWindow], table: NDArray[Any], tracker: SpotTracker, shape: tuple[int, int]
) -> Iterator[tuple[slice, list[Spot]]]:
    """Rows of the table in blocks, with their spots; windows and rows are both in the frames' order."""
    window = next(windows, None)
    for start in range(0, len(table), _BLOCK_WINDOWS):
        spots: list[Spot] = []
        for sequence in table["sequence"][start : start + _BLOCK_WINDOWS].tolist():
            if window is not None and window.sequence == sequence:
                spots.append(tracker.track(window.image, window.origin_px, shape))
                window = next(windows, None)
            else:
                spots.append(_LOST)
        yield slice(start, start + len(spots)), spots


_LOST = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


def _spots(table: NDArray[Any]) -> list[Spot]:
    columns = [table[name].tolist() for name in Spot._fields]
    return [Spot(*row) for row in zip(*columns, strict=True)]


def _sensor(config: Configuration, reader: RecordReader) -> SensorModel:
    full_scale_dn = float(reader.metadata.get("camera", {}).get("full_scale_dn", "255"))
    return sensor_model(config, full_scale_dn)


def _compare(
    table: NDArray[Any],
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    recorded: list[Swing],
    replayed: list[Swing],
) -> Comparison:
    changed_px = ~(_same(table["x_px"], x_px) & _same(table["y_px"], y_px))
    with np.errstate(invalid="ignore"):
        in_u = np.maximum(
            np.abs(x_px - table["x_px"]) / table["u_x_px"], np.abs(y_px - table["y_px"]) / table["u_y_px"]
        )
    by_index = {swing.index: swing for swing in recorded}
    pairs = [(by_index[swing.index], swing) for swing in replayed if swing.index in by_index]
    swing_u = [
        max(
            abs(new.amplitude - old.amplitude) / old.u_amplitude,
            abs(new.turn_time_ns - old.turn_time_ns) * 1e-9 / old.u_turn_time_s,
        )
        for old, new in pairs
    ]
    return Comparison(
        spots=len(table),
        spots_changed=int(np.sum(changed_px)),
        largest_spot_change_u=float(np.nanmax(in_u[changed_px], initial=0.0)),
        swings_recorded=len(recorded),
        swings_replayed=len(replayed),
        swings_changed=sum(not _equal(old, new) for old, new in pairs) + abs(len(recorded) - len(pairs)),
        largest_swing_change_u=max(swing_u, default=0.0),
    )


def _same(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = (a == b) | (np.isnan(a) & np.isnan(b))
    return same


def _equal(old: Swing, new: Swing) -> bool:
    """Equal bit for bit, NaN being equal to NaN."""
    return all(
        a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))
        for a, b in zip(astuple(old), astuple(new), strict=True)
    )
