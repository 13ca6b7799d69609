"""A decay as a walk through a table of half-swings: their losses and durations over the amplitude."""

from collections.abc import Callable
from math import log
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from processing.arrays import Flags, Floats, Ints
from processing.contact.law import HalfSwings

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_MOST_GROWTH = 2.0
"""Of the first amplitude; a swing that grows by more is no decay, and such a law is searched no further."""


class SwingTable(NamedTuple):
    """Half-swings from amplitudes between `lowest` and the highest knot, of a law with k parameters.

    `values` is a function of ln A with 2 + 2 k columns: next amplitude over A, duration (T0), then the
    derivatives of each by the parameters at fixed A.
    """

    lowest: float
    values: "CubicSpline"


def walk(
    table_from: Callable[[float], SwingTable | None], count: int, first: float, index: Ints
) -> HalfSwings:
    """Turning points of a decay, as every law's `half_swing_map` returns them.

    Parameters
    ----------
    table_from
        The table for amplitudes from the given one down; None where the pendulum sticks.
    count
        Number of the law's parameters; the last column of the gradients is the first amplitude's.
    first
        The first amplitude.
    index
        Rising half-cycle numbers, the first 0.
    """
    last, most = int(index[-1]), _MOST_GROWTH * first
    amplitudes = [first]
    rows: list[Floats] = []
    while len(amplitudes) <= last and 0 < amplitudes[-1] <= most:
        table = table_from(amplitudes[-1])
        begun = len(amplitudes) - 1
        if table is not None:
            _append(table, amplitudes, last, most)
        if table is None or len(amplitudes) == begun + 1:
            break
        log_a = np.log(amplitudes[begun:-1])
        slope = table.values(log_a, 1)[:, :2] / np.exp(log_a)[:, None]
        rows.append(np.column_stack([slope, table.values(log_a)]))
    walked = np.concatenate(rows) if rows else np.empty((0, 2 * count + 4))
    a = np.array(amplitudes[: len(walked) + 1])
    # dA'/dA and, at fixed A, dA'/dq; likewise the duration
    by_a = walked[:, 2] + a[:-1] * walked[:, 0]
    by_q = a[:-1, None] * walked[:, 4 : 4 + count]
    product = np.concatenate([[1.0], np.cumprod(by_a)])
    summed = np.cumsum(by_q / product[1:, None], axis=0)
    gradient = product[:, None] * np.column_stack(
        [np.concatenate([np.zeros((1, count)), summed]), np.ones(len(a))]
    )
    by_time = walked[:, 1][:, None] * gradient[:-1]
    by_time[:, :count] += walked[:, 4 + count :]
    reached = index < len(a)
    at = index[reached]
    time = np.concatenate([[0.0], np.cumsum(walked[:, 3])])
    time_gradient = np.concatenate([np.zeros((1, count + 1)), np.cumsum(by_time, axis=0)])
    return HalfSwings(
        _filled(reached, a[at]),
        _filled(reached, time[at]),
        _filled(reached, gradient[at]),
        _filled(reached, time_gradient[at]),
    )


def _filled(where: Flags, values: Floats) -> Floats:
    out = np.full((len(where), *values.shape[1:]), np.nan)
    out[where] = values
    return out


def _append(table: SwingTable, amplitudes: list[float], last: int, most: float) -> None:
    """Append amplitudes until the table or the wanted number ends, or one is larger than `most`."""
    c3, c2, c1, c0 = (row.tolist() for row in table.values.c[:, :, 0])
    knots = table.values.x.tolist()
    origin, step = knots[0], knots[1] - knots[0]
    here = amplitudes[-1]
    while len(amplitudes) <= last and table.lowest <= here <= most:
        log_a = log(here)
        k = min(max(int((log_a - origin) / step), 0), len(c0) - 1)
        d = log_a - knots[k]
        here *= ((c3[k] * d + c2[k]) * d + c1[k]) * d + c0[k]
        amplitudes.append(here)
