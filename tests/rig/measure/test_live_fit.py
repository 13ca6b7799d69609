"""The live fit of a record: that of the final analysis of the same half-cycles, and what is drawn of it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from calibration import Axes
from processing.contact.laws import PAPER
from processing.deflections import Deflections, DeflectionUnit
from processing.fit import DecayFit, LinearisedFit, fitted_twice, with_discrepancy
from processing.spot import Spot
from processing.swing import HalfCycle, HarmonicsMeasurement, TurningPointDetector
from processing.units import ARCSEC_RAD
from rig.analysis import evidence_of, refined_half_cycles
from rig.analysis.ambient import FREE_DRAG
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.turning_plane import follow_plane
from rig.instrument import configuration_attachments, pendulum_on_ball
from rig.measure.posterior import RunSoFar, fitted_points
from rig.settings import FitSettings, load_configuration
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.command_line import CONFIGS

PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)
HALF_CYCLES = 120
SPOT = Spot(9.0, 9.0, 0.01, 0.01, 3.0, 3.0, 0.0, 200.0, 8.0, 1.0, 0)
Measured = tuple[list[HalfCycle], Deflections]


def measured(turn_deg: float, q: float) -> Measured:
    """Half-cycles in a plane that turns by so much in five minutes, on ground that moves by `q`.

    With what they were found in: 25 frames a second, 0.02 arcsec.
    """
    _, _, path = driven_path(PARAMETERS, PENDULUM, q=q, seed=3, frames_per_s=25.0)
    path = path[: 25 * 260]
    angle = np.radians(turn_deg) * np.linspace(0.0, 1.0, len(path))
    u = np.full(len(path), 0.02 * ARCSEC_RAD)
    seen = np.stack((path * np.sin(angle), path * np.cos(angle)))
    seen += u * np.random.default_rng(11).standard_normal(seen.shape)
    times_ns = np.arange(len(path), dtype=np.int64) * 40_000_000
    samples = Deflections(times_ns, seen[0], seen[1], u, u, DeflectionUnit.RAD)
    swings = TurningPointDetector().update(samples.times_ns, samples.y, samples.u_y)
    end_ns = swings[HALF_CYCLES].turn_time_ns
    return swings[:HALF_CYCLES], samples[: int(np.searchsorted(times_ns, end_ns))]


@cache
def shaken() -> Measured:
    return measured(0.0, 1e-9)


@cache
def turned() -> Measured:
    return measured(6.0, 0.0)


def how(swings: list[HalfCycle], samples: Deflections) -> DecayFit:
    watch = HarmonicsMeasurement(swings)
    watch.update(samples)
    return DecayFit(PENDULUM, evidence=evidence_of(FREE_DRAG, watch.harmonics()))


@pytest.mark.parametrize(("seen", "at_least"), [(shaken, 0.1), (turned, 3.0)])
def test_a_live_fit_is_that_of_the_final_analysis_of_the_same_half_cycles(
    seen: Callable[[], Measured], at_least: float, tmp_path: Path
) -> None:
    """Measured a second time, in the plane of swing; the half-cycles as detected would not do."""
    swings, samples = seen()
    count = sum(not swing.flags for swing in swings)
    pendulum = [f"pendulum.{name}={getattr(PENDULUM, name)}" for name in ("mass_kg", "ball_radius_m")]
    pendulum.append(f"pendulum.contact_radius_m={PENDULUM.contact_radius_m}")
    config = load_configuration(CONFIGS / "demo.toml", ["fit.drag='open'", *pendulum])
    assert pendulum_on_ball(config) == PENDULUM
    attachments = configuration_attachments(config, Path("none"))
    with RecordWriter(tmp_path / "run.mcap", 10**18, attachments=attachments) as writer:
        for first in range(0, len(samples), 250):
            part = samples[first : first + 250]
            times_ns = part.times_ns.tolist()
            numbers = range(first, first + len(part))
            writer.write_spots(numbers, times_ns, times_ns, [SPOT] * len(part), part)
        for swing in swings:
            writer.write_swing(swing)
    with RecordReader(tmp_path / "run.mcap") as reader:
        run = RunSoFar(reader)
        assert run.wait_for(count)
        assert not run.wait_for(count + 1)
        live = run.fitted()
        # a later fit begins with the one before
        again = run.fitted()
    followed = follow_plane(swings, PassingDeflections([samples], DeflectionUnit.RAD), Axes())
    assert followed.is_turned is (seen is turned)
    refined = refined_half_cycles(
        followed.swings, followed.deflections, DeflectionUnit.RAD, PENDULUM, FitSettings()
    )
    assert refined.exact is not None
    points = how(swings, samples).points(refined.swings)
    final = with_discrepancy(LinearisedFit.of(points, PENDULUM, refined.exact))
    detected, moved = how(swings, samples).of(swings), 0.0
    assert (live.half_cycles, len(live.points)) == (count, len(points.index))
    for name in PAPER.names(drag=True)[:-2]:
        value, u = final.estimate(name)
        for estimate in (live.estimates[name], again.estimates[name]):
            assert estimate.standard_uncertainty == pytest.approx(u, rel=0.02), name
            assert estimate.value == pytest.approx(value, abs=0.02 * u), name
        moved = max(moved, abs(detected.estimate(name).value - value) / u)
    assert moved > at_least


def test_a_fit_is_drawn_at_its_half_cycles_and_leaves_their_scatter() -> None:
    swings, samples = shaken()
    fit_of = how(swings, samples)
    (stand, *_), fit = fitted_twice(swings, [samples], fit_of)
    points = fit_of.points(stand)
    drawn = fitted_points(stand, points, fit, PENDULUM)
    assert [one.turn_time_ns for one in drawn] == [swing.turn_time_ns for swing in stand if not swing.flags]
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
    many = [replace(swing, index=k) for k, swing in enumerate(stand * 6)]
    assert 0 < len(fitted_points(many, fit_of.points(many), fit, PENDULUM)) <= 300
