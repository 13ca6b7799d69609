"""The coordinates in which the solver fits a law, its columns, and their conversion to parameters."""

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
_COMPLEX_STEP = 1e-30
"""Imaginary step of the derivatives, which are exact to rounding."""
_DECAY_RATE_FACTORS = (1.0, 0.9, 0.7, 0.4)
"""Factors of the proposed rates of decay with which a fit is tried to begin."""

StartProposal = Callable[[StartValues, float], Sequence[Mapping[str, float]]]
"""Function of a law that proposes scaled start values by key, from those of a decay of the paper's form and
the reference amplitude in rad; the most promising first."""


class Scaling(NamedTuple):
    """The unit in which a parameter is fitted.

    ``value = scaled * reference^(power + per_exponent * exponent) / unit``.
    """

    power: float = 0.0
    per_exponent: float = 0.0
    exponent: str = ""
    """Key of another parameter."""
    unit: Callable[[PendulumOnBall], float] | None = None
    loses: bool = True
    """Whether a decay is slower where the value is smaller."""


def scaled_values(
    scalings: Mapping[str, Scaling],
    values: Mapping[str, float],
    pendulum: PendulumOnBall,
    reference: float,
) -> dict[str, float]:
    """SI values in the units of a fit, by key."""
    scaled = {}
    for key, scaling in scalings.items():
        power = scaling.power
        if scaling.exponent:
            power += scaling.per_exponent * values[scaling.exponent]
        unit = 1.0 if scaling.unit is None else scaling.unit(pendulum)
        scaled[key] = values[key] * unit * reference**-power
    return scaled


class ValleyCoordinates(NamedTuple):
    """Coordinates of the search in which the valley of chi2 is straight.

    They have one number for each of the law's own parameters, the drag (0 if it is not fitted) and the
    period, as the scaled values have.
    """

    scaled: Callable[[ComplexOrReal], ComplexOrReal]
    """Scaled values of coordinates, which may be complex (for derivatives) and have further axes."""
    coordinates: Callable[[Floats], Floats]
    """Coordinates of scaled values, the inverse of `scaled`."""
    held: tuple[HeldColumn, ...] = ()
    """For each own parameter, the coordinate that moves it most; empty: the one of its index."""
    limits: Callable[[float], Mapping[int, tuple[float, float]]] = lambda _: MappingProxyType({})
    """Ranges of coordinates by index, a function of the measured relative loss in a half-cycle."""
    valley: int | None = None
    """Coordinate along which friction and drag replace each other."""
    at_limit: Callable[[Floats], Sequence[int]] = lambda _: ()
    """Indices of parameters, from scaled values, that are at a limit which is none of a coordinate."""


def logarithms_of(*indices: int) -> ValleyCoordinates:
    """Coordinates that are the scaled values, but their logarithms at `indices`, which stay positive."""

    def scaled(values: ComplexOrReal) -> ComplexOrReal:
        out = values.copy()
        out[list(indices)] = np.exp(values[list(indices)])
        return out

    def coordinates(values: Floats) -> Floats:
        out = values.copy()
        out[list(indices)] = np.log(np.maximum(values[list(indices)], 1e-12))
        return out

    return ValleyCoordinates(scaled, coordinates)


