"""Damping between two amplitudes: time and number of full swings (Koenig, Persoz, Kuznetsov).

The passage of the amplitude through a level is interpolated between the turning points before and after it:
the half-cycle linearly in ln(amplitude), the time linearly in the half-cycle.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple, TypeVar

import numpy as np

from processing.arrays import Floats, Ints
from processing.decay_summary import mean_period
from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments.descriptions import DEGREE_RAD
from processing.quantity import PART
from processing.swing import TurningPoints

Result = TypeVar("Result", bound=NamedTuple)

_SIMULATED_DECAYS = 100
"""Number of simulated decays; their scatter is known to 7 %."""
_MIN_DIFFERENCES = 12
"""Smallest number of third differences of amplitudes from which the drive is estimated."""
_MAX_EXTRAPOLATION = 0.03
"""Largest relative distance of a level from a smaller first amplitude to which the decay is extrapolated."""
_SLOPE_POINTS = 10
"""Number of half-cycles from which the slope of an extrapolation follows."""
_NORMAL_95 = 1.959964


class SharedError(NamedTuple):
    """An error that the turning points of a run share, and that runs with the same `name` share."""

    name: str
    """Empty for an error of this run alone."""
    scale: float = 0.0
    """Relative standard uncertainty of all amplitudes."""
    clock: float = 0.0
    """Relative standard uncertainty of all times."""
    amplitude_rad: float | Floats = 0.0
    """Change of the amplitudes by one standard uncertainty."""

    def shifted(self, points: TurningPoints, sigmas: float) -> TurningPoints:
        """The points changed by `sigmas` standard uncertainties of the error."""
        scale, clock = 1 + sigmas * self.scale, 1 + sigmas * self.clock
        return replace(
            points,
            amplitude=points.amplitude * scale + sigmas * self.amplitude_rad,
            u_amplitude=points.u_amplitude * scale,
            time_s=points.time_s * clock,
            u_time_s=points.u_time_s * clock,
        )


@dataclass(frozen=True, slots=True)
class ValueWithSharedErrors:
    """A value with its own standard uncertainty, and its changes by shared errors."""

    value: float
    own: float
    """Standard uncertainty by independent errors."""
    shared: Mapping[str, float] = field(default_factory=dict)
    """Change of the value, with its sign, for one standard uncertainty of each error, by the error's name: it
    does not fall in a mean, and cancels in a ratio.
    """

    @property
    def u_shared(self) -> float:
        """Standard uncertainty by the shared errors."""
        return math.hypot(*self.shared.values())

    @property
    def estimate(self) -> Estimate:
        """The value with its whole standard uncertainty."""
        return Estimate(self.value, math.hypot(self.own, self.u_shared))


def with_shared(
    reduce: Callable[[TurningPoints], Result],
    points: TurningPoints,
    errors: Sequence[SharedError],
    result: Result | None = None,
) -> tuple[Result, dict[str, ValueWithSharedErrors]]:
    """Evaluate turning points and include errors that they share in every estimate.

    Such an error does not show in the scatter of a record. The evaluation is repeated with each of them at
    one standard uncertainty, and the change of each estimate is added in quadrature (JCGM 100, 5.1.3,
    note 2).

    Parameters
    ----------
    reduce
        The evaluation; it returns a named tuple, of which the fields of type `Estimate` (or None in all
        evaluations) are modified, the others not.
    result
        The evaluation of the points as given, if its uncertainties are to be enlarged and not those that
        `reduce` states.

    Returns
    -------
    result, readings
        The evaluation with whole uncertainties, and its estimates with their shared errors, by field.

    Raises
    ------
    DataError
        Errors of `reduce` for the points as given. If it fails only for the shifted ones, it is repeated with
        the opposite sign; if that fails too, the error is left out.
    """
    plain = reduce(points)
    result = plain if result is None else result
    shared: dict[str, dict[str, float]] = {
        name: {} for name, value in result._asdict().items() if isinstance(value, Estimate)
    }
    own: dict[str, list[float]] = {name: [getattr(result, name).standard_uncertainty] for name in shared}
    for error in errors:
        for sign in (1.0, -1.0):
            try:
                shifted = reduce(error.shifted(points, sign))
            except DataError:
                continue
            for name, changes in shared.items():
                before, after = getattr(plain, name), getattr(shifted, name)
                if isinstance(before, Estimate) and isinstance(after, Estimate):
                    change = sign * (after.value - before.value)
                    if error.name:
                        changes[error.name] = change
                    else:
                        own[name].append(change)
            break
    readings = {
        name: ValueWithSharedErrors(getattr(result, name).value, math.hypot(*own[name]), changes)
        for name, changes in shared.items()
    }
    return result._replace(**{name: reading.estimate for name, reading in readings.items()}), readings


def with_drive(reduce: Callable[[TurningPoints], Result], points: TurningPoints) -> Result:
    """Evaluate turning points with uncertainties that contain the scatter by a drive of the ground.

    A kick of the ground moves all later half-cycles: passages and periods far apart scatter by more than the
    measurement of their turning points. The decay is simulated `_SIMULATED_DECAYS` times with the drive that
    its own turning points show and with their measurement errors, and each time evaluated.

    Parameters
    ----------
    reduce
        As for `with_shared`. The fields of type `Estimate` get the scatter of the simulated decays as
        uncertainty, the others are not changed.

    Raises
    ------
    DataError
        Errors of `reduce` for the points as given.
    """
    result = reduce(points)
    step = drive_step(points)
    if step == 0:
        return result
    rng = np.random.default_rng(0)
    simulated = []
    for _ in range(_SIMULATED_DECAYS):
        try:
            simulated.append(reduce(_simulate(points, step, rng)))
        except DataError:
            continue
    if len(simulated) < 0.5 * _SIMULATED_DECAYS:
        return result
    columns = zip(*simulated, strict=True)
    return result._replace(
        **{
            name: Estimate(value.value, _scatter(column)) if isinstance(value, Estimate) else value
            for name, value, column in zip(result._fields, result, columns, strict=True)
        }
    )


def drive_step(points: TurningPoints) -> float:
    """Rms change of the amplitude in one half-cycle by the ground; 0 if no drive is significant.

    A smooth decay has no third differences of ln(amplitude): their variance is ``6 step^2/a^2 + 20 u^2/a^2``.
    """
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(points.index) != 1) + 1)
    excess = np.concatenate([_excess(points, run) for run in runs])
    if len(excess) < _MIN_DIFFERENCES:
        return 0.0
    mean = float(np.mean(excess))
    # third differences share half-cycles: only one in four is independent
    u = float(np.std(excess)) * 2 / np.sqrt(len(excess))
    return float(np.sqrt(mean)) if mean > u else 0.0


def _excess(points: TurningPoints, run: Ints) -> Floats:
    if len(run) < 4:
        return np.empty(0)
    amplitude, u = points.amplitude[run], points.u_amplitude[run]
    third = np.diff(np.log(amplitude), 3)
    mean_amplitude = np.exp(np.convolve(np.log(amplitude), np.full(4, 0.25), "valid"))
    noise = np.convolve(u**2, [1.0, 9.0, 9.0, 1.0], "valid")
    return np.asarray(((third * mean_amplitude) ** 2 - noise) / 6)


def _simulate(points: TurningPoints, step: float, rng: np.random.Generator) -> TurningPoints:
    """The same decay with another random drive and other measurement errors. A kick keeps its ratio to the
    amplitude, which is exact for linear damping, and shifts all later times."""
    amplitude = points.amplitude
    relative = step * np.sqrt(np.diff(points.index, prepend=points.index[0])) / amplitude
    factor = np.exp(np.cumsum(relative * rng.standard_normal(len(points))))
    shift_s = np.cumsum(relative * rng.standard_normal(len(points))) * mean_period(points) / (2 * np.pi)
    return replace(
        points,
        amplitude=amplitude * factor + points.u_amplitude * rng.standard_normal(len(points)),
        time_s=points.time_s + shift_s + points.u_time_s * rng.standard_normal(len(points)),
    )


def _scatter(values: tuple[object, ...]) -> float:
    numbers = [value.value for value in values if isinstance(value, Estimate)]
    return float(np.std(numbers, ddof=1)) if len(numbers) > 1 else float("nan")


class Passage(NamedTuple):
    """Passage of the amplitude through a level."""

    half_cycle: float
    """Half-cycle number, fractional."""
    u_half_cycle: float
    time_s: float
    u_time_s: float
    missing: int
    """Number of missing half-cycles between the two turning points used."""


class DampingTime(NamedTuple):
    """Time and number of full swings (to and fro) in which the amplitude falls from `start` to `end`."""

    start_rad: float
    end_rad: float
    time_s: Estimate
    swings: Estimate
    """Interpolated and fractional; a counter would show the whole number below it."""
    period_s: Estimate
    """Mean period in this interval."""
    missing: int
    """Number of missing half-cycles at both passages."""


def passage(points: TurningPoints, level_rad: float) -> Passage:
    """Passage of the falling amplitude through `level_rad`.

    Noise may make the amplitude cross the level several times; the last turning point at or above it and the
    next one are used. If the record starts a little below the level (`_MAX_EXTRAPOLATION`), as after a
    release at the level itself, the first half-cycles are extrapolated back (the half-cycle is negative).

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
    is_extrapolated = not len(above) and amplitude[0] >= (1 - _MAX_EXTRAPOLATION) * level_rad
    if not len(above) and not is_extrapolated:
        raise DataError(
            f"the amplitude starts at {amplitude[0] / DEGREE_RAD:.4g} degrees, below the {level:.4g} degrees "
            "wanted; release the pendulum farther out"
        )
    i = 0 if is_extrapolated else int(above[-1])
    if i == len(amplitude) - 1:
        raise DataError(
            f"the amplitude never reaches {level:.4g} degrees, the record ends at "
            f"{amplitude[-1] / DEGREE_RAD:.4g} degrees; measure longer"
        )
    # an extrapolation needs a slope from more than two neighbours
    j = min(_SLOPE_POINTS, len(amplitude) - 1) if is_extrapolated else i + 1
    steps = float(points.index[j] - points.index[i])
    fall = math.log(amplitude[i] / amplitude[j])
    fraction = math.log(amplitude[i] / level_rad) / fall
    u_i = points.u_amplitude[i] / amplitude[i]
    u_j = points.u_amplitude[j] / amplitude[j]
    u_fraction = math.hypot((1 - fraction) * u_i, fraction * u_j) / fall
    duration_s = float(points.time_s[j] - points.time_s[i])
    u_measured_s = math.hypot((1 - fraction) * points.u_time_s[i], fraction * points.u_time_s[j])
    return Passage(
        half_cycle=float(points.index[i]) + fraction * steps,
        u_half_cycle=u_fraction * steps,
        time_s=float(points.time_s[i]) + fraction * duration_s,
        u_time_s=math.hypot(u_fraction * duration_s, u_measured_s),
        missing=0 if is_extrapolated else int(steps) - 1,
    )


