"""Uncertainties of quantities that are evaluated from turning points, whatever law they decay by.

Those of scale and clock, which all turning points of a record share, and of a ground that moves.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from processing.arrays import Floats, Ints
from processing.decay_summary import mean_period
from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints

Found = TypeVar("Found", bound=NamedTuple)

_DRAWS = 100
"""They know a standard uncertainty to 7 %."""
_FEWEST = 12
"""Turning points in a row from which the drive is estimated."""


class SharedError(NamedTuple):
    """An error that the turning points of a run share; so do runs that name the same one.

    `scale` and `clock` are relative standard uncertainties of all amplitudes and of all times,
    `amplitude_rad` is what one standard uncertainty adds to the amplitudes. One without a name is the run's
    own.
    """

    name: str
    scale: float = 0.0
    clock: float = 0.0
    amplitude_rad: float | Floats = 0.0

    def moved(self, points: TurningPoints, by: float) -> TurningPoints:
        """The points with so many standard uncertainties of the error."""
        scale, clock = 1 + by * self.scale, 1 + by * self.clock
        return replace(
            points,
            amplitude=points.amplitude * scale + by * self.amplitude_rad,
            u_amplitude=points.u_amplitude * scale,
            time_s=points.time_s * clock,
            u_time_s=points.u_time_s * clock,
        )


@dataclass(frozen=True, slots=True)
class Reading:
    """A value with the standard uncertainty of its own, and by shared errors, by name.

    `shared` holds the change of the value for one standard uncertainty of each error, with its sign: in a
    mean it does not fall, in a ratio it cancels.
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
) -> tuple[Found, dict[str, Reading]]:
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
        The evaluation with whole uncertainties, and its estimates with the parts apart, by field.

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
                shifted = reduce(error.moved(points, sign))
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
        name: Reading(getattr(found, name).value, math.hypot(*own[name]), changes)
        for name, changes in shared.items()
    }
    return found._replace(**{name: one.estimate for name, one in readings.items()}), readings


def with_drive(reduce: Callable[[TurningPoints], Found], points: TurningPoints) -> Found:
    """Evaluate turning points; where the ground drives the pendulum, its scatter is in every uncertainty.

    What the ground does to a swing stays in all later ones: passages and periods far apart scatter by more
    than the reading of their turning points. The same decay is drawn again and again with the drive that its
    own turning points show and with their reading errors, and evaluated.

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
    drawn = []
    for _ in range(_DRAWS):
        try:
            drawn.append(reduce(_drawn(points, step, rng)))
        except DataError:
            continue
    if len(drawn) < 0.5 * _DRAWS:
        return found
    columns = zip(*drawn, strict=True)
    return found._replace(
        **{
            name: Estimate(value.value, _scatter(column)) if isinstance(value, Estimate) else value
            for name, value, column in zip(found._fields, found, columns, strict=True)
        }
    )


def drive_step(points: TurningPoints) -> float:
    """By how much (rms) the ground moves the amplitude in one half-swing; 0 where none is seen.

    Third differences of ln(amplitude) hold nothing of a smooth decay: their variance is
    ``6 step^2/a^2 + 20 u^2/a^2``.
    """
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(points.index) != 1) + 1)
    excess = np.concatenate([_excess(points, run) for run in runs])
    if len(excess) < _FEWEST:
        return 0.0
    mean = float(np.mean(excess))
    # third differences share half-cycles: one in four stands for itself
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


def _drawn(points: TurningPoints, step: float, rng: np.random.Generator) -> TurningPoints:
    """The same decay, driven and read again.

    A kick keeps its share of the amplitude, which is exact for linear damping, and shifts all later times.
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
