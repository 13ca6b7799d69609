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
    """One half-cycle. `u_` marks standard uncertainties."""

    index: int
    """Number since the first half-cycle, missing ones counted: a difference is a number of half periods."""
    turn_time_ns: int
    """Time of the turning point on the samples' clock."""
    u_turn_time_s: float
    amplitude: float
    """Distance of the turning point from the centre, positive, in the unit of the deflection."""
    u_amplitude: float
    half_period_s: float
    """Time since the previous turning point; NaN for the first one and after a missing one."""
    u_half_period_s: float
    centre: float
    """Rest position at the turning point, in the unit of the deflection."""
    side: int
    """+1 or -1, alternating: the deflection at the turning point is ``centre + side * amplitude``."""
    flags: int
    """Bits of `HalfCycleFlag`."""

    def since(self, previous: "HalfCycle | None") -> "HalfCycle":
        """Copy with the half period since the previous half-cycle; NaN without it, or after a missing one."""
        half_period_s = u_half_period_s = math.nan
        if previous is not None and self.index - previous.index == 1:
            half_period_s = seconds(self.turn_time_ns - previous.turn_time_ns)
            u_half_period_s = math.hypot(self.u_turn_time_s, previous.u_turn_time_s)
        return replace(self, half_period_s=half_period_s, u_half_period_s=u_half_period_s)


@dataclass(frozen=True, slots=True)
class TurningPoints:
    """Unflagged turning points of a decay, the data of the fits, as arrays of equal length."""

    index: Ints
    """Numbers of the half-cycles; flagged and missing ones leave gaps."""
    time_s: Floats
    """Time since the first turning point."""
    u_time_s: Floats
    amplitude: Floats
    """Positive, in the unit of the deflections: rad, which contact laws require, or px without a lever."""
    u_amplitude: Floats

    def __len__(self) -> int:
        return len(self.index)

    def first(self, count: int) -> "TurningPoints":
        """The first `count` turning points."""
        return TurningPoints(*(getattr(self, field.name)[:count] for field in fields(self)))


def turning_points(half_cycles: Sequence[HalfCycle]) -> TurningPoints:
    """Unflagged half-cycles as arrays; times are relative to the first of them."""
    unflagged = [half_cycle for half_cycle in half_cycles if half_cycle.flags == 0]
    turn_time_ns = np.array([half_cycle.turn_time_ns for half_cycle in unflagged], dtype=np.int64)
    return TurningPoints(
        index=np.array([half_cycle.index for half_cycle in unflagged], dtype=np.int64),
        time_s=seconds(turn_time_ns - turn_time_ns[:1]),
        u_time_s=np.array([half_cycle.u_turn_time_s for half_cycle in unflagged], dtype=np.float64),
        amplitude=np.array([half_cycle.amplitude for half_cycle in unflagged], dtype=np.float64),
        u_amplitude=np.array([half_cycle.u_amplitude for half_cycle in unflagged], dtype=np.float64),
    )
