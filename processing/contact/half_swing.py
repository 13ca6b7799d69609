"""Half-swings of any law as a table over ln A, and decays as walks through it.

A law without memory (`memoryless`) or one that depends on the last reversal (`memory`) gives for each
amplitude A the result of a half-swing from it: the next amplitude and the duration, with their derivatives by
the law's parameters. Everything else reads that table: a free decay is a walk through it, and where the
ground moves the pendulum, the filter goes from any amplitude to the next.

Angles are in units of a reference amplitude, times in units of T0.
"""

from collections.abc import Callable
from functools import lru_cache
from math import log
from typing import NamedTuple

import numpy as np

from processing.arrays import Flags, Floats, Ints

TABLE_RATIO = 8.0
"""Largest amplitude over the smallest one of a table, where the range of a decay is not known."""
_MAX_GROWTH = 2.0
"""Largest amplitude over the first one to which a walk goes: a swing that grows by more is no decay."""


class HalfSwings(NamedTuple):
    """Turning points that a law predicts, and their derivatives with respect to the map's parameters.

    `amplitude` in units of the reference amplitude and `time` in units of T0, shape ``(points,)``,
    NaN after the pendulum has stopped; the gradients have one column per parameter of the map.
    """

    amplitude: Floats
    time: Floats
    amplitude_gradient: Floats
    time_gradient: Floats


class OneHalfSwing(NamedTuple):
    """Loss and duration of a half-swing at the falling amplitudes of a free decay.

    Amplitudes and losses are in units of the reference, durations in units of T0. `loss_slope` and
    `duration_slope` are derivatives with respect to the amplitude; `loss_gradient` and `duration_gradient`,
    shape ``(amplitudes, parameters)``, are those by the map's parameters at fixed amplitude. The column of
    the map's last parameter, the first amplitude, is zero.
    """

    amplitude: Floats
    loss: Floats
    loss_slope: Floats
    loss_gradient: Floats
    duration: Floats
    duration_slope: Floats
    duration_gradient: Floats

    def turning_points(self, first: float, index: Ints) -> HalfSwings:
        """The decay that these half-swings make, at rising half-cycle numbers of which the first is 0."""
        by_a, count = 1.0 - self.loss_slope, self.loss_gradient.shape[1]
        product = np.concatenate([[1.0], np.cumprod(by_a)])
        summed = np.cumsum(-self.loss_gradient / product[1:, None], axis=0)
        gradient = product[:, None] * np.concatenate([np.zeros((1, count)), summed])
        gradient[:, -1] = product
        by_time = self.duration_slope[:, None] * gradient[:-1] + self.duration_gradient
        time = np.concatenate([[0.0], np.cumsum(self.duration)])
        time_gradient = np.concatenate([np.zeros((1, count)), np.cumsum(by_time, axis=0)])
        last = self.amplitude[-1:] - self.loss[-1:] if len(self.amplitude) else np.array([first])
        reached = index <= len(self.amplitude)
        at = index[reached]
        return HalfSwings(
            _fill(reached, np.concatenate([self.amplitude, last])[at]),
            _fill(reached, time[at]),
            _fill(reached, gradient[at]),
            _fill(reached, time_gradient[at]),
        )


class SwingTable(NamedTuple):
    """Half-swings from amplitudes between `lowest` and the highest knot, of a law with k parameters.

    Between `knots`, which rise evenly in ln A, `cubics` (4, knots - 1, 2 + 2 k) of the distance from the
    lower knot, the highest power first, give next amplitude over A, duration (T0), then the derivatives of
    each by the parameters at fixed A.
    """

    lowest: float
    knots: Floats
    cubics: Floats

    @classmethod
    def of(cls, log_a: Floats, rows: Floats, fewest: int, beyond: int) -> "SwingTable | None":
        """The table of rows (2 + 2 k, amplitudes) at evenly rising ln A; None unless the last `fewest`
        amplitudes are finite.

        Below the highest that is not finite, the pendulum sticks. The lowest `beyond` amplitudes serve the
        interpolation alone.
        """
        usable = np.all(np.isfinite(rows), axis=0)
        if not usable[-fewest:].all():
            return None
        first = 0 if usable.all() else len(usable) - int(np.argmin(usable[::-1]))
        cubics = _cubics(rows[:, first:].T, float(log_a[1] - log_a[0]))
        return cls(float(np.exp(log_a[first or beyond])), log_a[first:], cubics)

    def holds(self, amplitude: float) -> bool:
        """Whether the amplitude lies within the table."""
        return self.lowest <= amplitude and log(amplitude) <= self.knots[-1]

    def at(self, log_a: Floats) -> tuple[Floats, Floats]:
        """Values (amplitudes, 2 + 2 k), and the derivatives of the first two with respect to ln A."""
        step = self.knots[1] - self.knots[0]
        k = np.clip(((log_a - self.knots[0]) / step).astype(np.int64), 0, self.cubics.shape[1] - 1)
        d = (log_a - self.knots[k])[:, None]
        c3, c2, c1, c0 = self.cubics[:, k]
        slope = (3 * c3[:, :2] * d + 2 * c2[:, :2]) * d + c1[:, :2]
        return ((c3 * d + c2) * d + c1) * d + c0, slope


