"""Half-cycles of any law as a table over ln A, and free decays by iteration of that table.

A law gives for each amplitude the next amplitude and the duration of the half-cycle from it (the half-cycle
map), with their derivatives with respect to the map's parameters. A free decay goes through these half-cycles
from its first amplitude; where the ground moves the pendulum, the filter goes from any amplitude to the next.

Angles are in units of a reference amplitude, times in units of T0. The last of the map's parameters is the
first amplitude, on which no half-cycle depends (`Coordinates.map_parameters`).
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
"""Largest amplitude over the first one at which a decay is continued: an oscillation that grows by more is
none."""


class PredictedTurningPoints(NamedTuple):
    """Turning points (points,) that a law predicts; NaN after the pendulum has stopped."""

    amplitude: Floats
    """Amplitudes in units of the reference amplitude."""
    time: Floats
    """Times in units of T0."""
    amplitude_gradient: Floats
    time_gradient: Floats
    """Derivatives (points, parameters) of amplitudes and times."""


class HalfCycleLosses(NamedTuple):
    """Loss and duration of half-cycles from the falling amplitudes (n,) of a free decay."""

    amplitude: Floats
    loss: Floats
    """Amplitude minus the next one."""
    loss_slope: Floats
    """Derivative with respect to the amplitude."""
    loss_gradient: Floats
    """Derivatives (n, parameters) at fixed amplitude."""
    duration: Floats
    duration_slope: Floats
    duration_gradient: Floats

    def turning_points(self, first: float, numbers: Ints) -> PredictedTurningPoints:
        """Turning points of the decay, at rising half-cycle numbers of which the first is 0."""
        next_slope, count = 1.0 - self.loss_slope, self.loss_gradient.shape[1]
        product = np.concatenate([[1.0], np.cumprod(next_slope)])
        summed = np.cumsum(-self.loss_gradient / product[1:, None], axis=0)
        gradient = product[:, None] * np.concatenate([np.zeros((1, count)), summed])
        gradient[:, -1] = product
        duration_derivatives = self.duration_slope[:, None] * gradient[:-1] + self.duration_gradient
        time = np.concatenate([[0.0], np.cumsum(self.duration)])
        time_gradient = np.concatenate([np.zeros((1, count)), np.cumsum(duration_derivatives, axis=0)])
        last = self.amplitude[-1:] - self.loss[-1:] if len(self.amplitude) else np.array([first])
        is_reached = numbers <= len(self.amplitude)
        reached = numbers[is_reached]
        return PredictedTurningPoints(
            _fill(is_reached, np.concatenate([self.amplitude, last])[reached]),
            _fill(is_reached, time[reached]),
            _fill(is_reached, gradient[reached]),
            _fill(is_reached, time_gradient[reached]),
        )


class HalfCycleTable(NamedTuple):
    """Half-cycles from amplitudes between `lowest` and the highest knot, of a law with k parameters."""

    lowest: float
    knots: Floats
    """Values of ln A, which rise evenly."""
    cubics: Floats
    """Coefficients (4, knots - 1, 2 + 2 k), the highest power first, of cubic polynomials in ln A minus the
    lower knot. They give the next amplitude over A, the duration (T0), then the derivatives of each with
    respect to the parameters at fixed A."""

    @classmethod
    def of(cls, log_a: Floats, rows: Floats, min_finite: int, extra_low: int) -> "HalfCycleTable | None":
        """The table of rows (2 + 2 k, amplitudes) at evenly rising ln A.

        It begins above the highest amplitude without finite values, at which the pendulum sticks; it is None
        if fewer than `min_finite` amplitudes are above that one. If all are finite, the lowest `extra_low`
        amplitudes serve the interpolation, and are not part of the table's range.
        """
        usable = np.all(np.isfinite(rows), axis=0)
        if not usable[-min_finite:].all():
            return None
        first = 0 if usable.all() else len(usable) - int(np.argmin(usable[::-1]))
        cubics = _cubics(rows[:, first:].T, float(log_a[1] - log_a[0]))
        return cls(float(np.exp(log_a[first or extra_low])), log_a[first:], cubics)

    def holds(self, amplitude: float) -> bool:
        """Whether the amplitude lies within the table."""
        return self.lowest <= amplitude and log(amplitude) <= self.knots[-1]

    def interpolate(self, log_a: Floats) -> tuple[Floats, Floats]:
        """Values (amplitudes, 2 + 2 k), and the derivatives of the first two with respect to ln A."""
        step = self.knots[1] - self.knots[0]
        k = np.clip(((log_a - self.knots[0]) / step).astype(np.int64), 0, self.cubics.shape[1] - 1)
        d = (log_a - self.knots[k])[:, None]
        c3, c2, c1, c0 = self.cubics[:, k]
        slope = (3 * c3[:, :2] * d + 2 * c2[:, :2]) * d + c1[:, :2]
        return ((c3 * d + c2) * d + c1) * d + c0, slope


def _cubics(rows: Floats, step: float) -> Floats:
    """Cubic spline (4, n - 1, columns) through n rows at distances `step`, with not-a-knot ends."""
    slope = _slopes(len(rows)) @ rows / step
    rise = np.diff(rows, axis=0) / step
    low, high = slope[:-1], slope[1:]
    return np.array([(low + high - 2 * rise) / step**2, (3 * rise - 2 * low - high) / step, low, rows[:-1]])


@lru_cache(maxsize=32)
def _slopes(count: int) -> Floats:
    """Matrix of the slopes of a cubic spline through values at distances of 1."""
    from scipy.interpolate import CubicSpline  # here, because it would slow down every command

    x: Floats = np.arange(count, dtype=np.float64)
    return np.asarray(CubicSpline(x, np.eye(count))(x, 1))


TableMaker = Callable[[Floats, float, float], HalfCycleTable | None]
"""Function (parameters, highest, lowest) of a law that makes its table between two amplitudes, or down to the
one at which the pendulum sticks; None if it sticks at once. The map's parameters lack the first amplitude."""


