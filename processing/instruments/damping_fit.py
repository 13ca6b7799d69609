"""Damping between two amplitudes: time and number of swings (Koenig, Persoz, Kuznetsov).

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

Found = TypeVar("Found", bound=NamedTuple)

_SIMULATED_DECAYS = 100
"""Simulated decays; their scatter is known to 7 %."""
_MIN_DIFFERENCES = 12
"""Fewest third differences of amplitudes from which the drive is estimated."""


class SharedError(NamedTuple):
    """An error that the turning points of a run share, and that runs with the same `name` share.

    `scale` and `clock` are relative standard uncertainties of all amplitudes and of all times,
    `amplitude_rad` is added to the amplitudes by one standard uncertainty. An error without a name is the
    run's own.
    """

    name: str
    scale: float = 0.0
    clock: float = 0.0
    amplitude_rad: float | Floats = 0.0

    def shifted(self, points: TurningPoints, by: float) -> TurningPoints:
        """The points changed by `by` standard uncertainties of the error."""
        scale, clock = 1 + by * self.scale, 1 + by * self.clock
        return replace(
            points,
            amplitude=points.amplitude * scale + by * self.amplitude_rad,
            u_amplitude=points.u_amplitude * scale,
            time_s=points.time_s * clock,
            u_time_s=points.u_time_s * clock,
        )


@dataclass(frozen=True, slots=True)
class ValueWithSharedErrors:
    """A value with its own standard uncertainty, and its changes by shared errors.

    `shared` holds, by the error's name, the change of the value for one standard uncertainty, with its sign:
    it does not fall in a mean, and cancels in a ratio.
    """

    value: float
    own: float
    shared: Mapping[str, float] = field(default_factory=dict)

    @property
    def u_shared(self) -> float:
        return math.hypot(*self.shared.values())

    @property
    def estimate(self) -> Estimate:
        return Estimate(self.value, math.hypot(self.own, self.u_shared))


def with_shared(
    reduce: Callable[[TurningPoints], Found],
    points: TurningPoints,
    errors: Sequence[SharedError],
    found: Found | None = None,
) -> tuple[Found, dict[str, ValueWithSharedErrors]]:
    """Evaluate turning points and include errors that they share in every estimate.

    Such an error does not show in the scatter of a record. The evaluation is repeated with each of them at
    one standard uncertainty, and the change of each estimate is added in quadrature (JCGM 100, 5.1.3,
    note 2).

    Parameters
    ----------
    reduce
        The evaluation; it returns a named tuple, of which the fields of type `Estimate` (or None in all
        evaluations) are modified and the others kept.
    found
        The evaluation of the points as given, if its uncertainties are to be enlarged and not those that
        `reduce` states.

    Returns
    -------
    found, readings
        The evaluation with whole uncertainties, and its estimates with the shared parts apart, by field.

    Raises
    ------
    DataError
        Errors of `reduce` for the points as given. If it fails only for the moved ones, it is repeated with
        the opposite sign; if that fails too, the error is left out.
    """
    plain = reduce(points)
    found = plain if found is None else found
    shared: dict[str, dict[str, float]] = {
        name: {} for name, value in found._asdict().items() if isinstance(value, Estimate)
    }
    own: dict[str, list[float]] = {name: [getattr(found, name).standard_uncertainty] for name in shared}
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
        name: ValueWithSharedErrors(getattr(found, name).value, math.hypot(*own[name]), changes)
        for name, changes in shared.items()
    }
    return found._replace(**{name: one.estimate for name, one in readings.items()}), readings


def with_drive(reduce: Callable[[TurningPoints], Found], points: TurningPoints) -> Found:
    """Evaluate turning points with uncertainties that contain the scatter by a drive of the ground.

    A kick of the ground moves all later half-cycles: passages and periods far apart scatter by more than the
    measurement of their turning points. The decay is simulated `_SIMULATED_DECAYS` times with the drive that
    its own turning points show and with their measurement errors, and each time evaluated.

    Parameters
    ----------
    reduce
        As for `with_shared`. The fields of type `Estimate` get the scatter of the draws as uncertainty, the
        others are kept.

    Raises
    ------
    DataError
        Errors of `reduce` for the points as given.
    """
    found = reduce(points)
    step = drive_step(points)
    if step == 0:
        return found
    rng = np.random.default_rng(0)
    simulated = []
    for _ in range(_SIMULATED_DECAYS):
        try:
            simulated.append(reduce(_simulate(points, step, rng)))
        except DataError:
            continue
    if len(simulated) < 0.5 * _SIMULATED_DECAYS:
        return found
    columns = zip(*simulated, strict=True)
    return found._replace(
        **{
            name: Estimate(value.value, _scatter(column)) if isinstance(value, Estimate) else value
            for name, value, column in zip(found._fields, found, columns, strict=True)
        }
    )


def drive_step(points: TurningPoints) -> float:
    """Rms change of the amplitude in one half-swing by the ground; 0 where no drive is seen.

    A smooth decay leaves nothing in third differences of ln(amplitude): their variance is
    ``6 step^2/a^2 + 20 u^2/a^2``.
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
    inner = np.exp(np.convolve(np.log(amplitude), np.full(4, 0.25), "valid"))
    reading = np.convolve(u**2, [1.0, 9.0, 9.0, 1.0], "valid")
    return np.asarray(((third * inner) ** 2 - reading) / 6)


