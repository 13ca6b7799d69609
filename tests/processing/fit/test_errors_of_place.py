"""Errors that turning points share: what a fit sees of them, and what they add to its uncertainties."""

from dataclasses import replace

import numpy as np
import pytest

from processing.fit import (
    FIXED_PATTERN,
    MEASUREMENT,
    LinearisedFit,
    budgets,
    fit_exact,
    fit_position_errors,
)
from processing.fit.uncertainty import GROUND
from tests.processing.fit.decays import ARCSEC, decay, paper_pair
from tests.processing.fit.test_uncertainty import rig


def test_an_error_that_no_decay_has_is_seen_and_one_that_looks_like_a_decay_is_not() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.01, seed=4, last_arcsec=60.0)
    wave = 0.05 * ARCSEC * np.sin(points.amplitude / (4 * ARCSEC))
    scale = 1e-3 * points.amplitude
    errors = np.column_stack([wave, scale, 1e-9 * wave])
    shifted = replace(points, amplitude=points.amplitude + 0.7 * wave)
    fit = fit_exact(shifted, pendulum)
    told = fit_position_errors(LinearisedFit.of(shifted, pendulum, fit), errors)
    u_wave = np.sqrt(told.covariance[0, 0])
    assert abs(told.values[0] - 0.7) < 4 * u_wave
    assert u_wave < 0.2
    # a scale is all but a decay with other coefficients, and an error below all uncertainties is left alone
    assert told.covariance[1, 1] > 0.5
    assert told.values[2] == 0.0
    assert told.covariance[2, 2] == 1.0
    mended = replace(shifted, amplitude=shifted.amplitude - errors @ told.values)
    better = fit_exact(mended, pendulum, near=fit)
    # what looked like a drive of the ground was the error
    assert fit.ground.seen
    assert not better.ground.seen
    assert better.ground.deviance < fit.ground.deviance - 40

    # c is proportional to the scale of the angles: one of 1e-3 adds what the law does not see of it
    again = fit_exact(points, pendulum)
    of_scale = fit_position_errors(LinearisedFit.of(points, pendulum, again), scale[:, None])
    wider = again.with_term(FIXED_PATTERN, of_scale.of_parameters)
    at = again.names.index("c")
    added = wider.covariance[at, at] - again.covariance[at, at]
    assert np.sqrt(added) == pytest.approx(1e-3 * abs(again.values[at]), rel=0.3)
    np.testing.assert_allclose(
        wider.covariance_by(FIXED_PATTERN), of_scale.of_parameters @ of_scale.of_parameters.T, rtol=1e-9
    )
    lines = {line.source: line.contribution for line in budgets(wider, rig())["c"].sources}
    before = {line.source: line.contribution for line in budgets(again, rig())["c"].sources}
    assert lines[FIXED_PATTERN] == pytest.approx(np.sqrt(added))
    assert lines[MEASUREMENT] == pytest.approx(before[MEASUREMENT])
    assert lines[GROUND] == pytest.approx(before[GROUND])
    assert FIXED_PATTERN not in before
