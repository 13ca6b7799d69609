"""The coordinates (columns) in which the solver fits a law, and their conversion to its parameters."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues, start_values
from processing.contact.law import (
    AMPLITUDE,
    DRAG,
    PERIOD,
    TIME,
    HeldColumn,
    Parameter,
    PendulumOnBall,
    relative_curvature,
)
from processing.decay_summary import reference_amplitude
from processing.swing import TurningPoints

ComplexOrReal = NDArray[Any]

_LIMIT_DISTANCE = 1e-4
"""Distance from a limit below which a value is reported as being at it."""
_MAX_COLUMN = 1e100
"""Largest column for which parameters are computed; beyond it, where products overflow, they are NaN."""
_DECAY_RATE_FACTORS = (1.0, 0.9, 0.7, 0.4)
"""Rates of decay tried, over those of a start."""


class Scaling(NamedTuple):
    """The unit in which a parameter is fitted.

    ``value = scaled * reference^(power + per_exponent * exponent) / unit``; `exponent` is the key of another
    parameter, `unit` a function of the pendulum. `loses` is whether a decay is slower where the value is
    smaller.
    """

    power: float = 0.0
    per_exponent: float = 0.0
    exponent: str = ""
    unit: Callable[[PendulumOnBall], float] | None = None
    loses: bool = True


def scaled_values(
    scalings: Mapping[str, Scaling],
    values: Mapping[str, float],
    pendulum: PendulumOnBall,
    reference: float,
) -> dict[str, float]:
    """SI values in the units of a fit, by key."""
    found = {}
    for key, scaling in scalings.items():
        power = scaling.power
        if scaling.exponent:
            power += scaling.per_exponent * values[scaling.exponent]
        unit = 1.0 if scaling.unit is None else scaling.unit(pendulum)
        found[key] = values[key] * unit * reference**-power
    return found


class ValleyCoordinates(NamedTuple):
    """Coordinates of the search in which the valley of chi2 is straight.

    Both functions take and return one number for each of the law's own parameters, the drag (0 if it is not
    fitted) and the period: `scaled` the scaled values of coordinates, which may be complex (derivatives are
    taken so) and have further axes, and `coordinates` the inverse. `held` gives for each own parameter the
    coordinate that moves it most, `limits` the range of coordinates by place, as a function of the measured
    relative loss in a half-swing. `valley` is the coordinate along which friction and drag replace each
    other. `at_limit` gives, from scaled values, the places of parameters at limits that no coordinate has.
    """

    scaled: Callable[[ComplexOrReal], ComplexOrReal]
    coordinates: Callable[[Floats], Floats]
    held: tuple[HeldColumn, ...] = ()
    limits: Callable[[float], Mapping[int, tuple[float, float]]] = lambda _: MappingProxyType({})
    valley: int | None = None
    at_limit: Callable[[Floats], Sequence[int]] = lambda _: ()


def logarithms_of(*places: int) -> ValleyCoordinates:
    """Coordinates that are the scaled values, but their logarithms at `places`, which stay positive."""

    def scaled(values: ComplexOrReal) -> ComplexOrReal:
        out = values.copy()
        out[list(places)] = np.exp(values[list(places)])
        return out

    def coordinates(values: Floats) -> Floats:
        out = values.copy()
        out[list(places)] = np.log(np.maximum(values[list(places)], 1e-12))
        return out

    return ValleyCoordinates(scaled, coordinates)


class Coordinates:
    """Coordinates in which the solver fits a law to one decay, and their conversion to parameters.

    The solver varies columns, chosen so that the valleys of chi2 are straight: `others` of the fit, which
    start at these values and are none of the law's, coordinates of the law's own parameters
    (`ValleyCoordinates`), of a fitted drag, the first amplitude, the coordinate of T0, the first time. They
    determine the parameters of the half-swing map (dimensionless: angles in units of `reference`, the
    geometric mean amplitude, times in units of T0) and the physical values in SI units.

    `propose_starts` proposes scaled start values, from those of a decay of the paper's form and the reference
    amplitude.

    Attributes
    ----------
    lower, upper
        Bounds of the columns.
    map_by_log_rho
        Derivative of the map's parameters with respect to ln(R/a), which a fit takes as known.
    valley
        Column along which friction and drag replace each other without a change of the turning points; None
        where there is none, or where it is not known.
    """

    def __init__(
        self,
        points: TurningPoints,
        pendulum: PendulumOnBall,
        names: tuple[str, ...],
        others: Sequence[float] = (),
        *,
        parameters: Sequence[Parameter],
        scalings: Mapping[str, Scaling],
        valley_coordinates: Callable[[bool], ValleyCoordinates],
        propose_starts: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
    ) -> None:
        self.reference = reference_amplitude(points)
        self._names = names
        self._pendulum = pendulum
        self._parameters = [p for p in parameters if p.key not in (PERIOD, DRAG.key)]
        self._own = tuple(parameter.key for parameter in self._parameters)
        self._scalings = scalings
        self._drag = DRAG.key in names
        self._found: dict[bytes, tuple[Floats, Floats]] = {}
        self._valley_coordinates, self._propose_starts = valley_coordinates(self._drag), propose_starts
        self._others = tuple(others)
        first = len(self._others)
        valley = self._valley_coordinates.valley
        self.valley = None if valley is None else first + valley
        self._rho = relative_curvature(pendulum) * self.reference
        count = len(self._own)
        self.map_by_log_rho = np.zeros(count + 4)
        self.map_by_log_rho[-2] = self._rho
        # columns of own parameters, drag, and T0, and their places among the coordinates
        fitted = range(count + self._drag)
        self._searched = [first + column for column in (*fitted, count + self._drag + 1)]
        self._places = [*fitted, count + 1]
        self.upper = np.full(first + count + self._drag + 3, np.inf)
        self.lower = -self.upper
        halves = points.index[-1] - points.index[0]
        loss = abs(float(np.log(points.amplitude[0] / points.amplitude[-1]) / halves))
        for place, (low, high) in self._valley_coordinates.limits(loss).items():
            self.lower[first + place], self.upper[first + place] = low, high
        self.lower[-3], self.lower[-2] = 1e-3, 1e-6

    def _scaled(self, columns: Floats) -> tuple[Floats, Floats]:
        """Scaled own parameters, drag, first amplitude, T0 and first time, and their derivatives."""
        key = columns.tobytes()
        if key not in self._found:
            self._found.clear()  # the last columns stay: a search of the noise needs them a hundred times
            self._found[key] = self._derivatives(columns)
        return self._found[key]

    def _derivatives(self, columns: Floats) -> tuple[Floats, Floats]:
        count = len(columns)
        out = np.full((len(self._own) + 4, 1 + count), np.nan, dtype=np.complex128)
        if np.all(np.abs(columns) < _MAX_COLUMN):
            moved = np.column_stack([columns, columns[:, None] + 1e-30j * np.eye(count)])
            searched = np.zeros((len(self._own) + 2, 1 + count), dtype=np.complex128)
            searched[self._places] = moved[self._searched]
            with np.errstate(all="ignore"):
                found = self._valley_coordinates.scaled(searched)
            out[[*range(len(self._own) + 1), -2]] = found
            out[[-3, -1]] = moved[[-3, -1]]
        # a trial step may lie anywhere; the caller rejects values that overflow
        with np.errstate(over="ignore", invalid="ignore"):
            return out[:, 0].real, out[:, 1:].imag / 1e-30

    def map_parameters(self, columns: Floats) -> tuple[Floats, Floats]:
        """The map's parameters, T0 (s) and the time of the first turning point (s) in one array, and their
        derivatives with respect to the columns; NaN for columns without a solution. The map's parameters are
        the law's own, the drag, the reference (rad), R/a times it, and the first amplitude."""
        scaled, by_scaled = self._scaled(columns)
        count = len(self._own) + 1
        by = np.zeros((len(scaled) + 2, len(columns)))
        by[:count], by[count + 2 :] = by_scaled[:count], by_scaled[count:]
        return np.concatenate([scaled[:count], [self.reference, self._rho], scaled[count:]]), by

    def physical(self, columns: Floats) -> tuple[Floats, Floats]:
        """SI values in the order of `Law.fit_names`, and their derivatives with respect to the columns."""
        scaled, by = self._scaled(columns)
        first, period0_s, time_s = scaled[-3:].tolist()
        out: dict[str, float] = {}
        rows: dict[str, Floats] = {}
        log_r = np.log(self.reference)
        # a trial step may lie anywhere; the caller rejects values that overflow
        with np.errstate(over="ignore", invalid="ignore"):
            for k, (key, scaling) in enumerate(self._scalings.items()):
                power, row = scaling.power, by[k].copy()
                if scaling.exponent:
                    j = self._own.index(scaling.exponent)
                    power += scaling.per_exponent * scaled[j]
                    row += scaled[k] * scaling.per_exponent * log_r * by[j]
                factor = np.exp(power * log_r)
                if scaling.unit is not None:
                    factor /= scaling.unit(self._pendulum)
                out[key], rows[key] = scaled[k] * factor, row * factor
        count, per_rate = len(self._own), period0_s / (2 * np.pi)
        out[DRAG.key] = scaled[count] * per_rate
        rows[DRAG.key] = by[count] * per_rate + scaled[count] / (2 * np.pi) * by[-2]
        out |= {PERIOD: period0_s, AMPLITUDE.key: first * self.reference, TIME.key: time_s}
        rows |= {PERIOD: by[-2], AMPLITUDE.key: by[-3] * self.reference, TIME.key: by[-1]}
        return np.array([out[key] for key in self._names]), np.array([rows[key] for key in self._names])

    def from_physical(self, values: Mapping[str, float]) -> Floats:
        """The columns that correspond to physical values, given by key."""
        scaled = scaled_values(self._scalings, values, self._pendulum, self.reference)
        if self._drag:
            scaled[DRAG.key] = values[DRAG.key] * 2 * np.pi / values[PERIOD]
        first = values[AMPLITUDE.key] / self.reference
        return self._columns({**scaled, PERIOD: values[PERIOD]}, first, values[TIME.key])

    def _columns(self, scaled: Mapping[str, float], first: float, time_s: float) -> Floats:
        values = np.array([scaled.get(key, 0.0) for key in (*self._own, DRAG.key, PERIOD)])
        found = self._valley_coordinates.coordinates(values)
        if not self._drag:
            found = np.delete(found, -2)
        out = np.empty(len(self.lower))
        out[: len(self._others)], out[self._searched] = self._others, found
        out[-3], out[-1] = first, time_s
        return out

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Floats]]:
        """Start values, the most promising first. Each is a sequence of attempts; the first one for which
        the map reaches the last half-cycle is used."""
        found = start_values(points, self._rho, drag=self.valley is not None)
        loses = {key: scaling.loses for key, scaling in self._scalings.items()} | {DRAG.key: True}
        exponents = {scaling.exponent for scaling in self._scalings.values()}
        groups = []
        for scaled in self._propose_starts(found, self.reference):
            attempts = []
            for slower in _DECAY_RATE_FACTORS:
                weaker = {
                    key: value * slower if loses.get(key) and key not in exponents else value
                    for key, value in scaled.items()
                }
                attempts.append(self._columns(weaker, found.decay.start, float(points.time_s[0])))
            groups.append(attempts)
        return groups

    def held(self, name: str) -> HeldColumn:
        """The column that is solved for when a parameter is held for its profile likelihood."""
        first = len(self._others)
        if name in self._own:
            place, held = self._own.index(name), self._valley_coordinates.held
            found = held[place] if held else HeldColumn(place)
            return HeldColumn(first + found.column, found.keeps_sign)
        place = {DRAG.key: first + len(self._own), AMPLITUDE.key: -3, PERIOD: -2, TIME.key: -1}[name]
        return HeldColumn(place % len(self.lower))

    def at_limit(self, columns: Floats) -> Sequence[str]:
        """Parameters that are at a limit of the range searched."""
        first, count = len(self._others), len(self._own)
        near = np.minimum(columns - self.lower, self.upper - columns) < _LIMIT_DISTANCE
        scaled, _ = self._scaled(columns)
        moved = [self.held(key).column for key in self._own]
        nearest = (first + np.flatnonzero(near[first : first + count])).tolist()
        found = {moved.index(column) if column in moved else column - first for column in nearest}
        found |= set(self._valley_coordinates.at_limit(scaled))
        for place, parameter in enumerate(self._parameters):
            if not self._scalings[self._own[place]].exponent and parameter.lower and parameter.upper < np.inf:
                inside = min(scaled[place] - parameter.lower, parameter.upper - scaled[place])
                found |= {place} if inside < _LIMIT_DISTANCE else set()
        return [self._own[place] for place in sorted(found)]
