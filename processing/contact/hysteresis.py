"""Half-cycles of a law with hysteresis, whose moment depends on the last reversal.

With L(s), the mean resistance (over m g R) over the distance s = r (1 - cos theta) from a reversal at the
amplitude A, the next reversal lies at s = 2 r with ``A - r = L(2r)``. The half-cycle lasts
``integral dtheta / (2 pi sqrt(G))`` in units of T0 with ``G = 1 + 2 [L(2r) - L(s)] / (2r - s)``; the
substitution theta = pi w^3 smooths fractional powers of s at both ends. A linear drag adds
``drag r^2 integral sin^2 sqrt(G) dtheta`` to the work. The moment at a reversal is that of a closed loop of
this amplitude, corrected by the moment at the end of a branch, since amplitudes fall slowly.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from math import ceil, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.coordinates import Coordinates, Scaling, StartProposal, ValleyCoordinates
from processing.contact.half_cycle_table import HalfCycleTable
from processing.contact.law import DRAG, PERIOD, BranchMoments, Law, Parameter, PendulumOnBall, weight_moment

Arrays = Mapping[str, Floats]

_DRAG = "drag"
"""Key of the drag over 1/w0 among the parameters q."""
_NODES = 24
"""Nodes of a half-cycle; decays by smooth laws then agree with an integration of their motion to 3e-7."""
_AMPLITUDES_PER_OCTAVE, _EXTRA_AMPLITUDES, _MIN_AMPLITUDES = 12, 1, 4
"""Numbers of amplitudes of a table: in each factor of two, beyond either end of the range, and at least."""
_RELATIVE_STEP = 1e-5
"""Relative step of the numerical derivatives with respect to the parameters."""
_MAX_WORK_ITERATIONS, _MAX_NEWTON_ITERATIONS, _MAX_SPEED_ITERATIONS = 12, 20, 20
"""Most iterations of a drag's work, of the next reversal, and of the speed with a drag; mostly 5, 5 and 6 are
needed. A search also tries values for which one amplitude of many never converges: all would wait for it."""


class Branch(NamedTuple):
    """The contact's moment over m g R from one reversal to the next, as functions of arrays.

    In a decay only the last reversal matters. Angles are in units of a reference, which divides moments, too.
    The parameters q by key include ``reference``, the unit of angles in rad.
    """

    resistance: Callable[[Floats, Floats, Arrays], Floats]
    """Moment against the motion, negative if the contact pushes: function of the distance from the reversal,
    the moment there, and q."""
    mean_resistance: Callable[[Floats, Floats, Arrays], Floats]
    """Mean of `resistance` over the distance, a function of the same."""
    reversal_moment: Callable[[Floats, Arrays], Floats]
    """Moment at a reversal of an oscillation of constant amplitude: function of amplitude and q."""
    constant: str = ""
    """Key of an additional constant friction without memory; empty if there is none."""

    def moments(
        self, phi_rad: Floats, direction: Floats, values: Arrays, pendulum: PendulumOnBall
    ) -> BranchMoments:
        """Moments over a closed loop between the largest deflection and its opposite: the mean resistance of
        both directions is friction, half their difference is the elastic moment."""
        amplitude = np.max(np.abs(phi_rad), axis=-1, keepdims=True)
        q = {**values, "reference": np.ones(())}
        # a fit may leave a parameter so small that its quotients overflow
        with np.errstate(all="ignore"):
            turn_moment = self.reversal_moment(amplitude, q)
            falling = self.resistance(amplitude - phi_rad, turn_moment, q)
            rising = self.resistance(amplitude + phi_rad, turn_moment, q)
        weight = weight_moment(pendulum)
        friction = 0.5 * (falling + rising)
        if self.constant:
            friction = friction + q[self.constant]
        return BranchMoments(-weight * np.sign(direction) * friction, 0.5 * weight * (falling - rising))


def masing_branch(
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
    """Gauss-Legendre nodes of w with theta = pi w^3."""

    distance_fraction: Floats
    """s / 2r."""
    sin_square: Floats
    weight: Floats
    """Weights for integration over theta."""
    drag_work_matrix: Floats
    """Maps sqrt(G) at the nodes to ``integral_0^theta sin^2 sqrt(G) dtheta'`` over `distance_fraction`. Only
    the root is interpolated, so that no digits are lost near the reversal."""


@lru_cache(maxsize=1)
def _nodes() -> _QuadraturePoints:
    x, weight_x = np.polynomial.legendre.leggauss(_NODES)
    w, weight_w = (x + 1) / 2, weight_x / 2
    distance_fraction = np.sin(np.pi / 2 * w**3) ** 2
    legendre = np.polynomial.legendre.legvander(x, _NODES - 1)
    to_coefficients = (2 * np.arange(_NODES) + 1)[:, None] / 2 * legendre.T * weight_x
    nested_w = w[:, None] * w
    weights = w[:, None] * weight_w * np.sin(np.pi * nested_w**3) ** 2 * 3 * np.pi * nested_w**2
    interpolated = np.polynomial.legendre.legvander(2 * nested_w - 1, _NODES - 1) @ to_coefficients
    return _QuadraturePoints(
        distance_fraction,
        np.sin(np.pi * w**3) ** 2,
        3 * np.pi * w**2 * weight_w,
        np.einsum("kj,kjm->km", weights, interpolated) / distance_fraction[:, None],
    )


def _half_cycle(
    branch: Branch, amplitude: Floats, turn_moment: Floats, q: Arrays
) -> tuple[Floats, Floats, Floats]:
    """Next amplitude, duration (T0) and moment at the next reversal, (sets, amplitudes) for parameters
    (sets, 1); NaN where the pendulum sticks."""
    nodes = _nodes()
    drag, constant = q[_DRAG], q[branch.constant] if branch.constant else 0.0
    radius, drag_work = amplitude.copy(), np.zeros_like(amplitude)  # work of the drag over drag r^2
    q_at_nodes = {key: value[..., None] for key, value in q.items()}
    with np.errstate(all="ignore"):
        for _ in range(_MAX_WORK_ITERATIONS):
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
            last_distance = 2 * radius[..., None]
            s = last_distance * nodes.distance_fraction
            excess = branch.mean_resistance(
                last_distance, turn_moment[..., None], q_at_nodes
            ) - branch.mean_resistance(s, turn_moment[..., None], q_at_nodes)
            if not np.any(drag):
                root = np.sqrt(1 + 2 * excess / (last_distance - s))
                break
            root = np.ones_like(s)
            for _ in range(_MAX_SPEED_ITERATIONS):
                total_work = ((nodes.sin_square * root) @ nodes.weight)[..., None]
                work_left = total_work - root @ nodes.drag_work_matrix.T
                drag_excess = q_at_nodes[_DRAG] * (0.25 * last_distance) * work_left
                last_root, root = root, np.sqrt(1 + 2 * (excess + drag_excess) / (last_distance - s))
                if not np.any(np.abs(root - last_root) > 1e-14):
                    break
            last_drag_work, drag_work = drag_work, (nodes.sin_square * root) @ nodes.weight
            if not np.any(np.abs(drag_work - last_drag_work) > 1e-14):
                break
        next_amplitude = 2 * radius - amplitude
        next_amplitude = np.where(next_amplitude > 0, next_amplitude, np.nan)
        duration = (1 / root) @ nodes.weight / (2 * np.pi)
        return next_amplitude, duration, branch.resistance(2 * radius, turn_moment, q)


# a search tries values whose quotients overflow; rows that are not finite are left out
@np.errstate(all="ignore")
def _table(
    branch: Branch, names: Sequence[str], parameters: Floats, highest: float, lowest: float
) -> HalfCycleTable | None:
    """The table of a law (`TableMaker`), with derivatives by central differences."""
    steps = max(_MIN_AMPLITUDES, ceil(_AMPLITUDES_PER_OCTAVE * log(highest / lowest, 2)))
    step = log(highest / lowest) / steps
    log_a = log(lowest) + step * np.arange(-_EXTRA_AMPLITUDES, steps + 1.0 + _EXTRA_AMPLITUDES)
    count = len(parameters)
    sets = np.repeat(parameters[None, :], 2 * count + 1, axis=0)
    change: Floats = _RELATIVE_STEP * np.maximum(np.abs(parameters), 1e-3)
    for k in range(count):
        sets[1 + k, k] += change[k]
        sets[1 + count + k, k] -= change[k]
    q: Arrays = {name: sets[:, [k]] for k, name in enumerate(names)}
    amplitude = np.repeat(np.exp(log_a)[None, :], len(sets), axis=0)
    steady = branch.reversal_moment(amplitude, q)
    next_amplitude, _, end_moment = _half_cycle(branch, amplitude, steady, q)
    # the moment at the next reversal is linear in the moment at this one
    decay = (branch.resistance(amplitude + next_amplitude, 0.0 * steady, q) - end_moment) / steady
    correction = (end_moment / branch.reversal_moment(next_amplitude, q) - 1) / (1 + decay)
    turn_moment = steady * (1 + _on_grid(log_a, np.log(next_amplitude), correction))
    next_amplitude, duration, _ = _half_cycle(branch, amplitude, turn_moment, q)
    ratio = next_amplitude / amplitude
    gradients = [
        (quantity[1 : 1 + count] - quantity[1 + count :]) / (2 * change[:, None])
        for quantity in (ratio, duration)
    ]
    rows = np.concatenate([ratio[:1], duration[:1], *gradients])
    return HalfCycleTable.of(log_a, rows, _MIN_AMPLITUDES, _EXTRA_AMPLITUDES)


def _on_grid(log_a: Floats, log_x: Floats, values: Floats) -> Floats:
    """Values at `log_x`, one row a parameter set, interpolated linearly to `log_a`; 0 where unknown."""
    out = np.zeros_like(values)
    for row in range(len(values)):
        known = np.isfinite(log_x[row]) & np.isfinite(values[row])
        if known.sum() > 1:
            x, y = log_x[row][known], values[row][known]
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
    propose_starts: StartProposal,
) -> Law:
    """The law with hysteresis of a branch; `Coordinates` describes the last three arguments."""
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
        table=partial(_table, branch, (*own, _DRAG, "reference", "rho")),
        coordinates=partial(
            Coordinates,
            parameters=parameters,
            scalings=scalings,
            valley_coordinates=lambda _: valley_coordinates,
            propose_starts=propose_starts,
        ),
    )
