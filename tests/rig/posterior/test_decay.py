"""What is drawn of a fit while the run goes on: half-cycles beside the law, and what it leaves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rig.posterior.worker import MeasuredRun, fitted_decay
from tests.rig.posterior.test_measured_run import PENDULUM, how, measured


def test_a_fit_is_drawn_at_its_half_cycles_and_leaves_their_scatter() -> None:
    swings, samples = measured()
    run = MeasuredRun()
    run.take(swings[:120], samples)
    fit_of = how(swings[:120], samples)
    stand, fit = run.fitted(fit_of)
    points = fit_of.points(stand)
    drawn = fitted_decay(stand, points, fit, PENDULUM)
    assert list(drawn.turn_times_ns) == [swing.turn_time_ns for swing in stand if not swing.flags]
    again = np.array(drawn.fitted_rad) + np.array(drawn.amplitude_residual) * points.u_amplitude
    np.testing.assert_allclose(again, points.amplitude, rtol=1e-12)
    assert all(later < earlier for earlier, later in pairwise(drawn.fitted_rad)), "a free decay"
    assert len(drawn.period_times_ns) == len(drawn.turn_times_ns) - 2
    # the ground moves it more than the reading of a turning point is uncertain, by less than tens of u
    for left in (drawn.amplitude_residual, drawn.period_residual):
        assert 0.5 < np.std(left) < 30.0
        assert abs(np.mean(left)) < np.std(left)


def test_a_long_run_is_thinned() -> None:
    swings, samples = measured()
    run = MeasuredRun()
    run.take(swings[:120], samples)
    fit_of = how(swings[:120], samples)
    stand, fit = run.fitted(fit_of)
    many = [replace(swing, index=k) for k, swing in enumerate(stand * 6)]
    drawn = fitted_decay(many, fit_of.points(many), fit, PENDULUM)
    assert 0 < len(drawn.turn_times_ns) <= 300