def _simulate(points: TurningPoints, step: float, rng: np.random.Generator) -> TurningPoints:
    """The same decay with another random drive and other measurement errors.

    A kick keeps its ratio to the amplitude, which is exact for linear damping, and shifts all later times.
    """
    amplitude = points.amplitude
    gap = np.sqrt(np.diff(points.index, prepend=points.index[0]))
    relative = step * gap / amplitude
    moved = np.exp(np.cumsum(relative * rng.standard_normal(len(points))))
    shift = np.cumsum(relative * rng.standard_normal(len(points))) * mean_period(points) / (2 * np.pi)
    return replace(
        points,
        amplitude=amplitude * moved + points.u_amplitude * rng.standard_normal(len(points)),
        time_s=points.time_s + shift + points.u_time_s * rng.standard_normal(len(points)),
    )


def _scatter(values: tuple[object, ...]) -> float:
    numbers = [value.value for value in values if isinstance(value, Estimate)]
    return float(np.std(numbers, ddof=1)) if len(numbers) > 1 else float("nan")


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


class DampingTime(NamedTuple):
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
    next one are used. If the record starts less than 3 % below the level, as after a release at the level
    itself, the decay of the first half-cycles is extrapolated back (the half-cycle is negative then).

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
    halves = float(points.index[last] - points.index[first])
    u_clock_s = math.hypot(points.u_time_s[first], points.u_time_s[last])
    return DampingTime(
        start_rad,
        end_rad,
        Estimate(end.time_s - begin.time_s, math.hypot(begin.u_time_s, end.u_time_s)),
        Estimate(
            0.5 * (end.half_cycle - begin.half_cycle), 0.5 * math.hypot(begin.u_half_cycle, end.u_half_cycle)
        ),
        Estimate(2 * float(points.time_s[last] - points.time_s[first]) / halves, 2 * u_clock_s / halves),
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
    """Mean over the places of a sample; `u_shared` is the part of its uncertainty that all places share."""

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    places: int
    spread: Annotated[float, PART]
    expanded_uncertainty_95: Annotated[float, PART]
    u_shared: Annotated[float, PART] = 0.0


def over_places(
    values: Sequence[ValueWithSharedErrors],
) -> tuple[ValueWithSharedErrors, MeanOverPlaces]:
    """Mean over places, to be compared, and what is reported of it.

    Its own uncertainty is the larger of that from the scatter and that from the stated ones; errors that the
    places share stay in the mean. The spread is the standard deviation between places, NaN for a single one.
    If the scatter is larger, the 95 % interval uses Student's t with the number of places minus one. Raises
    DataError if there is no value.
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
    mean = ValueWithSharedErrors(float(np.mean(value)), own, shared)
    expanded = math.hypot(factor * own, _NORMAL_95 * mean.u_shared)
    u = mean.estimate.standard_uncertainty
    return mean, MeanOverPlaces(mean.value, u, number, spread, expanded, mean.u_shared)
