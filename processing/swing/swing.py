"""Half-cycles of the decay: turning points and what they are worth."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray


class SwingFlag(IntFlag):
    """What was found wrong with a half-cycle; 0 where nothing was. A flagged one is not fitted."""

    GAP = 1
    """Samples are missing where they matter."""
    VIBRATION = 2
    """Residuals are larger than the samples' own noise explains."""
    LOW_AMPLITUDE = 4
    """The amplitude is less than about five times its uncertainty."""
    START = 8
    """The half-cycle in which the release or a kick happened."""
    INFERRED = 16
    """The turning point lies off the sensor and was inferred from the crossings."""


@dataclass(frozen=True, slots=True)
class Swing:
    """One half-cycle.

    `index` counts half-cycles from the first one, missing ones included, so that a difference of
    indices is a number of half periods. `turn_time_ns` is the time of the turning point on the
    clock of the samples. `amplitude` (positive) and `centre` carry the unit of the deflection;
    the deflection at the turning point is ``centre + side * amplitude`` with side +1 or -1, which
    alternates with the index. `half_period_s` is the time since the previous turning point, NaN
    for the first and after a missing one.
    """

    index: int
    turn_time_ns: int
    u_turn_time_s: float
    amplitude: float
    u_amplitude: float
    half_period_s: float
    u_half_period_s: float
    centre: float
    side: int
    flags: int


SWING_DTYPE = np.dtype(
    [
        ("index", np.int64),
        ("turn_time_ns", np.int64),
        ("u_turn_time_s", np.float64),
        ("amplitude", np.float64),
        ("u_amplitude", np.float64),
        ("half_period_s", np.float64),
        ("u_half_period_s", np.float64),
        ("centre", np.float64),
        ("side", np.int64),
        ("flags", np.int64),
    ]
)


@dataclass(frozen=True, slots=True)
class TurningPoints:
    """What the fits see of a decay: unflagged turning points as arrays of one length.

    `time_s` counts from the first turning point. `index` may have gaps. Amplitudes are positive, in
    the unit of the deflections they were found in: rad, which the contact's laws need, or px without
    a calibration.
    """

    index: NDArray[np.int64]
    time_s: NDArray[np.float64]
    u_time_s: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    u_amplitude: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.index)


def turning_points(swings: Sequence[Swing]) -> TurningPoints:
    """Unflagged swings as arrays, times from the first of them."""
    rows = np.array([astuple(s) for s in swings if s.flags == 0], dtype=SWING_DTYPE)
    first_ns = rows["turn_time_ns"][0] if len(rows) else 0
    return TurningPoints(
        index=rows["index"],
        time_s=(rows["turn_time_ns"] - first_ns) * 1e-9,
        u_time_s=rows["u_turn_time_s"],
        amplitude=rows["amplitude"],
        u_amplitude=rows["u_amplitude"],
    )
