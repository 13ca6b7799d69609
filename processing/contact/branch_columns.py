"""The solver's columns of a law that follows from the last reversal."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.contact.law import AMPLITUDE, DRAG, TIME, HeldColumn, Parameter
from processing.contact.parameters import PendulumOnBall
from processing.contact.start_values import StartValues, start_values
from processing.errors import DataError
from processing.periods import reference_amplitude
from processing.swing import TurningPoints

PERIOD = "period0_s"
ComplexOrReal = NDArray[Any]


class Scaling(NamedTuple):
    """The unit in which a parameter is fitted.

    ``value = scaled * reference^(power + per_exponent * exponent)``; `exponent` is the key of another
    parameter.
    """

    power: float = 0.0
    per_exponent: float = 0.0
    exponent: str = ""


class Straight(NamedTuple):
    """Coordinates of the search in which the valley of chi2 is straight.

    Both functions take and return one number for each of the law's own parameters and one for the period:
    `scaled` the scaled values and T0 of coordinates, which may be complex (derivatives are taken so), and
    `coordinates` the inverse. `held` gives for each parameter the coordinate that moves it most, `limits` the
    range of coordinates by place.
    """

    scaled: Callable[[ComplexOrReal], ComplexOrReal]
    coordinates: Callable[[Floats], Floats]
    held: tuple[int, ...] = ()
    limits: Mapping[int, tuple[float, float]] = MappingProxyType({})


def logarithms_of(*places: int) -> Straight:
    """The scaled values themselves, but for those at the given places, which stay positive."""

    def scaled(values: ComplexOrReal) -> ComplexOrReal:
        out = values.copy()
        with np.errstate(over="ignore"):
            out[list(places)] = np.exp(values[list(places)])
        return out

    def coordinates(values: Floats) -> Floats:
        out = values.copy()
        out[list(places)] = np.log(np.maximum(values[list(places)], 1e-12))
        return out

    return Straight(scaled, coordinates)


class BranchColumns:
    """Coordinates of the law's parameters, drag, first amplitude, coordinate of T0, first time."""

    def __init__(
        self,
        points: TurningPoints,
        pendulum: PendulumOnBall | None,
        names: tuple[str, ...],
        parameters: Sequence[Parameter],
        scalings: Mapping[str, Scaling],
        straight: Straight,
        likely: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
        *,
        in_angles: bool = False,
    ) -> None:
        if in_angles and pendulum is None:
            raise DataError("a law with yield angles needs deflections in angles: calibrate the lever")
        self.reference = reference_amplitude(points)
        self.valley: int | None = None
        self._names = names
        self._own = tuple(p.key for p in parameters if p.key not in (PERIOD, DRAG.key))
        self._drag = DRAG.key in names
        self._scalings = [scalings[key] for key in self._own]
        self._straight, self._likely = straight, likely
        count = len(self._own)
        self._searched = [*range(count), count + self._drag + 1]
        # coefficients may become negative, so that one that is truly 0 is estimated without bias
        bounded = [straight.limits.get(place, (-np.inf, np.inf)) for place in range(count)]
        free = [(-np.inf, np.inf)] * self._drag
        rest = [(1e-3, np.inf), (1e-6, np.inf), (-np.inf, np.inf)]
        self.lower, self.upper = np.array([*bounded, *free, *rest]).T
        self.map_by_log_rho = np.zeros(count + 3)

    def map_parameters(self, columns: Floats) -> tuple[Floats, Floats]:
        count = len(self._own)
        out, by = np.zeros(count + 5), np.zeros((count + 5, len(columns)))
        places = [*range(count), count + 3]
        searched = columns[self._searched]
        with np.errstate(all="ignore"):
            out[places] = self._straight.scaled(searched)
            for k, place in enumerate(self._searched):
                step = np.zeros(len(searched), dtype=np.complex128)
                step[k] = 1e-30j
                by[places, place] = self._straight.scaled(searched + step).imag / 1e-30
        if self._drag:
            out[count], by[count, count] = columns[count], 1.0
        out[count + 1] = self.reference
        for place, column in ((count + 2, -3), (count + 4, -1)):
            out[place], by[place, column] = columns[column], 1.0
        return out, by

    def physical(self, columns: Floats) -> tuple[Floats, Floats]:
        scaled, by = self.map_parameters(columns)
        first, period0_s, time_s = scaled[-3:].tolist()
        out: dict[str, float] = {}
        rows: dict[str, Floats] = {}
        log_r = np.log(self.reference)
        for k, (key, scaling) in enumerate(zip(self._own, self._scalings, strict=True)):
            power, row = scaling.power, by[k].copy()
            if scaling.exponent:
                j = self._own.index(scaling.exponent)
                power += scaling.per_exponent * scaled[j]
                row += scaled[k] * scaling.per_exponent * log_r * by[j]
            with np.errstate(over="ignore", invalid="ignore"):
                factor = np.exp(power * log_r)
                out[key], rows[key] = scaled[k] * factor, row * factor
        count, per_rate = len(self._own), period0_s / (2 * np.pi)
        if self._drag:
            out[DRAG.key] = scaled[count] * per_rate
            rows[DRAG.key] = by[count] * per_rate + scaled[count] / (2 * np.pi) * by[-2]
        out |= {PERIOD: period0_s, AMPLITUDE.key: first * self.reference, TIME.key: time_s}
        rows |= {PERIOD: by[-2], AMPLITUDE.key: by[-3] * self.reference, TIME.key: by[-1]}
        return np.array([out[key] for key in self._names]), np.array([rows[key] for key in self._names])

    def from_physical(self, values: Mapping[str, float]) -> Floats:
        scaled = {}
        for key, scaling in zip(self._own, self._scalings, strict=True):
            power = scaling.power
            if scaling.exponent:
                power += scaling.per_exponent * values[scaling.exponent]
            scaled[key] = values[key] * self.reference**-power
        if self._drag:
            scaled[DRAG.key] = values[DRAG.key] * 2 * np.pi / values[PERIOD]
        first = values[AMPLITUDE.key] / self.reference
        return self._columns({**scaled, PERIOD: values[PERIOD]}, first, values[TIME.key])

    def _columns(self, scaled: Mapping[str, float], first: float, time_s: float) -> Floats:
        out = np.empty(len(self.lower))
        values = np.array([scaled[key] for key in (*self._own, PERIOD)])
        out[self._searched] = self._straight.coordinates(values)
        if self._drag:
            out[len(self._own)] = scaled.get(DRAG.key, 0.0)
        out[-3], out[-1] = first, time_s
        return out

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Floats]]:
        found = start_values(points, 0.0, drag=False)
        groups = []
        for scaled in self._likely(found, self.reference):
            attempts = []
            for slower in (1.0, 0.9, 0.7, 0.4):
                weaker = dict(scaled)
                for key in (*self._own, DRAG.key):
                    exponent = any(one.exponent == key for one in self._scalings)
                    if key in weaker and not exponent:
                        weaker[key] *= slower
                attempts.append(self._columns(weaker, found.decay.start, float(points.time_s[0])))
            groups.append(attempts)
        return groups

    def held(self, name: str) -> HeldColumn:
        if name in self._own:
            place = self._own.index(name)
            return HeldColumn(self._straight.held[place] if self._straight.held else place)
        place = {DRAG.key: len(self._own), AMPLITUDE.key: -3, PERIOD: -2, TIME.key: -1}[name]
        return HeldColumn(place % len(self.lower))

    def at_limit(self, columns: Floats) -> Sequence[str]:
        near = np.minimum(columns - self.lower, self.upper - columns) < 1e-4
        return [key for place, key in enumerate(self._own) if near[self.held(key).column]]
