"""Joint least-squares fit of several consecutive half-cycles (an arc) with one state of the pendulum.

The unknown is the state x_1 at the first turning point. The equation of motion carries it from half-cycle
to half-cycle, x_(k+1) = f(x_k), with the transition matrices F_k = dx_k/dx_1. With the derivatives J_k of
the samples by x_k, weights W_k and residuals r_k, half-cycle k contributes to the normal equations in x_1

    information_k = F_k^T J_k^T W_k J_k F_k,   score_k = F_k^T J_k^T W_k r_k.

The arc of the first half-cycles starts the detector. The contributions are stored separately, so that a
half-cycle can be removed from the solution and compared with the prediction by the others.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats, Ints, Matrix, Vector
from processing.kernel import kernel
from processing.swing.half_cycle import (
    AMPLITUDE,
    RATE,
    STATES,
    TIME,
    invert,
    linearise,
    normal_equations,
    propagate,
    tabulate_state,
    tabulated,
)
from processing.swing.small_matrices import copy, times_matrix
from processing.swing.waveform import NODES, SHAPES, zero_phases
from processing.units import nanoseconds, seconds

_MAX_STEPS = 30
_MIN_COST_REDUCTION = 0.1
"""Reduction of the cost (chi-square and prior) by a step below which the fit has converged."""


@dataclass(frozen=True, slots=True)
class HalfCycleSamples:
    """Samples of one half-cycle."""

    reference_ns: int
    side: int
    """+1 or -1, sign of the deflection from the centre at the turning point."""
    tau_s: Floats
    """Times since the reference time."""
    deflection: Floats
    """Deflections; NaN is ignored."""
    u_deflection: Floats
    """Standard uncertainties of the deflections."""


@dataclass(frozen=True, slots=True)
class Arc:
    """Joint fit of m half-cycles in k free entries of the state (see `half_cycle` for the state)."""

    states: Matrix
    """(m, STATES): state at each turning point."""
    transitions: Floats
    """(m, k, k): derivative of each state with respect to the first one, active entries only."""
    information: Floats
    """(m, k, k): information of each half-cycle's samples about the first state."""
    score: Matrix
    """(m, k): score of each half-cycle's samples, by the first state."""
    windows: Matrix
    """(m, 2): start and end of each half-cycle (its zero crossings), s after its reference time."""
    chi2_each: Matrix
    """(m, 2): chi-square and number of samples of each half-cycle."""
    chi2: float
    """Chi-square of all samples; infinite if the motion cannot be followed to the end."""
    prior: Matrix
    """(k, k): information of the prior about the first state."""
    active: Ints
    """(k,): free entries of the state."""
    reference: float
    """Amplitude to which the shape terms refer, unit of the deflection."""

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.chi2_each[:, 1].sum())

    @property
    def reduced_chi2(self) -> float:
        """Chi-square per sample."""
        return self.chi2 / max(self.samples, 1)


