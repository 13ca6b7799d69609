"""Several half-cycles in one least-squares fit, tied together by the motion from one to the next.

The starting point of everything that is followed later, and the way to judge a half-cycle by what
its neighbours say: the fit can be told to forget one of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.swing.half_cycle import (
    AMPLITUDE,
    RATE,
    STATES,
    TIME,
    Indices,
    Matrix,
    Vector,
    invert,
    linearise,
    normal_equations,
    propagate,
    tabulate_state,
)
from processing.swing.waveform import NODES, SHAPES, zero_phases

_STEPS = 30
_SETTLED = 0.1
"""Fall of the cost below which another step is not worth taking."""


@dataclass(frozen=True, slots=True)
class HalfCycleSamples:
    """Samples of one half-cycle; `tau_s` counts from `reference_ns`."""

    reference_ns: int
    side: int
    tau_s: NDArray[np.float64]
    deflection: NDArray[np.float64]
    u_deflection: NDArray[np.float64]


class _Walk(NamedTuple):
    states: Matrix
    transitions: NDArray[np.float64]
    information: NDArray[np.float64]
    score: Matrix
    windows: Matrix
    chi2_each: Matrix
    chi2: float


@dataclass(frozen=True, slots=True)
class Arc:
    """Several half-cycles (m) tied by the motion, in k terms."""

    states: Matrix
    """(m, STATES): state at each."""
    transitions: NDArray[np.float64]
    """(m, k, k): derivative of each state by the first, active entries only."""
    information: NDArray[np.float64]
    """(m, k, k): each half-cycle's own, in terms of the first one's state."""
    score: Matrix
    """(m, k)"""
    windows: Matrix
    """(m, 2): start and end of each half-cycle in s from its reference time."""
    chi2_each: Matrix
    """(m, 2): chi-square and number of samples of each half-cycle."""
    chi2: float
    prior: Matrix
    active: Indices
    reference: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.chi2_each[:, 1].sum())

    @property
    def reduced_chi2(self) -> float:
        """Chi-square per sample."""
        return self.chi2 / max(self.samples, 1)

    @property
    def reduced_chi2_each(self) -> Vector:
        """Chi-square per sample of each half-cycle that has any."""
        seen = self.chi2_each[self.chi2_each[:, 1] > 0]
        return np.asarray(seen[:, 0] / seen[:, 1], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def _walk_kernel(
    x0: Vector,
    reference: float,
    active: Indices,
    sides: Vector,
    steps: Vector,
    bounds: Indices,
    tau: Vector,
    deflection: Vector,
    u_deflection: Vector,
) -> tuple[Matrix, NDArray[np.float64], NDArray[np.float64], Matrix, Matrix, Matrix, bool]:
    """Every half-cycle's equations along the motion that starts from `x0`, in terms of `x0`.

    Half-cycle k has the samples from ``bounds[k]`` to ``bounds[k + 1]``, and is followed by the next
    after ``steps[k]`` s. The last value says whether the motion stayed a motion.
    """
    k, halves = len(active), len(sides)
    states = np.empty((halves, STATES))
    transitions, information = np.empty((halves, k, k)), np.empty((halves, k, k))
    scores, windows, chi2_each = np.empty((halves, k)), np.empty((halves, 2)), np.empty((halves, 2))
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    own, own_score, small = np.empty((k, k)), np.empty(k), np.empty((k, k))
    x, towards = x0.copy(), np.eye(k)
    for half in range(halves):
        i, j = bounds[half], bounds[half + 1]
        states[half], transitions[half] = x, towards
        tabulate_state(x, x, reference, active, table, turn)
        residual, jacobian = np.empty(j - i), np.empty((j - i, k))
        linearise(x, sides[half], active, table, tau[i:j], deflection[i:j], residual, jacobian)
        weight = 1.0 / u_deflection[i:j] ** 2
        chi2, count = normal_equations(residual, jacobian, weight, own, own_score)
        information[half] = towards.T @ own @ towards
        scores[half] = towards.T @ own_score
        chi2_each[half, 0], chi2_each[half, 1] = chi2, count
        before, after = zero_phases(table)
        windows[half, 0], windows[half, 1] = x[TIME] + before / x[RATE], x[TIME] + after / x[RATE]
        x, transition = propagate(x, turn, steps[half])
        if not (math.isfinite(chi2) and np.all(np.isfinite(x)) and x[AMPLITUDE] > 0.0):
            return states, transitions, information, scores, windows, chi2_each, False
        for m in range(k):
            for n in range(k):
                small[m, n] = transition[active[m], active[n]]
        towards = small @ towards
    return states, transitions, information, scores, windows, chi2_each, True


class _Samples(NamedTuple):
    """Half-cycles one after the other, as the kernel wants them."""

    sides: Vector
    steps: Vector
    bounds: Indices
    tau: Vector
    deflection: Vector
    u_deflection: Vector


def _joined(halves: Sequence[HalfCycleSamples]) -> _Samples:
    references = np.array([h.reference_ns for h in halves])
    return _Samples(
        np.array([h.side for h in halves], dtype=np.float64),
        np.append(np.diff(references), 0) * 1e-9,
        np.concatenate([[0], np.cumsum([len(h.tau_s) for h in halves])]).astype(np.int64),
        np.concatenate([h.tau_s for h in halves]),
        np.concatenate([h.deflection for h in halves]),
        np.concatenate([h.u_deflection for h in halves]),
    )


def _walk(x0: Vector, samples: _Samples, reference: float, active: Indices) -> _Walk:
    states, transitions, information, scores, windows, chi2_each, moving = _walk_kernel(
        x0, reference, active, *samples
    )
    chi2 = float(chi2_each[:, 0].sum()) if moving else math.inf
    return _Walk(states, transitions, information, scores, windows, chi2_each, chi2)


def fit_arc(
    start: Vector,
    prior_mean: Vector,
    prior_sigma: Vector,
    halves: Sequence[HalfCycleSamples],
    reference: float,
    terms: tuple[int, ...],
) -> Arc | None:
    """Least squares for the state at the first of `halves`, all half-cycles tied by the motion.

    `prior_sigma` is the width of the prior around `prior_mean` (inf where there is none), `terms`
    are the entries of the state that are free; the others stay as in `start`. Returns None when no
    solution is found.
    """
    active = np.array(sorted(terms), dtype=np.int64)
    prior = np.diag(1.0 / prior_sigma[active] ** 2)
    x = start.copy()
    covariance = np.empty_like(prior)
    samples = _joined(halves)
    best_cost, best_x, best_walk = math.inf, x, None
    step, part = np.zeros(len(active)), 1.0
    for _ in range(_STEPS):
        walk = _walk(x, samples, reference, active)
        offset = (prior_mean - x)[active]
        cost = walk.chi2 + float(offset @ prior @ offset)
        if cost < best_cost:
            gain = best_cost - cost
            best_cost, best_x, best_walk = cost, x, walk
            if gain < _SETTLED and part == 1.0:
                break
            # Gauss-Newton; shortened along its direction only, because a damped step
            # would not move at all in the directions that the samples hardly determine
            part = min(1.0, 4.0 * part)
            total = prior + walk.information.sum(axis=0)
            if not invert(total, covariance):
                return None
            step = covariance @ (walk.score.sum(axis=0) + prior @ offset)
        elif best_walk is None:
            return None
        elif cost < best_cost + _SETTLED and part == 1.0:
            break
        else:
            part *= 0.25
        x = best_x.copy()
        x[active] += part * step
        if not x[AMPLITUDE] > 0.0 or not x[RATE] > 0.0:
            x = best_x.copy()
            x[active] += 0.1 * part * step
    return best_walk and Arc(*best_walk, prior=prior, active=active, reference=reference)


def gain_of_more(
    arc: Arc,
    start: Vector,
    prior_mean: Vector,
    prior_sigma: Vector,
    halves: Sequence[HalfCycleSamples],
    terms: tuple[int, ...],
) -> float:
    """By how much chi-square would fall with more `terms` than the arc has, to first order (score test).

    `start` is the arc's first state with the new terms at values that change nothing.
    """
    active = np.array(sorted(terms), dtype=np.int64)
    prior = np.diag(1.0 / prior_sigma[active] ** 2)
    walk = _walk(start, _joined(halves), arc.reference, active)
    score = walk.score.sum(axis=0) + prior @ (prior_mean - start)[active]
    covariance = np.empty_like(prior)
    if not math.isfinite(walk.chi2) or not invert(prior + walk.information.sum(axis=0), covariance):
        return 0.0
    return float(score @ covariance @ score)


def state_on_arc(arc: Arc, k: int, left_out: int | None = None) -> tuple[Vector, Matrix]:
    """State and covariance at half-cycle `k`, as if half-cycle `left_out` had not been seen."""
    total = arc.prior + arc.information.sum(axis=0)
    if left_out is not None:
        total = total - arc.information[left_out]
    small = np.empty_like(total)
    x = arc.states[k].copy()
    if not invert(total, small):
        small[:] = np.linalg.pinv(total)
    if left_out is not None:
        x[arc.active] -= arc.transitions[k] @ (small @ arc.score[left_out])
    covariance = np.zeros((STATES, STATES))
    covariance[np.ix_(arc.active, arc.active)] = arc.transitions[k] @ small @ arc.transitions[k].T
    return x, covariance


def state_before(arc: Arc, first_ns: int) -> tuple[Vector, Matrix, int]:
    """State, covariance and reference time (ns) one half-cycle before the arc, its own turning point open.

    `first_ns` is the reference time of the arc's first half-cycle.
    """
    x, covariance = state_on_arc(arc, 0)
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    tabulate_state(x, x, arc.reference, arc.active, table, turn)
    half_period = float(turn[0, 0] / x[RATE])
    step_ns = round(half_period * 1e9)
    before, transition = propagate(x, turn, -step_ns * 1e-9)
    before[AMPLITUDE] = x[AMPLITUDE] / turn[1, 0]
    before[TIME] = x[TIME]
    transition[[AMPLITUDE, TIME]] = 0.0
    covariance = transition @ covariance @ transition.T
    covariance[AMPLITUDE, AMPLITUDE] = (0.1 * x[AMPLITUDE]) ** 2
    covariance[TIME, TIME] = (0.1 * half_period) ** 2
    return before, covariance, first_ns - step_ns
