"""Moments of the contact without a law: the truth lies in their bands."""

import numpy as np
import pytest

from processing.contact import spline_law
from processing.fit import fit_exact, fit_model_free
from tests.benchmarks.bench_without_law import true_moments
from tests.processing.contact.gradients import assert_gradients
from tests.processing.fit.decays import ARCSEC, decay, paper_pair
from tests.processing.fit.test_vanes import DRAG_S, run_of


@pytest.mark.parametrize("flat", ["glass_k8", "silicon"])
def test_the_truth_lies_in_the_bands(flat: str) -> None:
    parameters, pendulum = paper_pair(flat)
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=20)
    free = fit_model_free(points, pendulum)
    found = free.moments()
    friction, elastic = true_moments(found, parameters, pendulum)
    assert np.all(found.u_friction_n_m < 0.01 * friction)
    assert np.all(np.abs(found.friction_n_m - friction) < 3.5 * found.u_friction_n_m)
    assert np.all(np.abs(found.elastic_n_m - elastic) < 3.5 * found.u_elastic_n_m)
    assert 0.8 < free.fit.chi2_per_dof < 1.25
    # with the period at rest of an exact fit: else 5 % too large, the contact's part being gravity's
    of_eq1 = fit_model_free(points, pendulum, like=fit_exact(points, pendulum)).moments()
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m
    friction = weight * (parameters.c + parameters.b * of_eq1.phi_rad**parameters.p)
    assert np.all(of_eq1.u_friction_n_m < 0.01 * friction)
    assert np.all(np.abs(of_eq1.friction_n_m - friction) < 3.5 * of_eq1.u_friction_n_m)


@pytest.mark.slow
def test_air_is_no_friction_of_the_contact() -> None:
    """Integrated in 1.7 ms of drag, on moving ground, seen by frames: the waveform tells both apart."""
    run = run_of(0.0, 5)
    parameters, pendulum = paper_pair("glass_k8")
    free = fit_model_free(run.points, pendulum, like=run.fit)
    # over the stiffness that is gravity's in the splines' terms
    in_terms = (free.fit.estimate("period0_s").value / parameters.period0_s) ** 2
    drag_s, u_drag_s = free.fit.estimate("drag_s")
    assert abs(drag_s - in_terms * DRAG_S) < 3.5 * u_drag_s < 0.1 * DRAG_S
    found = free.moments()
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m
    friction = weight * (parameters.c + parameters.b * found.phi_rad**parameters.p)
    assert np.all(np.abs(found.friction_n_m - friction) < 3.5 * found.u_friction_n_m)
    # as if there were no air
    blind = fit_model_free(run.points, pendulum).moments(found.phi_rad)
    assert np.mean(blind.friction_n_m / friction) > 1.3
    law = free.moments_of_law(run.fit, found.phi_rad)
    np.testing.assert_allclose(law.friction_n_m, friction, rtol=0.03)


def test_a_fitted_law_is_told_in_the_same_terms() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=2, last_arcsec=60)
    free = fit_model_free(points, pendulum)
    phi_rad = np.array([70.0, 90.0, 110.0]) * ARCSEC
    law = free.moments_of_law(fit_exact(points, pendulum), phi_rad)
    friction, elastic = true_moments(law, parameters, pendulum)
    np.testing.assert_allclose(law.friction_n_m, friction, rtol=1e-3)
    np.testing.assert_allclose(law.elastic_n_m, elastic, rtol=0.03)


@pytest.mark.parametrize("drag", [0.0, 2e-3])
def test_gradients_are_those_of_differences(drag: float) -> None:
    parameters, pendulum = paper_pair("silicon")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=40)
    law, splines = spline_law(points)
    rng = np.random.default_rng(1)
    friction = 1e-3 * (1 + 0.3 * rng.random(splines.friction_count))
    elastic = 3e-3 * rng.random(splines.elastic_count)
    # another reference than the splines' own: the map answers in the one that it is given
    at = np.array([*friction, *elastic, drag, 0.9 * splines.unit_rad, 0.0, 1.3])
    index = np.arange(0, 120, 3)
    # a decay that begins where another has come to goes on as that one does
    whole = law.turning_points(np.array([*at[:-3], splines.unit_rad, 0.0, 1.3]), np.arange(61))
    begun = whole.amplitude[30]
    other = np.array([*friction / begun, *elastic, drag, begun * splines.unit_rad, 0.0, 1.0])
    later = law.turning_points(other, np.arange(31))
    np.testing.assert_allclose(whole.amplitude[30:], begun * later.amplitude, rtol=1e-6)
    np.testing.assert_allclose(np.diff(whole.time[30:]), np.diff(later.time), rtol=1e-6)
    steps = np.full(len(at), 1e-6)
    steps[-3:-1] = 0.0
    # 120 half-swings are rounded to some 1e-14, which the step divides
    assert_gradients(law, at, index, steps, rtol=1e-3, atol=2e-8)
