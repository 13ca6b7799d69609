"""Half-swings of a law with memory, whose moment depends on the last reversal.

In a decay the amplitude falls from reversal to reversal, so that only the last reversal matters. From a
reversal at the amplitude A the resisting moment, over m g R, is a function of the distance s = A - phi and of
the moment at the reversal; the moment at the next reversal is the one at the end of the branch. The kinetic
energy after the distance s is, over m g R and in units of the reference,

    v^2/2 = s [A - s/2 - L(s)],      L(s) = 1/s integral_0^s (resistance) ds'

so that the next reversal lies at s = 2 r with A - r = L(2r). With s = r (1 - cos theta), the factor

    G = v^2 / (r sin theta)^2 = 1 + 2 [L(2r) - L(s)] / (2r - s)

is smooth at both ends except for fractional powers of s, which the substitution theta = pi v^3 smooths. The
half-swing lasts
``integral dtheta / (2 pi sqrt(G))`` in units of T0. A linear drag adds ``drag r^2 integral sin^2 sqrt(G)
dtheta`` to the work, found by iteration.

The amplitudes fall slowly, so that the moment at a reversal, too, is a function of the amplitude: the moment
in steady swings, corrected by the one at the end of the previous branch.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from math import ceil, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Coordinates, Scaling, ValleyCoordinates
from processing.contact.half_swing import SwingTable
from processing.contact.law import DRAG, PERIOD, BranchMoments, Law, Parameter, PendulumOnBall, weight_moment

Arrays = Mapping[str, Floats]

_NODES = 24
"""Nodes of a half-swing; decays by smooth laws then agree with an integration of their motion to 3e-7."""
_PER_OCTAVE, _BEYOND, _FEWEST = 12, 1, 4
"""Numbers of amplitudes of a table: in each factor of two, beyond either end of the range, and at least."""
_RELATIVE_STEP = 1e-5
"""Relative step of the numerical derivatives with respect to the parameters."""
_MAX_ITERATIONS, _MAX_NEWTON_ITERATIONS, _MAX_DRAG_ITERATIONS = 12, 20, 20
"""Most iterations of a drag's work, of the next reversal, of the speed with a drag. Swings take 5, 5 and 6.
A search also tries values for which one amplitude of many never converges: all would wait for it."""


class Branch(NamedTuple):
    """The contact's moment over m g R from one reversal on, as functions of arrays.

    Angles are in units of a reference, which divides moments, too. `resistance` and `mean_resistance` take
    the distance from the reversal, the moment there and the parameters by key; the first is the moment
    against the motion at that distance (negative: the contact pushes), the second its mean over the distance.
    `at_reversal` takes the amplitude and the parameters and gives the moment at a reversal of steady swings.
    The parameters include ``reference``, the unit of angles in rad. `constant` is the key of an additional
    constant friction without memory; empty if there is none.
    """

    resistance: Callable[[Floats, Floats, Arrays], Floats]
    mean_resistance: Callable[[Floats, Floats, Arrays], Floats]
    at_reversal: Callable[[Floats, Arrays], Floats]
    constant: str = ""

    def moments(
        self, phi_rad: Floats, direction: Floats, values: Arrays, pendulum: PendulumOnBall
    ) -> BranchMoments:
        """Moments over a closed loop between the largest deflection and its opposite.

        The part that both directions share is elastic, the part that differs is friction.
        """
        amplitude = np.max(np.abs(phi_rad), axis=-1, keepdims=True)
        known = {**values, "reference": np.ones(())}
        # a fit may leave a parameter so small that its quotients overflow
        with np.errstate(all="ignore"):
            turn_moment = self.at_reversal(amplitude, known)
            down = self.resistance(amplitude - phi_rad, turn_moment, known)
            up = self.resistance(amplitude + phi_rad, turn_moment, known)
        weight = weight_moment(pendulum)
        friction = 0.5 * (down + up)
        if self.constant:
            friction = friction + known[self.constant]
        return BranchMoments(-weight * np.sign(direction) * friction, 0.5 * weight * (down - up))


def masing(
    backbone: Callable[[Floats, Arrays], Floats], work: Callable[[Floats, Arrays], Floats], *, constant: str
) -> Branch:
    """Branches that are the backbone curve doubled (Masing's rule), with an additional constant friction.

    ``M = 2 f(s/2) - M_reversal``. `work` is the integral of the backbone f.
    """

    def resistance(s: Floats, turn_moment: Floats, q: Arrays) -> Floats:
        return 2 * backbone(s / 2, q) - turn_moment

    def mean_resistance(s: Floats, turn_moment: Floats, q: Arrays) -> Floats:
        return 4 * work(s / 2, q) / s - turn_moment

    return Branch(resistance, mean_resistance, backbone, constant)


class _QuadraturePoints(NamedTuple):
    """Gauss-Legendre nodes of v with theta = pi v^3.

    The rows of `work_per_share` map sqrt(G) at the nodes to ``integral_0^theta sin^2 sqrt(G) dtheta'``
    divided by the share. Only the root is interpolated, so that no digits are lost near the reversal.
    """

    share: Floats  # s / 2r
    sin2: Floats
    weight: Floats
    work_per_share: Floats


@lru_cache(maxsize=1)
def _nodes() -> _QuadraturePoints:
    x, w = np.polynomial.legendre.leggauss(_NODES)
    v, half = (x + 1) / 2, w / 2
    share = np.sin(np.pi / 2 * v**3) ** 2
    to_coefficients = (
        (2 * np.arange(_NODES) + 1)[:, None] / 2 * np.polynomial.legendre.legvander(x, _NODES - 1).T * w
    )
    inner = v[:, None] * v
    weights = v[:, None] * half * np.sin(np.pi * inner**3) ** 2 * 3 * np.pi * inner**2
    interpolated = np.polynomial.legendre.legvander(2 * inner - 1, _NODES - 1) @ to_coefficients
    return _QuadraturePoints(
        share,
        np.sin(np.pi * v**3) ** 2,
        3 * np.pi * v**2 * half,
        np.einsum("kj,kjm->km", weights, interpolated) / share[:, None],
    )


def _half_swing(
    branch: Branch, amplitude: Floats, turn_moment: Floats, q: Arrays
) -> tuple[Floats, Floats, Floats]:
    """Next amplitude, duration (T0) and moment at the next reversal; NaN where the pendulum sticks.

    `amplitude` and `turn_moment` have the shape ``(sets, amplitudes)``, the parameters ``(sets, 1)``.
    """
    nodes = _nodes()
    drag, constant = q["drag"], q[branch.constant] if branch.constant else 0.0
    radius, drag_work = amplitude.copy(), np.zeros_like(amplitude)  # work of the drag over r^2
    wide_q = {key: value[..., None] for key, value in q.items()}
    with np.errstate(all="ignore"):
        for _ in range(_MAX_ITERATIONS):
            for _ in range(_MAX_NEWTON_ITERATIONS):
                distance = 2 * radius
                mean = branch.mean_resistance(distance, turn_moment, q)
                slope = (
                    1 + (branch.resistance(distance, turn_moment, q) - mean) / radius + 0.5 * drag * drag_work
                )
                change = (amplitude - radius - mean - constant - 0.5 * drag * drag_work * radius) / slope
                radius += np.clip(change, -0.5 * radius, 0.5 * radius)
                if not np.any(np.abs(change) > 3e-16 * amplitude):
                    break
            wide_distance = 2 * radius[..., None]
            s = wide_distance * nodes.share
            at_end = branch.mean_resistance(wide_distance, turn_moment[..., None], wide_q)
            root = np.ones_like(s)
            excess = at_end - branch.mean_resistance(s, turn_moment[..., None], wide_q)
            if not np.any(drag):
                root = np.sqrt(1 + 2 * excess / (wide_distance - s))
                break
            for _ in range(_MAX_DRAG_ITERATIONS):
                whole = ((nodes.sin2 * root) @ nodes.weight)[..., None]
                by_drag = wide_q["drag"] * (0.25 * wide_distance) * (whole - root @ nodes.work_per_share.T)
                new = np.sqrt(1 + 2 * (excess + by_drag) / (wide_distance - s))
                converged = not np.any(np.abs(new - root) > 1e-14)
                root = new
                if converged:
                    break
            before = drag_work
            drag_work = (nodes.sin2 * root) @ nodes.weight
            if not np.any(np.abs(drag_work - before) > 1e-14):
                break
        following = 2 * radius - amplitude
        stuck = ~(following > 0)
        following = np.where(stuck, np.nan, following)
        duration = (1 / root) @ nodes.weight / (2 * np.pi)
        return following, duration, branch.resistance(2 * radius, turn_moment, q)


# a search tries values whose quotients overflow; rows that are not finite are left out
@np.errstate(all="ignore")
def _table(
    branch: Branch, names: Sequence[str], parameters: Floats, highest: float, lowest: float
) -> SwingTable | None:
    """The law's table (`Law.table`)."""
    steps = max(_FEWEST, ceil(_PER_OCTAVE * log(highest / lowest, 2)))
    step = log(highest / lowest) / steps
    log_a = log(lowest) + step * np.arange(-_BEYOND, steps + 1 + _BEYOND, dtype=np.float64)
    count = len(parameters)
    sets = np.repeat(parameters[None, :], 2 * count + 1, axis=0)
    change: Floats = _RELATIVE_STEP * np.maximum(np.abs(parameters), 1e-3)
    for k in range(count):
        sets[1 + k, k] += change[k]
        sets[1 + count + k, k] -= change[k]
    q: Arrays = {name: sets[:, [k]] for k, name in enumerate(names)}
    amplitude = np.repeat(np.exp(log_a)[None, :], len(sets), axis=0)
    steady = branch.at_reversal(amplitude, q)
    turn_moment = steady
    for is_first in (True, False):
        following, duration, next_turn_moment = _half_swing(branch, amplitude, turn_moment, q)
        if is_first:
            # the moment at the next reversal is linear in the moment at this one
            distance = amplitude + following
            fading = (branch.resistance(distance, 0.0 * turn_moment, q) - next_turn_moment) / turn_moment
            correction = (next_turn_moment / branch.at_reversal(following, q) - 1) / (1 + fading)
            turn_moment = steady * (1 + _on_grid(log_a, np.log(following), correction))
    ratio = following / amplitude
    by = [(one[1 : 1 + count] - one[1 + count :]) / (2 * change[:, None]) for one in (ratio, duration)]
    return SwingTable.of(log_a, np.concatenate([ratio[:1], duration[:1], *by]), _FEWEST, _BEYOND)


def _on_grid(log_a: Floats, at: Floats, values: Floats) -> Floats:
    """Values at places `at`, one row a parameter set, interpolated linearly to `log_a`; 0 where unknown."""
    out = np.zeros_like(values)
    for row in range(len(values)):
        known = np.isfinite(at[row]) & np.isfinite(values[row])
        if known.sum() > 1:
            x, y = at[row][known], values[row][known]
            out[row] = np.interp(log_a, x, y)
            beyond = log_a > x[-1]
            out[row][beyond] = y[-1] + (y[-1] - y[-2]) / (x[-1] - x[-2]) * (log_a[beyond] - x[-1])
    return out


def branch_law(
    name: str,
    title: str,
    source: str,
    parameters: Sequence[Parameter],
    branch: Branch,
    scalings: Mapping[str, Scaling],
    valley_coordinates: ValleyCoordinates,
    propose_starts: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
) -> Law:
    """The law with memory of a branch; see `Coordinates` for `scalings`, `valley_coordinates` and
    `propose_starts`. The linear
    drag of `DRAG` may be one of the parameters.
    """
    own = tuple(p.key for p in parameters if p.key not in (PERIOD, DRAG.key))

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        return branch.moments(phi_rad, direction, {key: np.asarray(values[key]) for key in own}, pendulum)

    return Law(
        name=name,
        title=title,
        source=source,
        parameters=tuple(parameters),
        branch_moments=moments,
        table=partial(_table, branch, (*own, "drag", "reference", "rho")),
        columns=partial(
            Coordinates,
            parameters=parameters,
            scalings=scalings,
            valley_coordinates=lambda _: valley_coordinates,
            propose_starts=propose_starts,
        ),
    )
