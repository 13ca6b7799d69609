"""Example of a law: Coulomb friction.

    M = -m g R c sign(phi')

Each half-swing takes 2 c from the amplitude and lasts T0/2, at every amplitude.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from processing.contact import HalfSwings, HeldColumn, Law, Parameter, PendulumOnBall
from processing.contact.law import BranchMoments
from processing.contact.moments import weight_moment
from processing.kernel import kernel
from processing.periods import mean_period, reference_amplitude
from processing.swing import TurningPoints

Array = NDArray[np.float64]


@kernel
def _half_swings(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
    """q = (c, first amplitude): amplitude = q[1] - 2 c i, time = i/2 in units of T0."""
    count = len(index)
    amplitude, time = np.full(count, np.nan), np.full(count, np.nan)
    by_amplitude, by_time = np.full((count, 2), np.nan), np.full((count, 2), np.nan)
    for k in range(count):
        left = q[1] - 2 * q[0] * index[k]
        if left <= 0:
            break
        amplitude[k], time[k] = left, 0.5 * index[k]
        by_amplitude[k, 0], by_amplitude[k, 1] = -2.0 * index[k], 1.0
        by_time[k] = 0.0
    return amplitude, time, by_amplitude, by_time


def _map(parameters: Array, index: NDArray[np.int64]) -> HalfSwings:
    return HalfSwings(*_half_swings(parameters, index))


def _branch_moments(
    phi_rad: Array, direction: Array, values: Mapping[str, float], pendulum: PendulumOnBall
) -> BranchMoments:
    return BranchMoments(-weight_moment(pendulum) * values["c"] * np.sign(direction), np.zeros_like(phi_rad))


class ConstantMomentColumns:
    """c and the first amplitude in units of the reference, T0, time of the first turning point."""

    def __init__(self, points: TurningPoints, _: PendulumOnBall | None, names: tuple[str, ...]) -> None:
        self.reference = reference_amplitude(points)
        self._names = names
        self._scale = np.array([self.reference, 1.0, self.reference, 1.0])
        self.lower, self.upper = np.array([-np.inf, 1e-6, 1e-3, -np.inf]), np.full(4, np.inf)
        self.map_by_log_rho = np.zeros(2)
        self.valley = None

    def map_parameters(self, columns: Array) -> tuple[Array, Array]:
        order = [0, 2, 1, 3]
        return columns[order], np.eye(4)[order]

    def physical(self, columns: Array) -> tuple[Array, Array]:
        return columns * self._scale, np.diag(self._scale)

    def from_physical(self, values: Mapping[str, float]) -> Array:
        return np.array([values[name] for name in self._names]) / self._scale

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Array]]:
        x = points.amplitude / self.reference
        c = (x[0] - x[-1]) / (2 * (points.index[-1] - points.index[0]))
        return [[np.array([c, mean_period(points), x[0], points.time_s[0]])]]

    def held(self, name: str) -> HeldColumn:
        return HeldColumn(self._names.index(name))

    def at_limit(self, columns: Array) -> Sequence[str]:
        return ()


CONSTANT_MOMENT = Law(
    name="constant-moment",
    title="constant moment",
    source="Coulomb",
    parameters=(
        Parameter("c", "c", "1", "friction over m g R", "M = -m g R c sign(phi')", lower=0.0),
        Parameter("period0_s", "T₀", "s", "period", "I phi'' = -m g R phi", lower=0.0),
    ),
    branch_moments=_branch_moments,
    half_swing_map=_map,
    columns=ConstantMomentColumns,
)


def constant_moment_decay(
    c: float, period0_s: float, initial_rad: float, count: int, u_rad: float, seed: int
) -> TurningPoints:
    """Turning points of the equation of motion itself, with noise: arcs of a harmonic oscillation.

    About the shifted rest positions +c and -c, half a period each; nothing of the map is used.
    """
    rng = np.random.default_rng(seed)
    phi = [initial_rad]
    for _ in range(count - 1):
        rest = c if phi[-1] > 0 else -c
        phi.append(2 * rest - phi[-1])
    amplitude = np.abs(np.array(phi))
    u_time = u_rad / (amplitude * 2 * np.pi / period0_s)
    return TurningPoints(
        np.arange(count, dtype=np.int64),
        0.25 + 0.5 * period0_s * np.arange(count) + u_time * rng.standard_normal(count),
        u_time,
        amplitude + u_rad * rng.standard_normal(count),
        np.full(count, u_rad),
    )
