"""The joint fit of several half-cycles: its state, what a prior and a left-out half-cycle do to it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from processing.swing.arc import Arc, HalfCycleSamples, fit_arc, gain_of_more, state_before, state_on_arc
from processing.swing.half_cycle import AMPLITUDE, CENTRE, DRIFT, RATE, SHAPE, STATES, TIME
from processing.swing.term_selection import prior, relative_loss
from processing.swing.waveform import DAMPING

FIRST, RATE_RAD_PER_S, DAMPING_RATIO, CENTRE_PX = 80.0, 1.6, 0.01, 3.0
NOISE_PX = 0.05
TERMS = (AMPLITUDE, TIME, RATE, SHAPE + DAMPING, CENTRE)
HALVES = 6
NO_PRIOR = np.full(STATES, np.inf)


def true_state(half: int) -> np.ndarray:
    """Of the damped sinusoid at its turning point number `half`, at which its clock is zero."""
    lost = DAMPING_RATIO / math.sqrt(1 - DAMPING_RATIO**2)
    state, amplitude = np.zeros(STATES), FIRST * math.exp(-math.pi * lost * half)
    state[[AMPLITUDE, RATE, SHAPE + DAMPING, CENTRE]] = amplitude, RATE_RAD_PER_S, DAMPING_RATIO, CENTRE_PX
    return state


def samples(seed: int, drift_px_per_s: float = 0.0, halves: int = HALVES) -> list[HalfCycleSamples]:
    """Half-cycles of the damped sinusoid from rest at the first turning point, 40 samples each."""
    rng, root = np.random.default_rng(seed), math.sqrt(1 - DAMPING_RATIO**2)
    step_ns = round(math.pi / (RATE_RAD_PER_S * root) * 1e9)
    tau = np.linspace(-0.3, 0.3, 40) * math.pi / RATE_RAD_PER_S
    found = []
    for half in range(halves):
        t = half * step_ns * 1e-9 + tau
        phase = RATE_RAD_PER_S * root * t
        swing = np.exp(-DAMPING_RATIO * RATE_RAD_PER_S * t) * (
            np.cos(phase) + DAMPING_RATIO / root * np.sin(phase)
        )
        value = CENTRE_PX + drift_px_per_s * t + FIRST * swing + NOISE_PX * rng.standard_normal(40)
        found.append(HalfCycleSamples(half * step_ns, (-1) ** half, tau, value, np.full(40, NOISE_PX)))
    return found


def fitted(
    halves: list[HalfCycleSamples],
    mean: np.ndarray | None = None,
    sigma: np.ndarray = NO_PRIOR,
    terms: tuple[int, ...] = TERMS,
) -> Arc:
    start = true_state(0)
    start[[AMPLITUDE, TIME, RATE]] += 3.0, 0.05, 0.02
    arc = fit_arc(start, (start if mean is None else mean, sigma), halves, FIRST, terms)
    assert arc is not None
    return arc


def pulls(x: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Errors over their claimed uncertainties, decorrelated."""
    at = np.ix_(TERMS, TERMS)
    return np.linalg.solve(np.linalg.cholesky(covariance[at]), (x - truth)[list(TERMS)])


def test_states_scatter_as_they_claim_at_every_half_cycle() -> None:
    found = []
    for seed in range(40):
        arc = fitted(samples(seed))
        found += [pulls(*state_on_arc(arc, k), true_state(k)) for k in (0, 3, HALVES - 1)]
        assert arc.samples == 40 * HALVES
    assert np.std(found) == pytest.approx(1.0, abs=0.1)
    assert np.abs(np.mean(found)) < 0.12
    assert arc.reduced_chi2 == pytest.approx(1, abs=0.3)
    assert np.mean(arc.chi2_each[:, 0] / arc.chi2_each[:, 1]) == pytest.approx(arc.reduced_chi2)


def test_windows_are_the_zero_crossings() -> None:
    arc = fitted(samples(1))
    quarter_s = math.pi / 2 / RATE_RAD_PER_S
    assert arc.windows == pytest.approx(np.tile([-quarter_s, quarter_s], (HALVES, 1)), abs=0.02 * quarter_s)
    # damping: the way back from the turning point to zero takes longer than the way there from zero
    assert np.all(arc.windows[:, 1] > -arc.windows[:, 0])