@kernel
def _walk_kernel(
    x0: Vector,
    reference: float,
    active: Ints,
    sides: Vector,
    steps: Vector,
    bounds: Ints,
    tau: Vector,
    deflection: Vector,
    u_deflection: Vector,
) -> tuple[Matrix, Floats, Floats, Matrix, Matrix, Matrix, bool]:
    """Normal equations of every half-cycle by the first state `x0`; fields of `Arc` to `chi2_each`, and
    whether the motion goes on. Half-cycle k has the samples from ``bounds[k]``; the next begins ``steps[k]``
    s later."""
    k, halves = len(active), len(sides)
    states = np.empty((halves, STATES))
    transitions, information = np.empty((halves, k, k)), np.empty((halves, k, k))
    scores, windows, chi2_each = np.empty((halves, k)), np.empty((halves, 2)), np.empty((halves, 2))
    table, turn = np.zeros((2 + SHAPES, NODES, 2)), np.zeros((2, 2 + SHAPES))
    own_information, own_score = np.empty((k, k)), np.empty(k)
    active_transition, product = np.empty((k, k)), np.empty((k, k))
    x, from_first = x0.copy(), np.zeros((k, k))
    for m in range(k):
        from_first[m, m] = 1.0
    for half in range(halves):
        i, j = bounds[half], bounds[half + 1]
        for m in range(STATES):
            states[half, m] = x[m]
        copy(from_first, transitions[half])
        tabulate_state(x, x, reference, active, table, turn)
        residual, jacobian = np.empty(j - i), np.empty((j - i, k))
        linearise(x, sides[half], active, table, tau[i:j], deflection[i:j], residual, jacobian)
        weight = np.empty(j - i)
        for sample in range(j - i):
            weight[sample] = 1.0 / u_deflection[i + sample] ** 2
        chi2, count = normal_equations(residual, jacobian, weight, own_information, own_score)
        times_matrix(from_first, own_information, True, product)
        times_matrix(product, from_first, False, information[half])
        for m in range(k):
            scores[half, m] = 0.0
            for n in range(k):
                scores[half, m] += from_first[n, m] * own_score[n]
        chi2_each[half, 0], chi2_each[half, 1] = chi2, count
        before, after = zero_phases(table)
        windows[half, 0], windows[half, 1] = x[TIME] + before / x[RATE], x[TIME] + after / x[RATE]
        x, transition = propagate(x, turn, steps[half])
        finite = math.isfinite(chi2)
        for m in range(STATES):
            finite &= math.isfinite(x[m])
        if not (finite and x[AMPLITUDE] > 0.0):
            return states, transitions, information, scores, windows, chi2_each, False
        for m in range(k):
            for n in range(k):
                active_transition[m, n] = transition[active[m], active[n]]
        times_matrix(active_transition, from_first, False, product)
        copy(product, from_first)
    return states, transitions, information, scores, windows, chi2_each, True


_Samples = tuple[Vector, Vector, Ints, Vector, Vector, Vector]
"""Samples of consecutive half-cycles, concatenated: the last six parameters of `_walk_kernel`."""


def _join(halves: Sequence[HalfCycleSamples]) -> _Samples:
    references = np.array([h.reference_ns for h in halves])
    return (
        np.array([h.side for h in halves], dtype=np.float64),
        seconds(np.append(np.diff(references), 0)),
        np.concatenate([[0], np.cumsum([len(h.tau_s) for h in halves])]).astype(np.int64),
        np.concatenate([h.tau_s for h in halves]),
        np.concatenate([h.deflection for h in halves]),
        np.concatenate([h.u_deflection for h in halves]),
    )


def _walk(x0: Vector, samples: _Samples, reference: float, active: Ints, prior: Matrix) -> Arc:
    """Arc of the motion from the first state `x0`, which need not be the likeliest one."""
    states, transitions, information, score, windows, chi2_each, moving = _walk_kernel(
        x0, reference, active, *samples
    )
    chi2 = float(chi2_each[:, 0].sum()) if moving else math.inf
    return Arc(states, transitions, information, score, windows, chi2_each, chi2, prior, active, reference)


def fit_arc(
    start: Vector,
    expected: tuple[Vector, Vector],
    halves: Sequence[HalfCycleSamples],
    reference: float,
    terms: tuple[int, ...],
) -> Arc | None:
    """Fit the state at the first turning point to the samples of all `halves`, by Gauss-Newton.

    Returns None if no solution is found.

    Parameters
    ----------
    start : (STATES,) start values; entries that are not in `terms` keep them
    expected : mean and standard deviation (STATES,) of a normal prior; inf where there is none
    halves : consecutive half-cycles
    reference : amplitude to which the shape terms refer
    terms : entries of the state that are free
    """
    active = np.array(sorted(terms), dtype=np.int64)
    prior = np.diag(1.0 / expected[1][active] ** 2)
    x = start.copy()
    covariance = np.empty_like(prior)
    samples = _join(halves)
    best_cost, best_x, best_arc = math.inf, x, None
    step, fraction = np.zeros(len(active)), 1.0
    for _ in range(_MAX_STEPS):
        arc = _walk(x, samples, reference, active, prior)
        offset = (expected[0] - x)[active]
        cost = arc.chi2 + float(offset @ prior @ offset)
        if cost < best_cost:
            gain = best_cost - cost
            best_cost, best_x, best_arc = cost, x, arc
            if gain < _MIN_COST_REDUCTION and fraction == 1.0:
                break
            # Gauss-Newton with step halving. Levenberg-Marquardt damping is not used: it would prevent any
            # progress along directions that the samples hardly determine.
            fraction = min(1.0, 4.0 * fraction)
            total = prior + arc.information.sum(axis=0)
            if not invert(total, covariance):
                return None
            step = covariance @ (arc.score.sum(axis=0) + prior @ offset)
        elif best_arc is None:
            return None
        elif cost < best_cost + _MIN_COST_REDUCTION and fraction == 1.0:
            break
        else:
            fraction *= 0.25
        x = best_x.copy()
        x[active] += fraction * step
        if not x[AMPLITUDE] > 0.0 or not x[RATE] > 0.0:
            x = best_x.copy()
            x[active] += 0.1 * fraction * step
    return best_arc