def damping(points: TurningPoints, start_rad: float, end_rad: float) -> DampingTime:
    """Time and number of swings from one amplitude to another; DataError if one is not passed."""
    if not end_rad < start_rad:
        raise DataError(
            f"end amplitude {end_rad / DEGREE_RAD:.4g} degrees must lie below the start, "
            f"{start_rad / DEGREE_RAD:.4g} degrees"
        )
    begin, end = passage(points, start_rad), passage(points, end_rad)
    between = np.nonzero((points.index >= begin.half_cycle - 1) & (points.index <= end.half_cycle + 1))[0]
    first, last = int(between[0]), int(between[-1])
    half_cycles = float(points.index[last] - points.index[first])
    duration_s = float(points.time_s[last] - points.time_s[first])
    u_duration_s = math.hypot(points.u_time_s[first], points.u_time_s[last])
    return DampingTime(
        start_rad,
        end_rad,
        Estimate(end.time_s - begin.time_s, math.hypot(begin.u_time_s, end.u_time_s)),
        Estimate(
            0.5 * (end.half_cycle - begin.half_cycle), 0.5 * math.hypot(begin.u_half_cycle, end.u_half_cycle)
        ),
        Estimate(2 * duration_s / half_cycles, 2 * u_duration_s / half_cycles),
        begin.missing + end.missing,
    )


