"""Coordinates (columns) in which the solver fits the paper's law, so that its valleys are straight."""

from collections.abc import Mapping, Sequence

import numpy as np

from processing.arrays import Floats
from processing.contact.half_swing import relative_curvature, stiffness_ratio
from processing.contact.half_swing_kernel import A0, DRAG, KAPPA, MAP_PARAMETERS, RHO, B, C, N, P
from processing.contact.law import AMPLITUDE, TIME, HeldColumn
from processing.contact.law import DRAG as DRAG_PARAMETER
from processing.contact.parameters import PendulumOnBall
from processing.contact.period_law import cosine_moment
from processing.contact.start_values import PeriodStart, from_straight, start_values, to_straight
from processing.periods import reference_amplitude
from processing.swing import TurningPoints

SMALLEST = {"p": -0.5, "n": 0.002}
"""Lower limit of n: below it adhesion cancels nearly all of the stiffness, and n cannot be told from 0."""
LARGEST = {"p": 5.0, "n": 5.0}

STIFFEST = 20.0
"""Largest factor, in either direction, between the stiffness with adhesion and that of gravity alone for
which parameters are tried."""

_LARGEST = 1e100
"""No column is that large: a solver that tries more finds nothing there, before products overflow."""

_LN_B, _P, _C, _N, _SLOPE, _DRAG = range(6)
"""Indices of the columns and of the natural coordinates; `_SLOPE` is kappa among the latter. The last three
of both are the first amplitude, T0 and the time of the first turning point."""
_AMPLITUDE, _PERIOD, _TIME = -3, -2, -1


def moment_and_slope(n: float) -> tuple[float, float]:
    """`cosine_moment` of n + 2 and its derivative by n."""
    step = 1e-5
    slope = (cosine_moment(n + 2 + step) - cosine_moment(n + 2 - step)) / (2 * step)
    return cosine_moment(n + 2), slope


