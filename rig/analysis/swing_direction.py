"""Whether what was recorded swings across the direction in which half-cycles are looked for."""

import math
from typing import Final

from calibration import Axes

_ACROSS: Final = 3.0
"""Fast over slow motion above which the pendulum was hardly pushed along the slow mode as it is stated."""
_MUCH: Final = 100.0
_FEWEST: Final = 4
"""Half-cycles of which a period and a decrement can be had (`processing/decay_summary.py`)."""


def why_no_half_cycles(record: str, fast_over_slow: float, half_cycles: int, axes: Axes | None) -> str:
    """Why a motion gives hardly any half-cycles, and what to state; empty where it gives enough, or where it
    does not go across.

    Half-cycles are those along the slow mode, which is the sensor's y where `axes` do not say otherwise.
    """
    if half_cycles >= _FEWEST or not fast_over_slow > _ACROSS:
        return ""
    stated_rad = 0.0 if axes is None else axes.slow_angle_rad
    # either direction across will do; this one is within the limits of the key
    across_rad = stated_rad + math.copysign(0.5 * math.pi, -stated_rad or 1.0)
    much = f"{fast_over_slow:.2g}" if fast_over_slow < _MUCH else f"more than {_MUCH:g}"
    along, looked = ("x", "y") if axes is None else ("the fast axis of [axes]", "the slow one")
    return (
        f"the swing is along {along}, {much} times as far as along {looked}, where half-cycles "
        f"are sought: state [axes] slow_angle_rad = {across_rad:.5g}; rig replay {record} --set "
        f"axes.slow_angle_rad={across_rad:.5g} finds them in the record"
    )