@pytest.mark.parametrize("left_out", [0, 2, HALVES - 1])
def test_a_half_cycle_left_out_is_as_if_it_had_no_samples(left_out: int) -> None:
    halves = samples(2)
    halves[left_out] = replace(halves[left_out], deflection=halves[left_out].deflection + 0.1)
    without = list(halves)
    without[left_out] = replace(halves[left_out], deflection=np.full(40, np.nan))
    arc, other = fitted(halves), fitted(without)
    for k in range(HALVES):
        x, covariance = state_on_arc(arc, k, left_out)
        wanted, wanted_covariance = state_on_arc(other, k)
        u = np.sqrt(np.diag(wanted_covariance))[list(TERMS)]
        assert np.abs(x - wanted)[list(TERMS)] / u == pytest.approx(0, abs=0.02)
        assert np.diag(covariance)[list(TERMS)] == pytest.approx(u**2, rel=0.01)


def test_a_prior_counts_by_its_weight() -> None:
    """With one as certain as the samples the value lies midway, with 1/sqrt(2) of the uncertainty."""
    halves = samples(3)
    # alone, so that nothing correlated moves with it
    arc = fitted(halves, terms=(CENTRE,))
    x, covariance = state_on_arc(arc, 0)
    u = math.sqrt(covariance[CENTRE, CENTRE])
    mean, sigma = x.copy(), NO_PRIOR.copy()
    mean[CENTRE], sigma[CENTRE] = x[CENTRE] + 6 * u, u
    both = fit_arc(x, (mean, sigma), halves, FIRST, (CENTRE,))
    y, narrower = state_on_arc(both, 0)
    assert (y - x)[CENTRE] == pytest.approx(3 * u, rel=1e-6)
    assert narrower[CENTRE, CENTRE] == pytest.approx(u**2 / 2, rel=1e-6)


def test_the_gain_of_a_term_is_foretold() -> None:
    halves = samples(4, drift_px_per_s=0.02)
    arc = fitted(halves)
    terms = (*TERMS, DRIFT)
    more = fitted(halves, terms=terms)
    foretold = gain_of_more(arc, arc.states[0], (arc.states[0], NO_PRIOR), halves, terms)
    assert arc.chi2 - more.chi2 > 50
    assert foretold == pytest.approx(arc.chi2 - more.chi2, rel=0.01)
    # a prior that the drift is nothing forbids it
    sigma = NO_PRIOR.copy()
    sigma[DRIFT] = 1e-9
    assert gain_of_more(arc, arc.states[0], (arc.states[0], sigma), halves, terms) < 1


def test_the_half_cycle_before_is_foretold() -> None:
    """Seen from the second half-cycle on, the first is where it was, half a period earlier."""
    halves = samples(5, drift_px_per_s=0.02)
    arc = fitted(halves[1:], terms=(*TERMS, DRIFT))
    x, covariance, reference_ns = state_before(arc, halves[1].reference_ns)
    assert reference_ns == pytest.approx(0, abs=2e7)
    assert x[AMPLITUDE] == pytest.approx(FIRST, rel=2e-3)
    assert x[CENTRE] == pytest.approx(CENTRE_PX, abs=4 * math.sqrt(covariance[CENTRE, CENTRE]))
    half_period_s = math.pi / RATE_RAD_PER_S
    # it may hold the release or a kick
    assert math.sqrt(covariance[AMPLITUDE, AMPLITUDE]) == pytest.approx(0.1 * FIRST, rel=0.05)
    assert math.sqrt(covariance[TIME, TIME]) == pytest.approx(0.1 * half_period_s, rel=0.02)
    # the drift is known from the later ones: the centre is less certain the further it is away
    assert covariance[CENTRE, CENTRE] > state_on_arc(arc, 0)[1][CENTRE, CENTRE]


def test_before_the_fit_damping_may_cause_all_of_the_loss_but_not_twice_of_it() -> None:
    """At more than all of the loss the friction gives energy: one standard deviation lies between."""
    start = true_state(0)
    _, sigma = prior(start, anharmonic=True)
    widest = start.copy()
    widest[SHAPE + DAMPING] = sigma[SHAPE + DAMPING]
    assert 1 < relative_loss(widest) / relative_loss(start) < 2