def ratio(measured: ValueWithSharedErrors, reference: ValueWithSharedErrors) -> Estimate:
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


@dataclass(frozen=True, slots=True)
class MeanOverPlaces:
    """Mean over the places of a sample."""

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    places: int
    spread: Annotated[float, PART]
    """Standard deviation between places; NaN for a single one."""
    expanded_uncertainty_95: Annotated[float, PART]
    u_shared: Annotated[float, PART] = 0.0
    """Part of the standard uncertainty that all places share."""


def over_places(
    values: Sequence[ValueWithSharedErrors],
) -> tuple[ValueWithSharedErrors, MeanOverPlaces]:
    """Mean over places for a comparison, and for the report.

    Its own uncertainty is the larger of that from the scatter and that from the stated ones; errors that the
    places share stay in the mean. If the scatter is larger, the 95 % interval uses Student's t with the
    number of places minus one. Raises DataError if there is no value.
    """
    from scipy.special import stdtrit

    if not values:
        raise DataError("no place was measured")
    count = len(values)
    numbers = np.array([value.value for value in values])
    own, factor = math.hypot(*(value.own for value in values)) / count, _NORMAL_95
    spread = float(np.std(numbers, ddof=1)) if count > 1 else math.nan
    if spread / math.sqrt(count) > own:
        own, factor = spread / math.sqrt(count), float(stdtrit(count - 1, 0.975))
    names = dict.fromkeys(name for value in values for name in value.shared)
    shared = {name: sum(value.shared.get(name, 0.0) for value in values) / count for name in names}
    mean = ValueWithSharedErrors(float(np.mean(numbers)), own, shared)
    expanded = math.hypot(factor * own, _NORMAL_95 * mean.u_shared)
    u = mean.estimate.standard_uncertainty
    return mean, MeanOverPlaces(mean.value, u, count, spread, expanded, mean.u_shared)