def iterate_decay(
    table_from: Callable[[float], HalfCycleTable | None], parameters: int, first: float, count: int
) -> HalfCycleLosses:
    """The half-cycles of a free decay, `count` or until the pendulum stops.

    Parameters
    ----------
    table_from
        The table for amplitudes from the given one down; None where the pendulum sticks.
    parameters
        Number of the map's parameters, with the first amplitude.
    first
        The first amplitude.
    """
    max_amplitude = _MAX_GROWTH * first
    amplitudes = [first]
    rows: list[Floats] = []
    while len(amplitudes) <= count and 0 < amplitudes[-1] <= max_amplitude:
        table = table_from(amplitudes[-1])
        begin = len(amplitudes) - 1
        if table is not None:
            _append(table, amplitudes, count, max_amplitude)
        if table is None or len(amplitudes) == begin + 1:
            break
        values, slope = table.interpolate(np.log(amplitudes[begin:-1]))
        rows.append(np.column_stack([slope, values]))
    law_parameters = parameters - 1
    table_rows = np.concatenate(rows) if rows else np.empty((0, 2 * law_parameters + 4))
    ratio_slope, duration_slope, ratio, duration = table_rows[:, :4].T
    a = np.array(amplitudes[: len(table_rows)])
    zero = np.zeros((len(a), 1))
    return HalfCycleLosses(
        a,
        a * (1.0 - ratio),
        1.0 - ratio - ratio_slope,
        np.concatenate([-a[:, None] * table_rows[:, 4 : 4 + law_parameters], zero], axis=1),
        duration,
        duration_slope / a,
        np.concatenate([table_rows[:, 4 + law_parameters :], zero], axis=1),
    )


def _fill(where: Flags, values: Floats) -> Floats:
    out = np.full((len(where), *values.shape[1:]), np.nan)
    out[where] = values
    return out


def _append(table: HalfCycleTable, amplitudes: list[float], count: int, max_amplitude: float) -> None:
    """Append amplitudes until the table or the decay ends, or one is larger than `max_amplitude`."""
    cubics = table.cubics[:, :, 0].T.tolist()
    knots = table.knots.tolist()
    step, amplitude, k = knots[1] - knots[0], amplitudes[-1], 0
    for _ in range(count + 1 - len(amplitudes)):
        if not table.lowest <= amplitude <= max_amplitude:
            break
        d = log(amplitude) - knots[k]
        if not 0.0 <= d <= step:
            k = min(max(int((d + knots[k] - knots[0]) / step), 0), len(cubics) - 1)
            d = log(amplitude) - knots[k]
        c3, c2, c1, c0 = cubics[k]
        amplitude *= ((c3 * d + c2) * d + c1) * d + c0
        amplitudes.append(amplitude)
