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
"""Half periods on either side of a crossing, to whose samples its time and speed are fitted."""
_POWERS = 6
"""Number of powers, from 0 to 5: over the reach they leave 1.2e-7 of the amplitude of a sine."""
_MIN_SAMPLES = 8
"""Smallest number of samples of a crossing."""
_MIN_TURNING_POINTS = 8
"""Smallest number of turning points of a law of the period."""
_SHIFT, _U_SHIFT = 0.5 * (math.pi / 4 + 1 / math.pi), 0.5 * (math.pi / 4 - 1 / math.pi)
"""Friction shifts a turning point to a time before the middle of its two crossings, by ln(v_1/v_2)/w0 times
1/pi for a drag, 1/2 for constant friction, and pi/4 for friction proportional to the angle. The mean of
these values is used, with half their range as its uncertainty.
"""
_MAX_CONDITION = 1e7
"""Condition number of the three columns of a law of the period above which only rounding tells them apart."""
_MAX_U_FACTOR = 0.5
"""Standard uncertainty of the factor above which 1 cannot be distinguished from 0."""


class _Crossing(NamedTuple):
    """One crossing of the rest position."""

    time_s: float
    u_time_s: float
    speed: float
    """In rad/s, positive for rising deflection."""
    u_speed: float


def inferred_half_cycles(times_ns: Ints, deflection_rad: Floats, u_deflection_rad: Floats) -> list[HalfCycle]:
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
    has_spot = np.isfinite(deflection_rad) & (u_deflection_rad > 0)
    if np.count_nonzero(has_spot) < 4 * _MIN_SAMPLES:
        return []
    start_ns = int(times_ns[0])
    time_s = seconds(times_ns[has_spot] - start_ns)
    values, u = deflection_rad[has_spot], u_deflection_rad[has_spot]
    spacing_s = float(np.median(np.diff(time_s)))
    level = 0.5 * float(np.min(values) + np.max(values))
    interval_s = np.diff(time_s[_sign_changes(time_s, values - level, spacing_s)])
    # during a slow crossing noise changes the sign several times within a few samples
    interval_s = interval_s[interval_s > 6 * spacing_s]
    if not len(interval_s):
        return []
    half_s = float(np.median(interval_s))
    crossings = _crossings(time_s, values - level, u, half_s, spacing_s)
    if len(crossings) < 3:
        return []
    level += _rest(crossings, half_s)
    crossings = _crossings(time_s, values - level, u, half_s, spacing_s)
    half_cycles: list[HalfCycle] = []
    for first, second in pairwise(crossings):
        between = time_s[(time_s >= first.time_s) & (time_s <= second.time_s)]
        duration_s = second.time_s - first.time_s
        if first.speed * second.speed > 0 or not 0.6 < duration_s / half_s < 1.5:
            continue
        if len(between) > 1 and float(np.max(np.diff(between))) < 3 * spacing_s:
            continue
        # the half period changes slowly with the amplitude: count from one crossing to the next
        index = 0
        if half_cycles:
            last_s = seconds(half_cycles[-1].turn_time_ns - start_ns)
            half_periods = (0.5 * (first.time_s + second.time_s) - last_s) / duration_s
            index = half_cycles[-1].index + max(1, round(half_periods))
        half_cycles.append(_half_cycle(index, first, second, level, start_ns))
    return half_cycles


