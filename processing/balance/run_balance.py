"""The balance of a whole decay, from the balances of its periods."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from processing.balance.balance import Balance
from processing.balance.plane import PlaneOfSwing

_FIRST = 5
"""Balances at the beginning, where the start has left its transverse motion."""


def balance_of_run(balances: Sequence[Balance], plane: PlaneOfSwing | None) -> Balance | None:
    """One balance for a decay; None without any.

    The transverse motion is that of the first periods, ellipticity and rest position are means, and the
    rotation is the fastest of the decay: that of its `plane`, without which it is NaN. The other fields are
    those of the first period.
    """
    if not balances:
        return None
    first = sorted(balances[:_FIRST], key=lambda one: one.transverse_ratio)[len(balances[:_FIRST]) // 2]
    width_ratio, u_width_ratio = _mean(balances, "width_ratio")
    rest_x, u_rest_x = _mean(balances, "rest_x")
    rest_y, u_rest_y = _mean(balances, "rest_y")
    rotation, u_rotation = math.nan, math.nan
    if plane is not None:
        times_ns = np.linspace(plane.first_ns, plane.last_ns, plane.directions).astype(np.int64)
        rates = plane.rate_rad_per_s(times_ns)
        rotation, u_rotation = float(rates[int(np.argmax(np.abs(rates)))]), plane.u_mean_rate()
    return replace(
        balances[0],
        transverse=first.transverse,
        u_transverse=first.u_transverse,
        transverse_ratio=first.transverse_ratio,
        u_transverse_ratio=first.u_transverse_ratio,
        width_ratio=width_ratio,
        u_width_ratio=u_width_ratio,
        rest_x=rest_x,
        u_rest_x=u_rest_x,
        rest_y=rest_y,
        u_rest_y=u_rest_y,
        rotation_rad_per_s=rotation,
        u_rotation_rad_per_s=u_rotation,
    )


def _mean(balances: Sequence[Balance], name: str) -> tuple[float, float]:
    """Weighted mean of a quantity and its standard uncertainty; NaN if no period knows it."""
    rows = [(getattr(one, name), getattr(one, f"u_{name}")) for one in balances]
    known = np.array([row for row in rows if math.isfinite(row[0]) and 0.0 < row[1] < math.inf])
    if not len(known):
        return math.nan, math.nan
    weights = known[:, 1] ** -2.0
    return float(np.average(known[:, 0], weights=weights)), float(np.sum(weights) ** -0.5)