def _cubics(rows: Floats, step: float) -> Floats:
    """Cubic spline (4, n - 1, columns) through n rows whose places rise by `step`, with not-a-knot ends."""
    slope = _slopes(len(rows)) @ rows / step
    rise = np.diff(rows, axis=0) / step
    low, high = slope[:-1], slope[1:]
    return np.array([(low + high - 2 * rise) / step**2, (3 * rise - 2 * low - high) / step, low, rows[:-1]])


@lru_cache(maxsize=32)
def _slopes(count: int) -> Floats:
    """Matrix of the slopes of a cubic spline through values one apart."""
    from scipy.interpolate import CubicSpline  # here, because it would slow down every command

    at: Floats = np.arange(count, dtype=np.float64)
    return np.asarray(CubicSpline(at, np.eye(count))(at, 1))


TableMaker = Callable[[Floats, float, float], SwingTable | None]
"""Function of a law: its table for the map's parameters without the first amplitude, from the highest to the
lowest amplitude or to the one at which the pendulum sticks; None where it sticks at once."""


def walk(
    table_from: Callable[[float], SwingTable | None], parameters: int, first: float, count: int
) -> OneHalfSwing:
    """The half-swings of a free decay, as many as wanted or until the pendulum stops.

    Parameters
    ----------
    table_from
        The table for amplitudes from the given one down; None where the pendulum sticks.
    parameters
        Number of the map's parameters, with the first amplitude.
    first
        The first amplitude.
    count
        Number of half-swings.
    """
    most = _MAX_GROWTH * first
    amplitudes = [first]
    rows: list[Floats] = []
    while len(amplitudes) <= count and 0 < amplitudes[-1] <= most:
        table = table_from(amplitudes[-1])
        begun = len(amplitudes) - 1
        if table is not None:
            _append(table, amplitudes, count, most)
        if table is None or len(amplitudes) == begun + 1:
            break
        values, slope = table.at(np.log(amplitudes[begun:-1]))
        rows.append(np.column_stack([slope, values]))
    own = parameters - 1
    walked = np.concatenate(rows) if rows else np.empty((0, 2 * own + 4))
    a = np.array(amplitudes[: len(walked)])
    nothing = np.zeros((len(a), 1))
    return OneHalfSwing(
        a,
        a * (1.0 - walked[:, 2]),
        1.0 - walked[:, 2] - walked[:, 0],
        np.concatenate([-a[:, None] * walked[:, 4 : 4 + own], nothing], axis=1),
        walked[:, 3],
        walked[:, 1] / a,
        np.concatenate([walked[:, 4 + own :], nothing], axis=1),
    )


def _fill(where: Flags, values: Floats) -> Floats:
    out = np.full((len(where), *values.shape[1:]), np.nan)
    out[where] = values
    return out


def _append(table: SwingTable, amplitudes: list[float], count: int, most: float) -> None:
    """Append amplitudes until the table or the wanted number ends, or one is larger than `most`."""
    cubics = table.cubics[:, :, 0].T.tolist()
    knots = table.knots.tolist()
    step, here, k = knots[1] - knots[0], amplitudes[-1], 0
    for _ in range(count + 1 - len(amplitudes)):
        if not table.lowest <= here <= most:
            break
        d = log(here) - knots[k]
        if not 0.0 <= d <= step:
            k = min(max(int((d + knots[k] - knots[0]) / step), 0), len(cubics) - 1)
            d = log(here) - knots[k]
        c3, c2, c1, c0 = cubics[k]
        here *= ((c3 * d + c2) * d + c1) * d + c0
        amplitudes.append(here)
