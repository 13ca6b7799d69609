"""Turning points outside the sensor, inferred from the speeds at which the spot crosses its rest position.

For the ideal pendulum, between the crossing before a turning point (time t_1, speed v_1) and the one after it
(t_2, v_2), with k = sin(A/2) and the half period h = t_2 - t_1,

    v = 2 w0 k,  h = 2 K(k)/w0    and therefore    k K(k) = v h/4.

v^2 is the mean of both squares, so that the losses by friction before and after the turning point cancel. No
property of the pendulum has to be known.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.decay_summary import full_periods
from processing.errors import DataError
from processing.estimate import Estimate
from processing.least_squares import FactoredJacobian
from processing.number_text import with_uncertainty
from processing.swing import HalfCycle, HalfCycleFlag, TurningPoints
from processing.units import nanoseconds, seconds

_REACH_HALF_PERIODS = 0.2
"""Time and speed of a crossing are fitted to samples within this fraction of the half period on either
side."""
_POWERS = 6
"""Number of powers, from 0 to 5: over the reach they leave 1.2e-7 of the amplitude of a sine."""
_MIN_SAMPLES = 8
"""Fewest samples of a crossing, and fewest turning points of a law of the period."""
_EARLY = 0.5 * (math.pi / 4 + 1 / math.pi), 0.5 * (math.pi / 4 - 1 / math.pi)
"""Friction shifts a turning point to a time before the middle of its two crossings, by ln(v_1/v_2)/w0 times
1/pi for a drag, 1/2 for constant friction, and pi/4 for friction proportional to the angle. The mean of
these values is used, with half their range as its uncertainty."""


class _Crossing(NamedTuple):
    """One crossing of the rest position; the speed is in rad/s, positive for rising deflection."""

    time_s: float
    u_time_s: float
    speed: float
    u_speed: float


def inferred_swings(times_ns: Ints, deflection_rad: Floats, u_deflection_rad: Floats) -> list[HalfCycle]:
    """Half-cycles with a turning point outside the sensor, flagged `HalfCycleFlag.INFERRED`.

    Parameters
    ----------
    times_ns, deflection_rad, u_deflection_rad
        (n,) samples; NaN where the spot was lost. The rest position must be on the sensor.

    Returns
    -------
    list of HalfCycle
        Indices count half periods from the first of them. Empty if the spot never left the sensor between two
        crossings. The rest position is the level whose crossings are equally spaced.
    """
    seen = np.isfinite(deflection_rad) & (u_deflection_rad > 0)
    if np.count_nonzero(seen) < 4 * _MIN_SAMPLES:
        return []
    start_ns = int(times_ns[0])
    time_s = seconds(times_ns[seen] - start_ns)
    values, u = deflection_rad[seen], u_deflection_rad[seen]
    spacing_s = float(np.median(np.diff(time_s)))
    level = 0.5 * float(np.min(values) + np.max(values))
    half_s = _half_period_s(time_s, values - level, spacing_s)
    if not half_s > 0:
        return []
    found = _crossings(time_s, values - level, u, half_s, spacing_s)
    if len(found) < 3:
        return []
    level += _rest(found, half_s)
    found = _crossings(time_s, values - level, u, half_s, spacing_s)
    swings: list[HalfCycle] = []
    for before, after in pairwise(found):
        between = time_s[(time_s >= before.time_s) & (time_s <= after.time_s)]
        lasts_s = after.time_s - before.time_s
        if before.speed * after.speed > 0 or not 0.6 < lasts_s / half_s < 1.5:
            continue
        if len(between) > 1 and float(np.max(np.diff(between))) < 3 * spacing_s:
            continue
        # the half period changes slowly with the amplitude: count from one crossing to the next
        index = 0
        if swings:
            gone_s = 0.5 * (before.time_s + after.time_s) - seconds(swings[-1].turn_time_ns - start_ns)
            index = swings[-1].index + max(1, round(gone_s / lasts_s))
        swings.append(_swing(index, before, after, level, start_ns))
    return swings


def joined_swings(seen: Sequence[HalfCycle], inferred: Sequence[HalfCycle]) -> list[HalfCycle]:
    """Merge the unflagged recorded half-cycles and the inferred ones, with common indices.

    If both exist for a half-cycle the inferred one is used, because the spot was outside the sensor.
    """
    if not inferred:
        return list(seen)
    claimed = np.array([swing.turn_time_ns for swing in inferred])
    half_ns = np.median(np.diff(claimed) / np.diff([s.index for s in inferred])) if len(inferred) > 1 else 0
    alone = [
        swing
        for swing in seen
        if not swing.flags and np.min(np.abs(claimed - swing.turn_time_ns)) > 0.5 * half_ns
    ]
    ordered = sorted([*alone, *inferred], key=lambda swing: swing.turn_time_ns)
    joined: list[HalfCycle] = []
    for swing in ordered:
        index = 0
        if joined:
            gone = (swing.turn_time_ns - joined[-1].turn_time_ns) / half_ns if half_ns else 1
            index = joined[-1].index + max(1, round(gone))
        joined.append(replace(swing, index=index))
    return joined


def _half_period_s(time_s: Floats, values: Floats, spacing_s: float) -> float:
    """Median interval between recorded changes of sign."""
    at = np.nonzero((values[1:] * values[:-1] <= 0) & (np.diff(time_s) < 3 * spacing_s))[0]
    interval = np.diff(time_s[at])
    # during a slow crossing noise changes the sign several times within a few samples
    interval = interval[interval > 6 * spacing_s]
    return float(np.median(interval)) if len(interval) else math.nan


def _crossings(time_s: Floats, values: Floats, u: Floats, half_s: float, spacing_s: float) -> list[_Crossing]:
    """Crossings of zero with their times and speeds (positive for rising deflection)."""
    at = np.nonzero((values[1:] * values[:-1] <= 0) & (np.diff(time_s) < 3 * spacing_s))[0]
    found: list[_Crossing] = []
    for i in at.tolist():
        if found and time_s[i] - found[-1].time_s < 0.4 * half_s:
            continue
        first, last = np.searchsorted(
            time_s, [time_s[i] - _REACH_HALF_PERIODS * half_s, time_s[i] + _REACH_HALF_PERIODS * half_s]
        )
        if last - first < _MIN_SAMPLES:
            continue
        scale_s = _REACH_HALF_PERIODS * half_s
        x = (time_s[first:last] - time_s[i]) / scale_s
        fit = FactoredJacobian(np.vander(x, _POWERS, increasing=True) / u[first:last, np.newaxis])
        solution = fit.coefficients(values[first:last] / u[first:last])
        slopes = np.polynomial.polynomial.polyder(solution)
        root = slope = 0.0
        for _ in range(20):
            value = float(np.polynomial.polynomial.polyval(root, solution))
            slope = float(np.polynomial.polynomial.polyval(root, slopes))
            root -= value / slope
        by_value = root ** np.arange(_POWERS)
        by_slope = np.arange(_POWERS) * root ** np.maximum(np.arange(_POWERS) - 1, 0)
        found.append(
            _Crossing(
                float(time_s[i]) + root * scale_s,
                float(np.linalg.norm(by_value @ fit.root)) / abs(slope) * scale_s,
                slope / scale_s,
                float(np.linalg.norm(by_slope @ fit.root)) / scale_s,
            )
        )
    return found


def _rest(found: list[_Crossing], half_s: float) -> float:
    """Rest position relative to the level of the crossings: the level at which the intervals are equal."""
    shifts = [
        0.25 * b.speed * (c.time_s - 2 * b.time_s + a.time_s)
        for a, b, c in zip(found, found[1:], found[2:], strict=False)
        if c.time_s - a.time_s < 3 * half_s
    ]
    return float(np.mean(shifts)) if shifts else 0.0


def _swing(index: int, before: _Crossing, after: _Crossing, centre: float, start_ns: int) -> HalfCycle:
    from scipy.optimize import brentq
    from scipy.special import ellipk

    lasts_s = after.time_s - before.time_s
    speed = math.sqrt(0.5 * (before.speed**2 + after.speed**2))
    u_speed = 0.5 * math.hypot(before.speed * before.u_speed, after.speed * after.u_speed) / speed
    u_clock_s = math.hypot(before.u_time_s, after.u_time_s)
    k = brentq(lambda k: k * ellipk(k * k) - 0.25 * speed * lasts_s, 0.0, 1 - 1e-12)
    amplitude = 2 * math.asin(k)
    relative = math.hypot(u_speed / speed, u_clock_s / lasts_s)
    brake_s = math.log(abs(before.speed / after.speed)) * lasts_s / math.pi
    turn_s = 0.5 * (before.time_s + after.time_s) - _EARLY[0] * brake_s
    return HalfCycle(
        index=index,
        turn_time_ns=start_ns + nanoseconds(turn_s),
        u_turn_time_s=math.hypot(0.5 * u_clock_s, _EARLY[1] * brake_s),
        amplitude=amplitude,
        u_amplitude=amplitude * relative,
        half_period_s=math.nan,
        u_half_period_s=math.nan,
        centre=centre,
        side=1 if before.speed > 0 else -1,
        flags=int(HalfCycleFlag.INFERRED),
    )


_LARGEST_CONDITION = 1e7
"""Condition number of the three columns above which only rounding distinguishes them."""
_LARGEST_U = 0.5
"""Standard uncertainty of the factor above which 1 cannot be distinguished from 0."""


class CircularError(NamedTuple):
    """Fit of the circular error, and the measured periods with those of the ideal pendulum of the same T0.

    `factor` is that on the ideal pendulum's excess T(A)/T0 - 1. `sentence` states whether it differs from 1
    by more than two standard uncertainties, where these are small enough. The arrays have one entry per full
    period: amplitude, period, its uncertainty, ideal period, and its approximation with alpha^2/16.
    """

    period0_s: Estimate
    factor: Estimate
    chi2_per_dof: float
    amplitude_rad: Floats
    period_s: Floats
    u_period_s: Floats
    law_s: Floats
    sixteenth_s: Floats

    @property
    def sentence(self) -> str:
        """Comparison of the factor with 1, in words."""
        f, u = self.factor
        if abs(f - 1) <= 2 * u and u > _LARGEST_U:
            return (
                "the swings are too small, or too few, to show the circular error: "
                f"{with_uncertainty(f, u)} times alpha^2/16"
            )
        if abs(f - 1) <= 2 * u:
            return f"the period follows the circular-error law: {with_uncertainty(f, u)} times alpha^2/16"
        faster = "faster" if f > 1 else "more slowly"
        return (
            f"the period falls with the amplitude {faster} than the circular-error law: "
            f"{with_uncertainty(f, u)} times alpha^2/16"
        )


def ideal_excess(amplitude_rad: ArrayLike) -> Floats:
    """T(A)/T0 - 1 of the ideal pendulum, exact: (2/pi) K(sin A/2) - 1; amplitudes of any shape."""
    from scipy.special import ellipkm1

    cosine = np.cos(0.5 * np.asarray(amplitude_rad, dtype=np.float64))
    excess: Floats = 2 / math.pi * ellipkm1(cosine**2) - 1
    return excess


def circular_error(points: TurningPoints) -> CircularError:
    """Fit T0 and the factor of the circular error to all turning times.

    Amplitudes of missing turning points are interpolated. Raises DataError for fewer than eight turning
    points, or if all amplitudes are equal.
    """
    if len(points) < _MIN_SAMPLES:
        raise DataError(
            f"{len(points)} usable turning points, at least {_MIN_SAMPLES} are needed for the law of "
            "the period"
        )
    index = np.arange(points.index[0], points.index[-1] + 1)
    amplitude = np.exp(np.interp(index, points.index, np.log(points.amplitude)))
    square = 0.5 * (amplitude[1:] ** 2 + amplitude[:-1] ** 2)
    summed = np.concatenate(([0.0], np.cumsum(ideal_excess(np.sqrt(square)))))
    where = points.index - points.index[0]
    design = np.column_stack([np.ones(len(where)), where.astype(np.float64), summed[where]])
    fit, time = FactoredJacobian(design / points.u_time_s[:, np.newaxis]), points.time_s / points.u_time_s
    if fit.condition > _LARGEST_CONDITION:
        raise DataError("the amplitudes are too much alike to tell how the period depends on them")
    residual = fit.left(time)
    chi2_per_dof = float(residual @ residual) / (len(points) - 3)
    covariance = fit.covariance() * max(1.0, chi2_per_dof)
    _, half_s, slope_s = fit.coefficients(time).tolist()
    by = np.array([0.0, -slope_s / half_s**2, 1 / half_s])
    factor = Estimate(slope_s / half_s, float(np.sqrt(by @ covariance @ by)))
    period0 = Estimate(2 * half_s, 2 * math.sqrt(covariance[1, 1]))
    periods = full_periods(points)
    at = points.amplitude[periods.points]
    return CircularError(
        period0,
        factor,
        chi2_per_dof,
        at,
        periods.period_s,
        periods.u_period_s,
        period0.value * (1 + ideal_excess(at)),
        period0.value * (1 + at**2 / 16),
    )
