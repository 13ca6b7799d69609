"""Damping between two amplitudes: time and number of swings (Koenig, Persoz, Kuznetsov).

The passage of the amplitude through a level is interpolated between the turning points before and after it:
the half-cycle linearly in ln(amplitude), the time linearly in the half-cycle.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments.descriptions import DEGREE_RAD
from processing.instruments.shared_uncertainty import Reading
from processing.swing import TurningPoints

_EXTENSION = 0.03
_SLOPE_POINTS = 10
_NORMAL_95 = 1.959964


class Passage(NamedTuple):
    """Passage of the amplitude through a level: half-cycle (fractional), time, and their covariance.

    `missing` is the number of missing half-cycles between the two turning points used.
    """

    half_cycle: float
    u_half_cycle: float
    time_s: float
    u_time_s: float
    missing: int


class Damping(NamedTuple):
    """Time and number of whole swings (to and fro) in which the amplitude falls from `start` to `end`.

    `swings` is interpolated and fractional; a counter would show the whole number below it. `period_s` is
    the mean period in this interval.
    """

    start_rad: float
    end_rad: float
    time_s: Estimate
    swings: Estimate
    period_s: Estimate
    missing: int


def passage(points: TurningPoints, level_rad: float) -> Passage:
    """Passage of the falling amplitude through `level_rad`.

    Noise may make the amplitude cross the level several times; the last turning point at or above it and the
    next one are used. If the record starts less than 3 % below the level, as after a release at
    the level itself, the decay of the first half-cycles is extrapolated back (the half-cycle is negative
    then).

    Raises
    ------
    DataError
        The amplitude begins below the level or never falls to it.
    """
    amplitude = points.amplitude
    if len(points) < 2:
        raise DataError(f"{len(points)} usable turning points; at least 2 are needed for a passage")
    level = level_rad / DEGREE_RAD
    above = np.nonzero(amplitude >= level_rad)[0]
    extended = not len(above) and amplitude[0] >= (1 - _EXTENSION) * level_rad
    if not len(above) and not extended:
        raise DataError(
            f"the amplitude starts at {amplitude[0] / DEGREE_RAD:.4g} degrees, below the {level:.4g} degrees "
            "wanted; release the pendulum farther out"
        )
    first = 0 if extended else int(above[-1])
    if first == len(amplitude) - 1:
        raise DataError(
            f"the amplitude never reaches {level:.4g} degrees, the record ends at "
            f"{amplitude[-1] / DEGREE_RAD:.4g} degrees; measure longer"
        )
    # an extrapolation needs a slope from more than two neighbours
    i, j = first, min(_SLOPE_POINTS, len(amplitude) - 1) if extended else first + 1
    steps = float(points.index[j] - points.index[i])
    fall = math.log(amplitude[i] / amplitude[j])
    share = math.log(amplitude[i] / level_rad) / fall
    u_i = points.u_amplitude[i] / amplitude[i]
    u_j = points.u_amplitude[j] / amplitude[j]
    u_share = math.hypot((1 - share) * u_i, share * u_j) / fall
    lasts_s = float(points.time_s[j] - points.time_s[i])
    u_clock_s = math.hypot((1 - share) * points.u_time_s[i], share * points.u_time_s[j])
    return Passage(
        half_cycle=float(points.index[i]) + share * steps,
        u_half_cycle=u_share * steps,
        time_s=float(points.time_s[i]) + share * lasts_s,
        u_time_s=math.hypot(u_share * lasts_s, u_clock_s),
        missing=0 if extended else int(steps) - 1,
    )


def damping(points: TurningPoints, start_rad: float, end_rad: float) -> Damping:
    """Time and number of swings from one amplitude to another; DataError if one is not passed."""
    if not end_rad < start_rad:
        raise DataError(
            f"end amplitude {end_rad / DEGREE_RAD:.4g} degrees must lie below the start, "
            f"{start_rad / DEGREE_RAD:.4g} degrees"
        )
    begin, end = passage(points, start_rad), passage(points, end_rad)
    between = np.nonzero((points.index >= begin.half_cycle - 1) & (points.index <= end.half_cycle + 1))[0]
    first, last = int(between[0]), int(between[-1])
    halves = float(points.index[last] - points.index[first])
    u_clock_s = math.hypot(points.u_time_s[first], points.u_time_s[last])
    return Damping(
        start_rad,
        end_rad,
        Estimate(end.time_s - begin.time_s, math.hypot(begin.u_time_s, end.u_time_s)),
        Estimate(
            0.5 * (end.half_cycle - begin.half_cycle), 0.5 * math.hypot(begin.u_half_cycle, end.u_half_cycle)
        ),
        Estimate(2 * float(points.time_s[last] - points.time_s[first]) / halves, 2 * u_clock_s / halves),
        begin.missing + end.missing,
    )


def ratio(measured: Reading, reference: Reading) -> Estimate:
    """Relative hardness: sample over reference. Errors that both share cancel as far as they act alike.

    Raises DataError for a reference of zero.
    """
    if not reference.value > 0:
        raise DataError(f"the reference is {reference.value:g}; it must be positive")
    value = measured.value / reference.value
    relative = [
        measured.shared.get(name, 0.0) / measured.value - reference.shared.get(name, 0.0) / reference.value
        for name in {*measured.shared, *reference.shared}
    ]
    own = (measured.own / measured.value, reference.own / reference.value)
    return Estimate(value, abs(value) * math.hypot(*own, *relative))


class Places(NamedTuple):
    """Values from several places of a sample: mean, standard deviation between them, 95 % interval."""

    number: int
    mean: Reading
    spread: float
    expanded_95: float


def over_places(values: Sequence[Reading]) -> Places:
    """Mean over places. Its own uncertainty is the larger of that from the scatter and that from the stated
    ones; what the places share is the mean's, too.

    The spread is the standard deviation between places, NaN for a single one. If the scatter is larger, the
    95 % interval uses Student's t with the number of places minus one. Raises DataError if there is no value.
    """
    from scipy.special import stdtrit

    if not values:
        raise DataError("no place was measured")
    number = len(values)
    value = np.array([item.value for item in values])
    own, factor = math.hypot(*(item.own for item in values)) / number, _NORMAL_95
    spread = float(np.std(value, ddof=1)) if number > 1 else math.nan
    if spread / math.sqrt(number) > own:
        own, factor = spread / math.sqrt(number), float(stdtrit(number - 1, 0.975))
    names = dict.fromkeys(name for item in values for name in item.shared)
    shared = {name: sum(item.shared.get(name, 0.0) for item in values) / number for name in names}
    mean = Reading(float(np.mean(value)), own, shared)
    return Places(number, mean, spread, math.hypot(factor * own, _NORMAL_95 * mean.u_shared))
