"""The comparison of replayed with recorded spots, half-cycles and fitted parameters."""

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.estimate import Estimate
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import NS_PER_S, seconds
from rig.analysis import RunResults

_MAX_TIME_DIFFERENCE = 0.25
"""Largest time difference of two turning points that count as the same, as a fraction of a half-period."""


class Differences(NamedTuple):
    """Numbers of spots, or of half-cycles, in record and replay, and their differences."""

    recorded: int = 0
    replayed: int = 0
    changed: int = 0
    """Number of those of which any bit differs, or that exist in only one of the two."""
    once: int = 0
    """Number of those that exist in only one of the two."""
    largest_u: float = 0.0
    """Largest change in recorded standard uncertainties."""
    largest_at: float = math.nan
    """Position of that change: the number of a spot's frame, or the time of a half-cycle in s."""


class ReplayDifferences(NamedTuple):
    """Differences between replay and record."""

    frames: int
    spots: Differences
    half_cycles: Differences
    flagged: int
    """Number of replayed half-cycles with a flag, which fits leave out."""

    @property
    def identical(self) -> bool:
        """Whether everything is equal bit for bit."""
        return self.spots.changed == 0 and self.half_cycles.changed == 0


class ParameterDifference(NamedTuple):
    """One quantity of the table of results, recorded and replayed; uncertainties are of the swings alone."""

    quantity: str
    fit: str
    recorded: Estimate
    replayed: Estimate

    @property
    def change_u(self) -> float:
        """The difference in recorded standard uncertainties; NaN if there is no uncertainty."""
        difference = self.replayed.value - self.recorded.value
        u = self.recorded.standard_uncertainty
        return 0.0 if difference == 0.0 else difference / u if u > 0 else math.nan


class ReplayComparison:
    """Collects differences during a replay; `start_ns` is the time of the record's first frame.

    Unless the amplitudes have the same unit (`is_one_unit`), only times of half-cycles are compared.
    """

    def __init__(self, start_ns: int, *, is_one_unit: bool) -> None:
        self._start_ns, self._is_one_unit = start_ns, is_one_unit
        self._frames = 0
        self._spots = Differences()

    def spots(self, rows: NDArray[Any], spots: Sequence[Spot]) -> None:
        """Add recorded spots (rows of the record's table) and the replayed spots of the same frames."""
        x_px = np.array([spot.x_px for spot in spots])
        y_px = np.array([spot.y_px for spot in spots])
        changed = ~(_are_same(rows["x_px"], x_px) & _are_same(rows["y_px"], y_px))
        recorded, replayed, so_far = np.isfinite(rows["x_px"]), np.isfinite(x_px), self._spots
        change_u = np.maximum(
            _in_u(x_px - rows["x_px"], rows["u_x_px"]), _in_u(y_px - rows["y_px"], rows["u_y_px"])
        )
        row = int(np.argmax(change_u))
        largest_u, largest_at = so_far.largest_u, so_far.largest_at
        if change_u[row] > largest_u:
            largest_u, largest_at = float(change_u[row]), float(rows["sequence"][row])
        self._frames += len(spots)
        self._spots = Differences(
            so_far.recorded + int(recorded.sum()),
            so_far.replayed + int(replayed.sum()),
            so_far.changed + int(changed.sum()),
            so_far.once + int((recorded != replayed).sum()),
            largest_u,
            largest_at,
        )

    def finish(self, recorded: Sequence[HalfCycle], replayed: Sequence[HalfCycle]) -> ReplayDifferences:
        """Compare the half-cycles, too; returns all differences."""
        pairs = _pairs(recorded, replayed)
        changes = [(self._half_cycle_change_u(old, new), old.turn_time_ns) for old, new in pairs]
        largest_u, largest_ns = max(changes, key=lambda change: change[0], default=(0.0, 0))
        once = len(recorded) + len(replayed) - 2 * len(pairs)
        half_cycles = Differences(
            len(recorded),
            len(replayed),
            sum(not _equal(old, new) for old, new in pairs) + once,
            once,
            largest_u,
            seconds(largest_ns - self._start_ns) if largest_u > 0 else math.nan,
        )
        flagged = sum(half_cycle.flags != 0 for half_cycle in replayed)
        return ReplayDifferences(self._frames, self._spots, half_cycles, flagged)

    def _half_cycle_change_u(self, old: HalfCycle, new: HalfCycle) -> float:
        """The larger change of amplitude and time, in standard uncertainties of the old half-cycle."""
        amplitude_u = _in_u(np.float64(new.amplitude - old.amplitude), old.u_amplitude)
        time_u = _in_u(np.float64(seconds(new.turn_time_ns - old.turn_time_ns)), old.u_turn_time_s)
        return float(max(amplitude_u, time_u) if self._is_one_unit else time_u)


def parameter_changes(recorded: RunResults, replayed: RunResults) -> list[ParameterDifference]:
    """Quantities with uncertainty that two results of a run have in common, in the order of the replayed."""
    old, new = (
        {(row.quantity, row.fit): Estimate(row.value, row.u) for row in run.table if math.isfinite(row.u)}
        for run in (recorded, replayed)
    )
    return [ParameterDifference(*key, old[key], new[key]) for key in new if key in old]


def _pairs(recorded: Sequence[HalfCycle], replayed: Sequence[HalfCycle]) -> list[tuple[HalfCycle, HalfCycle]]:
    """Pairs of half-cycles with the same turning point; their numbers may differ."""
    if not recorded:
        return []
    half_periods_s = [old.half_period_s for old in recorded if math.isfinite(old.half_period_s)]
    half_period_s = float(np.median(half_periods_s)) if half_periods_s else 0.0
    max_difference_ns = _MAX_TIME_DIFFERENCE * NS_PER_S * half_period_s
    times_ns = np.array([old.turn_time_ns for old in recorded])
    pairs: dict[int, tuple[HalfCycle, HalfCycle]] = {}
    for new in replayed:
        row = int(np.argmin(np.abs(times_ns - new.turn_time_ns)))
        if row not in pairs and abs(int(times_ns[row]) - new.turn_time_ns) <= max_difference_ns:
            pairs[row] = (recorded[row], new)
    return list(pairs.values())


def _in_u(change: Any, u: Any) -> Any:
    """Sizes of changes in standard uncertainties; 0 if change or uncertainty is not known."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.abs(change) / u
    return np.where(np.isfinite(ratio), ratio, 0.0)


def _are_same(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = (a == b) | (np.isnan(a) & np.isnan(b))
    return same


def _equal(old: HalfCycle, new: HalfCycle) -> bool:
    """Whether two half-cycles are equal bit for bit; NaN equals NaN."""
    return all(
        a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))
        for a, b in zip(astuple(old), astuple(new), strict=True)
    )