def gain_of_more(
    arc: Arc,
    start: Vector,
    expected: tuple[Vector, Vector],
    halves: Sequence[HalfCycleSamples],
    terms: tuple[int, ...],
) -> float:
    """Estimate by how much chi-square would fall if more `terms` were free (score test, no iteration).

    With the score g and the information H at the present solution, the fall is g^T H^-1 g. `start` is the
    arc's first state with the new terms at values that leave the motion unchanged.
    """
    active = np.array(sorted(terms), dtype=np.int64)
    prior = np.diag(1.0 / expected[1][active] ** 2)
    walk = _walk(start, _join(halves), arc.reference, active, prior)
    score = walk.score.sum(axis=0) + prior @ (expected[0] - start)[active]
    covariance = np.empty_like(prior)
    if not math.isfinite(walk.chi2) or not invert(prior + walk.information.sum(axis=0), covariance):
        return 0.0
    return float(score @ covariance @ score)


def state_on_arc(arc: Arc, k: int, left_out: int | None = None) -> tuple[Vector, Matrix]:
    """State (STATES,) and covariance at half-cycle `k`, optionally without the samples of `left_out`.

    The information and score of half-cycle `left_out` are subtracted from the arc's normal equations.
    """
    total = arc.prior + arc.information.sum(axis=0)
    if left_out is not None:
        total = total - arc.information[left_out]
    first_covariance = np.empty_like(total)
    x = arc.states[k].copy()
    if not invert(total, first_covariance):
        first_covariance[:] = np.linalg.pinv(total)
    if left_out is not None:
        x[arc.active] -= arc.transitions[k] @ (first_covariance @ arc.score[left_out])
    covariance = np.zeros((STATES, STATES))
    covariance[np.ix_(arc.active, arc.active)] = arc.transitions[k] @ first_covariance @ arc.transitions[k].T
    return x, covariance


def state_before(arc: Arc, first_ns: int) -> tuple[Vector, Matrix, int]:
    """Prediction for the half-cycle before the arc: state, covariance and reference time in ns.

    Amplitude and time get wide uncertainties (10 % of the amplitude and of the half period), because that
    half-cycle may hold the release or a kick. `first_ns` is the reference time of the arc's first half-cycle.
    """
    x, covariance = state_on_arc(arc, 0)
    _, turn = tabulated(x, x, arc.reference, arc.active)
    half_period_s = float(turn[0, 0] / x[RATE])
    step_ns = nanoseconds(half_period_s)
    previous, transition = propagate(x, turn, seconds(-step_ns))
    previous[AMPLITUDE] = x[AMPLITUDE] / turn[1, 0]
    previous[TIME] = x[TIME]
    transition[[AMPLITUDE, TIME]] = 0.0
    covariance = transition @ covariance @ transition.T
    covariance[AMPLITUDE, AMPLITUDE] = (0.1 * x[AMPLITUDE]) ** 2
    covariance[TIME, TIME] = (0.1 * half_period_s) ** 2
    return previous, covariance, first_ns - step_ns