def joined_half_cycles(recorded: Sequence[HalfCycle], inferred: Sequence[HalfCycle]) -> list[HalfCycle]:
    """Merge the unflagged recorded half-cycles and the inferred ones, with common indices.

    If both exist for a half-cycle the inferred one is used, because the spot was outside the sensor.
    """
    if not inferred:
        return list(recorded)
    turns_ns = np.array([half_cycle.turn_time_ns for half_cycle in inferred])
    timed = inferred if len(inferred) > 1 else [one for one in recorded if not one.flags]
    places = np.array([(half_cycle.turn_time_ns, half_cycle.index) for half_cycle in timed]).reshape(-1, 2)
    steps_ns, steps = np.diff(places, axis=0).T
    half_ns = float(np.median(steps_ns / steps)) if len(steps) else 0.0
    only_recorded = [
        half_cycle
        for half_cycle in recorded
        if not half_cycle.flags and np.min(np.abs(turns_ns - half_cycle.turn_time_ns)) > 0.5 * half_ns
    ]
    joined: list[HalfCycle] = []
    for half_cycle in sorted([*only_recorded, *inferred], key=lambda half_cycle: half_cycle.turn_time_ns):
        index = 0
        if joined:
            half_periods = (half_cycle.turn_time_ns - joined[-1].turn_time_ns) / half_ns if half_ns else 1
            index = joined[-1].index + max(1, round(half_periods))
        joined.append(replace(half_cycle, index=index))
    return joined


def _sign_changes(time_s: Floats, values: Floats, spacing_s: float) -> Ints:
    """Indices of samples after which the sign changes, without a gap."""
    return np.flatnonzero((values[1:] * values[:-1] <= 0) & (np.diff(time_s) < 3 * spacing_s))


def _crossings(time_s: Floats, values: Floats, u: Floats, half_s: float, spacing_s: float) -> list[_Crossing]:
    """Crossings of zero."""
    crossings: list[_Crossing] = []
    scale_s = _REACH_HALF_PERIODS * half_s
    for i in _sign_changes(time_s, values, spacing_s).tolist():
        if crossings and time_s[i] - crossings[-1].time_s < 0.4 * half_s:
            continue
        first, last = np.searchsorted(time_s, [time_s[i] - scale_s, time_s[i] + scale_s])
        if last - first < _MIN_SAMPLES:
            continue
        x = (time_s[first:last] - time_s[i]) / scale_s
        fit = FactoredJacobian(np.vander(x, _POWERS, increasing=True) / u[first:last, np.newaxis])
        solution = fit.coefficients(values[first:last] / u[first:last])
        slopes = np.polynomial.polynomial.polyder(solution)
        root = slope = 0.0
        for _ in range(20):
            value = float(np.polynomial.polynomial.polyval(root, solution))
            slope = float(np.polynomial.polynomial.polyval(root, slopes))
            root -= value / slope
        value_row = root ** np.arange(_POWERS)
        slope_row = np.arange(_POWERS) * root ** np.maximum(np.arange(_POWERS) - 1, 0)
        crossings.append(
            _Crossing(
                float(time_s[i]) + root * scale_s,
                float(np.linalg.norm(value_row @ fit.root)) / abs(slope) * scale_s,
                slope / scale_s,
                float(np.linalg.norm(slope_row @ fit.root)) / scale_s,
            )
        )
    return crossings


def _rest(crossings: list[_Crossing], half_s: float) -> float:
    """Rest position relative to the level of the crossings: the level at which the intervals are equal."""
    shifts = [
        0.25 * b.speed * (c.time_s - 2 * b.time_s + a.time_s)
        for a, b, c in zip(crossings, crossings[1:], crossings[2:], strict=False)
        if c.time_s - a.time_s < 3 * half_s
    ]
    return float(np.mean(shifts)) if shifts else 0.0


