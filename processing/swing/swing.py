"""Half-cycles of the decay: turning points, uncertainties and flags."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import IntFlag

import numpy as np

from processing.arrays import Floats, Ints
from processing.units import seconds


class HalfCycleFlag(IntFlag):
    """Problems found with a half-cycle, one bit each; 0 if there are none. Fits ignore flagged ones."""

    GAP = 1
    """Too few samples, or a long gap between them."""
    VIBRATION = 2
    """The residuals are larger than the samples' noise: the motion was disturbed."""
    LOW_AMPLITUDE = 4
    """The amplitude is less than about five times its uncertainty."""
    START = 8
    """The half-cycle in which the release or a kick happened."""
    INFERRED = 16
    """The turning point lies outside the sensor and was inferred from crossings of the sensor."""
    REST_MOVED = 32
    """A knock moved the rest position, and the fitted half-cycles are those on its other side."""


@dataclass(frozen=True, slots=True)
class HalfCycle:
    """One half-cycle.

    `amplitude` (positive) and `centre` have the unit of the deflection, which at the turning point is
    ``centre + side * amplitude``; side is +1 or -1 and alternates. `u_` marks standard uncertainties.
    """

    index: int
    """Number since the first half-cycle, missing ones counted: a difference is a number of half periods."""
    turn_time_ns: int
    """Time of the turning point on the samples' clock."""
    u_turn_time_s: float
    amplitude: float
    u_amplitude: float
    half_period_s: float
    """Time since the previous turning point; NaN for the first one and after a missing one."""
    u_half_period_s: float
    centre: float
    side: int
    flags: int
    """Bits of `HalfCycleFlag`."""

    def since(self, before: "HalfCycle | None") -> "HalfCycle":
        """The same with its half period since the one before; NaN without it, or after a missing one."""
        lasts_s = u_s = math.nan
        if before is not None and self.index - before.index == 1:
            lasts_s = seconds(self.turn_time_ns - before.turn_time_ns)
            u_s = math.hypot(self.u_turn_time_s, before.u_turn_time_s)
        return replace(self, half_period_s=lasts_s, u_half_period_s=u_s)


@dataclass(frozen=True, slots=True)
class TurningPoints:
    """Unflagged turning points of a decay, the data of the fits, as arrays of equal length.

    `time_s` is the time since the first turning point. `index` may have gaps. Amplitudes are positive and
    have the unit of the deflections: rad, which the contact laws require, or px without a calibration.
    """

    index: Ints
    time_s: Floats
    u_time_s: Floats
    amplitude: Floats
    u_amplitude: Floats

    def __len__(self) -> int:
        return len(self.index)

    def first(self, count: int) -> "TurningPoints":
        """The first `count` turning points."""
        return TurningPoints(*(getattr(self, column.name)[:count] for column in fields(self)))


def turning_points(swings: Sequence[HalfCycle]) -> TurningPoints:
    """Unflagged half-cycles as arrays; times are relative to the first of them."""
    good = [swing for swing in swings if swing.flags == 0]
    turn_time_ns = np.array([swing.turn_time_ns for swing in good], dtype=np.int64)
    return TurningPoints(
        index=np.array([swing.index for swing in good], dtype=np.int64),
        time_s=seconds(turn_time_ns - turn_time_ns[:1]),
        u_time_s=np.array([swing.u_turn_time_s for swing in good], dtype=np.float64),
        amplitude=np.array([swing.amplitude for swing in good], dtype=np.float64),
        u_amplitude=np.array([swing.u_amplitude for swing in good], dtype=np.float64),
    )
