"""Half-cycles of a run that goes on: measured again as its final analysis does, in bounded memory."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from calibration import Axes
from processing.contact.laws import PAPER
from processing.deflections import Deflections, DeflectionUnit
from processing.fit import DecayFit, FitResult, LinearisedFit, with_discrepancy
from processing.swing import HalfCycle, HarmonicsMeasurement, TurningPointDetector
from processing.units import ARCSEC_RAD
from rig.analysis import evidence_of, refined_half_cycles
from rig.analysis.ambient import FREE_DRAG
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.turning_plane import follow_plane
from rig.measure.posterior_worker import MeasuredRun, fitted_points
from rig.settings import FitSettings
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path

PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)
STEPS = (60, 100)


@cache
def measured(q: float = 1e-9, turn_deg: float = 0.0) -> tuple[list[HalfCycle], Deflections]:
    """Half-cycles and what they were found in: 25 frames a second, 0.02 arcsec.

    On ground that moves, or in a plane that turns by so much in five minutes.
    """
    _, _, path = driven_path(PARAMETERS, PENDULUM, q=q, seed=3, frames_per_s=25.0)
    path = path[: 25 * 220]
    angle, noise = np.radians(turn_deg) * np.linspace(0.0, 1.0, len(path)), 0.02 * ARCSEC_RAD
    seen = np.stack((path * np.sin(angle), path * np.cos(angle)))
    seen += noise * np.random.default_rng(12).standard_normal(seen.shape)
    times_ns, u = np.arange(len(path), dtype=np.int64) * 40_000_000, np.full(len(path), noise)
    samples = Deflections(times_ns, seen[0], seen[1], u, u, DeflectionUnit.RAD)
    return TurningPointDetector().update(samples.times_ns, samples.y, samples.u_y), samples


def fed(
    run: MeasuredRun, half_cycles: list[HalfCycle], samples: Deflections, steps: Sequence[int] = STEPS
) -> FitResult:
    """What is known in the end, fitted in between, too, as the half-cycles come."""
    before, since = 0, int(samples.times_ns[0])
    for count in steps:
        end_ns = half_cycles[count].turn_time_ns
        new = samples.since(since)
        run.take(half_cycles[before:count], new[: int(np.searchsorted(new.times_ns, end_ns))])
        before, since = count, end_ns
        _, fit = run.fitted(how(half_cycles[:count], samples))
    return fit


@cache
def whole() -> tuple[int, FitResult]:
    """How many deflections are kept where all are, and the fit."""
    run = MeasuredRun()
    fit = fed(run, *measured())
    return run.samples, fit


def how(half_cycles: list[HalfCycle], samples: Deflections) -> DecayFit:
    watch = HarmonicsMeasurement(half_cycles)
    watch.update(samples)
    return DecayFit(PENDULUM, evidence=evidence_of(FREE_DRAG, watch.harmonics()))


def test_a_live_fit_is_that_of_the_final_analysis_of_the_same_half_cycles() -> None:
    half_cycles, samples = measured()
    half_cycles = half_cycles[: STEPS[-1]]
    upto = samples[: int(np.searchsorted(samples.times_ns, measured()[0][STEPS[-1]].turn_time_ns))]
    _, live = whole()
    refined = refined_half_cycles(half_cycles, [upto], DeflectionUnit.RAD, PENDULUM, FitSettings())
    assert refined.exact is not None
    assert refined.motion is not None
    fit = how(half_cycles, samples)
    final = with_discrepancy(LinearisedFit.of(fit.points(refined.half_cycles), PENDULUM, refined.exact))
    detected = fit.of(half_cycles)
    moved = 0.0
    for name in PAPER.names(drag=True):
        value, u = final.estimate(name)
        assert live.estimate(name).standard_uncertainty == pytest.approx(u, rel=0.02), name
        assert live.estimate(name).value == pytest.approx(value, abs=0.02 * u), name
        moved = max(moved, abs(detected.estimate(name).value - value) / u)
    # else the half-cycles as they were detected would do
    assert moved > 0.1


def test_a_live_fit_follows_a_plane_of_swing_that_turns_as_the_results_do() -> None:
    half_cycles, samples = measured(q=0.0, turn_deg=6.0)
    live = fed(MeasuredRun(max_samples=3000), half_cycles, samples, STEPS)
    upto = samples[: int(np.searchsorted(samples.times_ns, half_cycles[STEPS[-1]].turn_time_ns))]
    followed = follow_plane(half_cycles[: STEPS[-1]], PassingDeflections([upto], DeflectionUnit.RAD), Axes())
    assert followed.is_turned
    refined = refined_half_cycles(
        followed.half_cycles, followed.deflections, DeflectionUnit.RAD, PENDULUM, FitSettings()
    )
    assert refined.exact is not None
    detected, unfollowed = how(half_cycles, samples).of(half_cycles), 0.0
    for name in PAPER.names(drag=True):
        value, u = refined.exact.estimate(name)
        assert live.estimate(name).value == pytest.approx(value, abs=0.3 * u), name
        unfollowed = max(unfollowed, abs(detected.estimate(name).value - value) / u)
    assert unfollowed > 3.0


def test_deflections_are_let_go_where_there_are_many_and_the_fit_stays() -> None:
    few = MeasuredRun(max_samples=3000)
    bounded = fed(few, *measured())
    every_samples, every = whole()
    assert every_samples > 4500
    assert few.samples < 3500
    for name in PAPER.names(drag=True):
        value, u = every.estimate(name)
        assert bounded.estimate(name).standard_uncertainty == pytest.approx(u, rel=0.1), name
        assert bounded.estimate(name).value == pytest.approx(value, abs=0.25 * u), name


def test_a_fit_is_drawn_at_its_half_cycles_and_leaves_their_scatter() -> None:
    half_cycles, samples = measured()
    run = MeasuredRun()
    run.take(half_cycles[:80], samples)
    fit_of = how(half_cycles[:80], samples)
    stand, fit = run.fitted(fit_of)
    points = fit_of.points(stand)
    drawn = fitted_points(stand, points, fit, PENDULUM)
    assert [one.turn_time_ns for one in drawn] == [h.turn_time_ns for h in stand if not h.flags]
    fitted, left = np.array([(one.amplitude_rad, one.amplitude_residual) for one in drawn]).T
    left_of_period = np.array([one.period_residual for one in drawn[1:-1]])
    again = fitted + left * points.u_amplitude
    np.testing.assert_allclose(again, points.amplitude, rtol=1e-12)
    assert all(later < earlier for earlier, later in pairwise(fitted)), "a free decay"
    assert np.isnan([drawn[0].period_s, drawn[-1].period_s]).all()
    # the ground moves it more than the reading of a turning point is uncertain, by less than tens of u
    for residuals in (left, left_of_period):
        assert 0.5 < np.std(residuals) < 30.0
        assert abs(np.mean(residuals)) < np.std(residuals)
    # a long run is thinned
    many = [replace(h, index=k) for k, h in enumerate(stand * 6)]
    assert 0 < len(fitted_points(many, fit_of.points(many), fit, PENDULUM)) <= 300