def _half_cycle(index: int, first: _Crossing, second: _Crossing, centre: float, start_ns: int) -> HalfCycle:
    """The half-cycle whose turning point is between two crossings."""
    from scipy.optimize import brentq
    from scipy.special import ellipk

    duration_s = second.time_s - first.time_s
    speed = math.sqrt(0.5 * (first.speed**2 + second.speed**2))
    u_speed = 0.5 * math.hypot(first.speed * first.u_speed, second.speed * second.u_speed) / speed
    u_duration_s = math.hypot(first.u_time_s, second.u_time_s)
    k = brentq(lambda k: k * ellipk(k * k) - 0.25 * speed * duration_s, 0.0, 1 - 1e-12)
    amplitude = 2 * math.asin(k)
    friction_s = math.log(abs(first.speed / second.speed)) * duration_s / math.pi
    turn_s = 0.5 * (first.time_s + second.time_s) - _SHIFT * friction_s
    return HalfCycle(
        index=index,
        turn_time_ns=start_ns + nanoseconds(turn_s),
        u_turn_time_s=math.hypot(0.5 * u_duration_s, _U_SHIFT * friction_s),
        amplitude=amplitude,
        u_amplitude=amplitude * math.hypot(u_speed / speed, u_duration_s / duration_s),
        half_period_s=math.nan,
        u_half_period_s=math.nan,
        centre=centre,
        side=1 if first.speed > 0 else -1,
        flags=int(HalfCycleFlag.INFERRED),
    )


class CircularError(NamedTuple):
    """Fit of the circular error, and the measured periods with those of the ideal pendulum of the same T0.

    The arrays have one entry per full period.
    """

    period0_s: Estimate
    factor: Estimate
    """Factor on the ideal pendulum's excess T(A)/T0 - 1."""
    chi2_per_dof: float
    amplitude_rad: Floats
    period_s: Floats
    u_period_s: Floats
    ideal_s: Floats
    """Period of the ideal pendulum."""
    sixteenth_s: Floats
    """Its approximation with alpha^2/16."""

    @property
    def sentence(self) -> str:
        """Comparison of the factor with 1, within two standard uncertainties if these are small enough."""
        f, u = self.factor
        if abs(f - 1) <= 2 * u and u > _MAX_U_FACTOR:
            return (
                "the swings are too small, or too few, to show the circular error: "
                f"{with_uncertainty(f, u)} times alpha^2/16"
            )
        if abs(f - 1) <= 2 * u:
            return f"the period follows the circular-error law: {with_uncertainty(f, u)} times alpha^2/16"
        faster = "faster" if f > 1 else "more slowly"
        return (
            f"the period rises with the amplitude {faster} than the circular-error law: "
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
    if len(points) < _MIN_TURNING_POINTS:
        raise DataError(
            f"{len(points)} usable turning points, at least {_MIN_TURNING_POINTS} are needed for the law of "
            "the period"
        )
    index = np.arange(points.index[0], points.index[-1] + 1)
    amplitude = np.exp(np.interp(index, points.index, np.log(points.amplitude)))
    square = 0.5 * (amplitude[1:] ** 2 + amplitude[:-1] ** 2)
    total_excess = np.concatenate(([0.0], np.cumsum(ideal_excess(np.sqrt(square)))))
    number = points.index - points.index[0]
    design = np.column_stack([np.ones(len(number)), number.astype(np.float64), total_excess[number]])
    fit, time = FactoredJacobian(design / points.u_time_s[:, np.newaxis]), points.time_s / points.u_time_s
    if fit.condition > _MAX_CONDITION:
        raise DataError("the amplitudes are too much alike to tell how the period depends on them")
    residual = fit.residual(time)
    chi2_per_dof = float(residual @ residual) / (len(points) - 3)
    covariance = fit.covariance() * max(1.0, chi2_per_dof)
    _, half_s, slope_s = fit.coefficients(time).tolist()
    derivatives = np.array([0.0, -slope_s / half_s**2, 1 / half_s])
    factor = Estimate(slope_s / half_s, float(np.sqrt(derivatives @ covariance @ derivatives)))
    period0 = Estimate(2 * half_s, 2 * math.sqrt(covariance[1, 1]))
    periods = full_periods(points)
    amplitude_rad = points.amplitude[periods.points]
    return CircularError(
        period0,
        factor,
        chi2_per_dof,
        amplitude_rad,
        periods.period_s,
        periods.u_period_s,
        period0.value * (1 + ideal_excess(amplitude_rad)),
        period0.value * (1 + amplitude_rad**2 / 16),
    )
