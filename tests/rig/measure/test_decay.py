"""What is drawn of a fit while the run goes on: half-cycles beside the law, and what it leaves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rig.measure.posterior_worker import MeasuredRun, fitted_points
from tests.rig.measure.test_measured_run import PENDULUM, how, measured


def test_a_fit_is_drawn_at_its_half_cycles_and_leaves_their_scatter() -> None:
    swings, samples = measured()
    run = MeasuredRun()
    run.take(swings[:120], samples)
    fit_of = how(swings[:120], samples)
    stand, fit = run.fitted(fit_of)
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


def test_a_long_run_is_thinned() -> None:
    swings, samples = measured()
    run = MeasuredRun()
    run.take(swings[:120], samples)
    fit_of = how(swings[:120], samples)
    stand, fit = run.fitted(fit_of)
    many = [replace(swing, index=k) for k, swing in enumerate(stand * 6)]
    drawn = fitted_points(many, fit_of.points(many), fit, PENDULUM)
    assert 0 < len(drawn) <= 300
