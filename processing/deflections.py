"""Deflections of the pendulum at the times of the frames, with uncertainties and unit."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Self

import numpy as np

from processing.arrays import Flags, Floats, Ints
from processing.units import ARCSEC_RAD, seconds

_ARRAYS = ("times_ns", "x", "y", "u_x", "u_y")


class DeflectionUnit(StrEnum):
    """Unit of deflections and amplitudes: rad, or px without a lever arm calibration."""

    RAD = "rad"
    PX = "px"

    @property
    def shown(self) -> str:
        """Unit for display: arcsec for rad, px for px."""
        return "arcsec" if self is DeflectionUnit.RAD else "px"

    @property
    def shown_size(self) -> float:
        """Size of the unit for display, in this unit; values are divided by it for display."""
        return ARCSEC_RAD if self is DeflectionUnit.RAD else 1.0


@dataclass(frozen=True, slots=True)
class Deflections:
    """Deflections as arrays of equal length, one entry per frame, in order of time.

    `y` is along the slow mode's axis (the paper's Y), `x` along the fast mode's. `u_x` and `u_y` are
    standard uncertainties. All four are in `unit`, and NaN in frames without a spot.
    """

    times_ns: Ints
    x: Floats
    y: Floats
    u_x: Floats
    u_y: Floats
    unit: DeflectionUnit

    def __len__(self) -> int:
        return len(self.times_ns)

    def __getitem__(self, rows: slice | Flags) -> Self:
        """Deflections of some of the frames."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _ARRAYS})

    @property
    def times_s(self) -> Floats:
        """Seconds since the first frame."""
        return seconds(self.times_ns - self.times_ns[:1])

    @property
    def shown_x(self) -> Floats:
        """`x` in the unit for display."""
        return self.x / self.unit.shown_size

    @property
    def shown_y(self) -> Floats:
        """`y` in the unit for display."""
        return self.y / self.unit.shown_size

    @property
    def found(self) -> Flags:
        """Whether a frame has a spot."""
        return np.isfinite(self.x) & np.isfinite(self.y)

    def since(self, time_ns: int) -> Self:
        """The frames at or after a time."""
        return self[int(np.searchsorted(self.times_ns, time_ns)) :]


def no_deflections(unit: DeflectionUnit) -> Deflections:
    """Empty deflections."""
    empty = np.empty(0)
    return Deflections(np.empty(0, np.int64), empty, empty, empty, empty, unit)


def slow_deflections(times_ns: Ints, y: Floats, u_y: Floats | float) -> Deflections:
    """Deflections `y` (n,) in rad along the slow axis with `u_y`, (n,) or one for all; `x` is NaN."""
    unknown = np.full(len(times_ns), np.nan)
    u_y = np.broadcast_to(u_y, y.shape).astype(np.float64)
    return Deflections(times_ns, unknown, y, unknown, u_y, DeflectionUnit.RAD)


def joined(parts: Iterable[Deflections], unit: DeflectionUnit) -> Deflections:
    """Concatenation of consecutive parts; `unit` is used if there are none.

    Raises ValueError if the parts have different units.
    """
    parts = list(parts)
    if not parts:
        return no_deflections(unit)
    if len(units := {part.unit for part in parts}) > 1:
        raise ValueError(f"deflections in {' and '.join(sorted(units))} cannot be joined")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS
    }
    return replace(parts[0], **arrays)