class Coordinates:
    """Coordinates in which the solver fits a law to one decay, and their conversion to parameters.

    The solver varies columns, chosen so that the valleys of chi2 are straight: `others` of the fit, which
    start at these values and are none of the law's, then the coordinates (`valley_coordinates`, a function of
    whether a drag is fitted) of the law's own parameters and of the drag, the first amplitude, the coordinate
    of T0, and the first time. They determine the parameters of the half-cycle map (dimensionless: angles in
    units of `reference`, the geometric mean amplitude, times in units of T0) and the values in SI units.

    Attributes
    ----------
    lower, upper
        Bounds of the columns.
    map_by_log_rho
        Derivative of the map's parameters with respect to ln(R/a), which a fit takes as known.
    exponents
        Keys of the law's exponents. Where one is not known, chi2 may have several minima.
    elastic
        Keys of the elastic parameters with an exponent. Where one may be 0, its exponent is not known.
    valley
        Column along which friction and drag replace each other without a change of the turning points; None
        if there is none, or if it is not known.
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
        propose_starts: StartProposal,
    ) -> None:
        self.reference = reference_amplitude(points)
        self._names = names
        self._pendulum = pendulum
        self._parameters = [p for p in parameters if p.key not in (PERIOD, DRAG.key)]
        self._own = tuple(parameter.key for parameter in self._parameters)
        self._scalings = scalings
        self.exponents = frozenset(scaling.exponent for scaling in scalings.values()) - {""}
        self.elastic = tuple(key for key, item in scalings.items() if item.exponent and not item.loses)
        self._drag = DRAG.key in names
        self._cache: dict[bytes, tuple[Floats, Floats]] = {}
        self._valley_coordinates, self._propose_starts = valley_coordinates(self._drag), propose_starts
        self._others = tuple(others)
        first = len(self._others)
        valley = self._valley_coordinates.valley
        self.valley = None if valley is None else first + valley
        self._rho = relative_curvature(pendulum) * self.reference
        count = len(self._own)
        self.map_by_log_rho = np.zeros(count + 4)
        self.map_by_log_rho[-2] = self._rho
        # columns of own parameters, drag, and T0, and their indices among the valley coordinates
        fitted = range(count + self._drag)
        self._valley_columns = [first + column for column in (*fitted, count + self._drag + 1)]
        self._valley_indices = [*fitted, count + 1]
        self.upper = np.full(first + count + self._drag + 3, np.inf)
        self.lower = -self.upper
        half_cycles = points.index[-1] - points.index[0]
        loss = abs(float(np.log(points.amplitude[0] / points.amplitude[-1]) / half_cycles))
        for index, (low, high) in self._valley_coordinates.limits(loss).items():
            self.lower[first + index], self.upper[first + index] = low, high
        self.lower[-3], self.lower[-2] = 1e-3, 1e-6

    def _scaled(self, columns: Floats) -> tuple[Floats, Floats]:
        """Scaled own parameters, drag, first amplitude, T0 and first time, and their derivatives."""
        key = columns.tobytes()
        if key not in self._cache:
            self._cache.clear()  # the last columns stay: a search of the noise needs them a hundred times
            self._cache[key] = self._derivatives(columns)
        return self._cache[key]

    def _derivatives(self, columns: Floats) -> tuple[Floats, Floats]:
        count = len(columns)
        out = np.full((len(self._own) + 4, 1 + count), np.nan, dtype=np.complex128)
        if np.all(np.abs(columns) < _MAX_COLUMN):
            stepped = np.column_stack([columns, columns[:, None] + 1j * _COMPLEX_STEP * np.eye(count)])
            coordinates = np.zeros((len(self._own) + 2, 1 + count), dtype=np.complex128)
            coordinates[self._valley_indices] = stepped[self._valley_columns]
            with np.errstate(all="ignore"):
                out[[*range(len(self._own) + 1), -2]] = self._valley_coordinates.scaled(coordinates)
            out[[-3, -1]] = stepped[[-3, -1]]
        # a trial step may lie anywhere; the caller rejects values that overflow
        with np.errstate(over="ignore", invalid="ignore"):
            return out[:, 0].real, out[:, 1:].imag / _COMPLEX_STEP

    def map_parameters(self, columns: Floats) -> tuple[Floats, Floats]:
        """The map's parameters, T0 (s) and the time of the first turning point (s) in one array, and their
        derivatives with respect to the columns; NaN for columns without a solution. The map's parameters are
        the law's own, the drag, the reference (rad), R/a times it, and the first amplitude."""
        scaled, derivatives = self._scaled(columns)
        count = len(self._own) + 1
        return (
            np.concatenate([scaled[:count], [self.reference, self._rho], scaled[count:]]),
            np.insert(derivatives, [count, count], 0.0, axis=0),
        )

    def physical(self, columns: Floats) -> tuple[Floats, Floats]:
        """SI values in the order of `Law.fit_names`, and their derivatives with respect to the columns."""
        scaled, derivatives = self._scaled(columns)
        first, period0_s, time_s = scaled[-3:].tolist()
        values: dict[str, float] = {}
        rows: dict[str, Floats] = {}
        log_r = np.log(self.reference)
        # a trial step may lie anywhere; the caller rejects values that overflow
        with np.errstate(over="ignore", invalid="ignore"):
            for k, (key, scaling) in enumerate(self._scalings.items()):
                power, row = scaling.power, derivatives[k].copy()
                if scaling.exponent:
                    j = self._own.index(scaling.exponent)
                    power += scaling.per_exponent * scaled[j]
                    row += scaled[k] * scaling.per_exponent * log_r * derivatives[j]
                factor = np.exp(power * log_r)
                if scaling.unit is not None:
                    factor /= scaling.unit(self._pendulum)
                values[key], rows[key] = scaled[k] * factor, row * factor
        drag_row, amplitude_row, period_row, time_row = derivatives[-4:]
        drag, s_per_rad = scaled[-4], period0_s / (2 * np.pi)
        values |= {PERIOD: period0_s, AMPLITUDE.key: first * self.reference, TIME.key: time_s}
        values[DRAG.key] = drag * s_per_rad
        rows[DRAG.key] = drag_row * s_per_rad + drag / (2 * np.pi) * period_row
        rows |= {PERIOD: period_row, AMPLITUDE.key: amplitude_row * self.reference, TIME.key: time_row}
        return np.array([values[key] for key in self._names]), np.array([rows[key] for key in self._names])

    def from_physical(self, values: Mapping[str, float]) -> Floats:
        """The columns that correspond to physical values, given by key."""
        scaled = scaled_values(self._scalings, values, self._pendulum, self.reference)
        if self._drag:
            scaled[DRAG.key] = values[DRAG.key] * 2 * np.pi / values[PERIOD]
        first = values[AMPLITUDE.key] / self.reference
        return self._columns({**scaled, PERIOD: values[PERIOD]}, first, values[TIME.key])

    def _columns(self, scaled: Mapping[str, float], first: float, time_s: float) -> Floats:
        values = np.array([scaled.get(key, 0.0) for key in (*self._own, DRAG.key, PERIOD)])
        out = np.empty(len(self.lower))
        out[: len(self._others)] = self._others
        out[self._valley_columns] = self._valley_coordinates.coordinates(values)[self._valley_indices]
        out[-3], out[-1] = first, time_s
        return out

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Floats]]:
        """Start values, the most promising first. Each is a sequence of attempts; the first one for which
        the map reaches the last half-cycle is used."""
        start = start_values(points, self._rho, drag=self.valley is not None)
        losses = {key for key, scaling in self._scalings.items() if scaling.loses} - self.exponents
        losses |= {DRAG.key}
        return [
            [
                self._columns(
                    {key: value * factor if key in losses else value for key, value in scaled.items()},
                    start.decay.start,
                    float(points.time_s[0]),
                )
                for factor in _DECAY_RATE_FACTORS
            ]
            for scaled in self._propose_starts(start, self.reference)
        ]

    def held(self, name: str) -> HeldColumn:
        """The column that is solved for when a parameter is held for its profile likelihood."""
        first = len(self._others)
        if name in self._own:
            index, all_held = self._own.index(name), self._valley_coordinates.held
            held = all_held[index] if all_held else HeldColumn(index)
            return HeldColumn(first + held.column, held.keeps_sign)
        column = {DRAG.key: first + len(self._own), AMPLITUDE.key: -3, PERIOD: -2, TIME.key: -1}[name]
        return HeldColumn(column % len(self.lower))

    def at_limit(self, columns: Floats) -> Sequence[str]:
        """Parameters that are at a limit of the range searched."""
        first, count = len(self._others), len(self._own)
        is_near = np.minimum(columns - self.lower, self.upper - columns) < _LIMIT_DISTANCE
        scaled, _ = self._scaled(columns)
        held_columns = [self.held(key).column for key in self._own]
        near_columns = (first + np.flatnonzero(is_near[first : first + count])).tolist()
        indices = {
            held_columns.index(column) if column in held_columns else column - first
            for column in near_columns
        }
        indices |= set(self._valley_coordinates.at_limit(scaled))
        for index, parameter in enumerate(self._parameters):
            if not self._scalings[parameter.key].exponent and parameter.lower and parameter.upper < np.inf:
                distance = min(scaled[index] - parameter.lower, parameter.upper - scaled[index])
                indices |= {index} if distance < _LIMIT_DISTANCE else set()
        return [self._own[index] for index in sorted(indices)]