class HalfSwingColumns:
    """`processing.contact.law.Columns` of the paper's law.

    Natural coordinates are ln b, p, c, n, kappa, (drag,) first amplitude, T0 and the time of the first
    turning point, as in `ScaledContact`. The logarithm keeps b positive; at b = 0, p would be undefined.

    The columns differ from them where parameters are strongly correlated. Chi-square then has a curved
    valley, in which the solver would advance in very small steps; in the columns the valley is straight.

    - Adhesion. By harmonic balance it leaves the fraction ``q = 1 - 2 kappa J`` of the stiffness at the
      reference amplitude (J is `cosine_moment` of n+2). The data determine well the period there,
      ``T0/sqrt(q)``, its slope against ln x, ``s = n kappa J/q``, and the losses relative to this
      stiffness, ``b/q``, ``c/q``, ``drag/sqrt(q)``. Only n varies along the valley.
    - Drag. If it is fitted, b, p and drag are replaced by the coordinates of `straight`; a drag of 1
      corresponds to a linear loss of pi/4.
    """

    def __init__(
        self, points: TurningPoints, pendulum: PendulumOnBall | None, names: tuple[str, ...]
    ) -> None:
        self.reference = reference_amplitude(points)
        self._names = names
        self._drag = DRAG_PARAMETER.key in names
        self.valley = _LN_B if self._drag else None
        self._rho = relative_curvature(pendulum) * self.reference
        self._per_gamma = 1.0 if pendulum is None else stiffness_ratio(1.0, pendulum)
        self._in_map = [B, P, C, N, KAPPA, *([DRAG] if self._drag else []), A0]
        self.map_by_log_rho = np.zeros(MAP_PARAMETERS)
        self.map_by_log_rho[RHO] = self._rho
        count = len(names)
        self.lower, self.upper = np.full(count, -np.inf), np.full(count, np.inf)
        self.lower[[_LN_B, _N, _SLOPE]] = -30.0, SMALLEST["n"], -5.0
        self.upper[[_LN_B, _N, _SLOPE]] = 5.0, LARGEST["n"], 5.0
        if self._drag:
            # As p approaches 1, b and drag can cancel each other at arbitrarily large values. Limit b to
            # several times the loss observed.
            loss = abs(np.log(points.amplitude[0] / points.amplitude[-1])) / (
                points.index[-1] - points.index[0]
            )
            self.upper[_LN_B] = np.log(6 * loss)
        else:
            self.lower[_P], self.upper[_P] = SMALLEST["p"], LARGEST["p"]
        self.lower[_AMPLITUDE] = 1e-3
        self.lower[_PERIOD] = 1e-6

    def _natural(self, columns: Floats) -> tuple[Floats, Floats]:
        """Natural coordinates of the columns, and their derivatives by them."""
        out = columns.copy()
        first = np.eye(len(columns))
        if not np.all(np.abs(columns) < _LARGEST):
            return np.full_like(columns, np.nan), first
        if self._drag:
            coordinates = [_LN_B, _P, _DRAG]
            out[_P], linear_drag, by = from_straight(*columns[coordinates].tolist())
            out[_DRAG] = 4 / np.pi * linear_drag
            first[_P, coordinates] = by[0]
            first[_DRAG, coordinates] = 4 / np.pi * by[1]
        n, s = columns[_N], columns[_SLOPE]
        # q = n/(n + 2 s) from s = n kappa J/q and q = 1 - 2 kappa J
        whole = n + 2 * s
        if not n / STIFFEST < whole < n * STIFFEST:
            return np.full_like(columns, np.nan), first
        moment, by_n = moment_and_slope(n)
        q = n / whole
        log_q = np.array([2 * s / (n * whole), -2 / whole])  # derivatives of ln q by n and s
        second = np.eye(len(columns))
        out[_LN_B] += np.log(q)
        second[_LN_B, _N : _SLOPE + 1] = log_q
        for place, power in ((_C, 1.0), (_PERIOD, 0.5), *([(_DRAG, 0.5)] if self._drag else [])):
            out[place] *= q**power
            second[place, _N : _SLOPE + 1] = power * out[place] * log_q
            second[place, place] = q**power
        out[_SLOPE] = s / (whole * moment)
        second[_SLOPE, _N] = -out[_SLOPE] * (1 / whole + by_n / moment)
        second[_SLOPE, _SLOPE] = n / (whole**2 * moment)
        return out, second @ first

    def _columns(self, natural: Floats) -> Floats:
        """The columns of natural coordinates: the inverse of `_natural`."""
        out = natural.copy()
        share = natural[_SLOPE] * cosine_moment(natural[_N] + 2)
        q = 1 - 2 * share
        out[_LN_B] -= np.log(q)
        out[_C] /= q
        out[_SLOPE] = natural[_N] * share / q
        out[_PERIOD] /= np.sqrt(q)
        if self._drag:
            out[_P], out[_DRAG] = to_straight(
                float(out[_LN_B]), natural[_P], np.pi / 4 * natural[_DRAG] / np.sqrt(q)
            )
        return out

    def map_parameters(self, columns: Floats) -> tuple[Floats, Floats]:
        natural, matrix = self._natural(columns)
        out = np.zeros(MAP_PARAMETERS + 2)
        by = np.zeros((len(out), len(columns)))
        out[self._in_map], by[self._in_map] = natural[:_PERIOD], matrix[:_PERIOD]
        out[MAP_PARAMETERS:], by[MAP_PARAMETERS:] = natural[_PERIOD:], matrix[_PERIOD:]
        out[B] = np.exp(natural[_LN_B])
        by[B] *= out[B]
        out[RHO] = self._rho
        if not -0.6 < out[P] < 6.0:
            out[P] = np.nan
        return out, by

    def physical(self, columns: Floats) -> tuple[Floats, Floats]:
        natural, matrix = self._natural(columns)
        log_b, p, c, n, kappa = natural[:5]
        start, t0, first_time = natural[_AMPLITUDE:]
        reference, log_r = self.reference, np.log(self.reference)
        out = np.empty(len(columns))
        with np.errstate(over="ignore"):
            # a trial step may lie anywhere; the caller rejects values that overflow
            b = np.exp(log_b + (1 - p) * log_r)
            gamma_factor = np.exp(-n * log_r) / self._per_gamma
        out[:6] = b, p, c * reference, n, t0, kappa * gamma_factor
        out[-2:] = start * reference, first_time
        by = np.zeros((len(out), len(columns)))
        by[0, _LN_B], by[0, _P] = out[0], -log_r * out[0]
        by[1, _P] = 1.0
        by[2, _C] = reference
        by[3, _N] = 1.0
        by[4, _PERIOD] = 1.0
        by[5, _SLOPE], by[5, _N] = gamma_factor, -log_r * out[5]
        by[-2, _AMPLITUDE] = reference
        by[-1, _TIME] = 1.0
        if self._drag:
            # drag = drag_s w0
            out[6] = natural[_DRAG] * t0 / (2 * np.pi)
            by[6, _DRAG] = t0 / (2 * np.pi)
            by[6, _PERIOD] = natural[_DRAG] / (2 * np.pi)
        with np.errstate(over="ignore", invalid="ignore"):
            return out, by @ matrix

    def from_physical(self, values: Mapping[str, float]) -> Floats:
        r = self.reference
        b, p, c, n, t0, stiffness = (values[name] for name in self._names[:6])
        drag = [values[DRAG_PARAMETER.key] * 2 * np.pi / t0] if self._drag else []
        natural = [
            np.log(b) + (p - 1) * np.log(r),
            p,
            c / r,
            n,
            stiffness * self._per_gamma * r**n,
            *drag,
            values[AMPLITUDE.key] / r,
            t0,
            values[TIME.key],
        ]
        return self._columns(np.array(natural))

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Floats]]:
        """Start values from Eqs. 5 and 6: for each exponent n that fits the periods, then without adhesion.

        Eq. 5 neglects that adhesion reduces the restoring moment and that T differs from T0; its rates are
        converted to those of the exact map. The attempts of one start differ in the rate of decay.
        """
        found = start_values(points, self._rho, drag=self._drag)
        decay, mean_s = found.decay, found.mean_period_s
        groups = []
        for period in [*found.periods[:3], PeriodStart(mean_s, 0.5, 0.0)]:
            stiffness = (period.period0_s / mean_s) ** 2
            factor = stiffness if 0.3 < stiffness < 3 else 1.0
            attempts = []
            for slower in (1.0, 0.9, 0.7, 0.4):
                drag = [decay.d * 4 / np.pi * slower] if self._drag else []
                natural = [
                    np.log(max(decay.b * factor, 1e-9)) + np.log(slower),
                    decay.p,
                    decay.c * factor * slower,
                    np.clip(period.n, 0.01, 4.9),
                    np.clip(period.kappa, -0.5, 0.5),
                    *drag,
                    decay.start,
                    period.period0_s,
                    points.time_s[0],
                ]
                attempts.append(self._columns(np.array(natural)))
            groups.append(attempts)
        return groups

    def held(self, name: str) -> HeldColumn:
        places = {
            "p": _P,
            "c": _C,
            "n": _N,
            DRAG_PARAMETER.key: _DRAG,
            "period0_s": len(self.lower) + _PERIOD,
        }
        if name in places:
            return HeldColumn(places[name])
        if name == "b":
            # with drag the valley runs along the column of ln b, so that b is held by means of p's column
            return HeldColumn(_P if self._drag else _LN_B)
        # the column of adhesion has the sign of gamma, which a Newton step must not change
        return HeldColumn(_SLOPE, keeps_sign=True)

    def at_limit(self, columns: Floats) -> Sequence[str]:
        natural, _ = self._natural(columns)
        stiffness = 1 - 2 * natural[_SLOPE] * cosine_moment(natural[_N] + 2)
        limited = {
            "b": (natural[_LN_B], self.lower[_LN_B], self.upper[_LN_B]),
            "p": (natural[_P], SMALLEST["p"], LARGEST["p"]),
            "n": (natural[_N], self.lower[_N], self.upper[_N]),
            self._names[5]: (np.log(stiffness), -np.log(0.9 * STIFFEST), np.log(0.9 * STIFFEST)),
        }
        return [
            name for name, (value, low, high) in limited.items() if value - low < 1e-4 or high - value < 1e-4
        ]
