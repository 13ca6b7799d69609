"""Terms beside a law, against generalised least squares written out with dense matrices."""

from dataclasses import replace

import numpy as np
import pytest

from processing.arrays import Floats
from processing.errors import DataError
from processing.fit import LinearisedFit, Term, fit_exact
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.terms import RestrictedLikelihood, solve
from tests.processing.fit.decays import decay, paper_pair

ROWS, LAW = 60, 4
PRIOR = np.array([0.3, 2.0, 0.01])
Linear = tuple[Floats, Floats, Floats]


@pytest.fixture
def linear() -> Linear:
    """Residuals, their Jacobian of a law's coordinates of very different sizes, and that of terms."""
    rng = np.random.default_rng(5)
    jacobian = rng.standard_normal((ROWS, LAW)) * [1.0, 1e6, 1e-4, 1.0]
    return 1.3 * rng.standard_normal(ROWS), jacobian, rng.standard_normal((ROWS, 3))


def dense(residuals: Floats, jacobian: Floats, columns: Floats, prior: Floats) -> tuple[Floats, ...]:
    """The law's change and its covariance, the coordinates and theirs, and -2 ln L by REML."""
    v = np.linalg.inv(np.eye(ROWS) + (columns * prior**2) @ columns.T)
    covariance = np.linalg.inv(jacobian.T @ v @ jacobian)
    moved = -covariance @ jacobian.T @ v @ residuals
    left = residuals + jacobian @ moved
    gain = -(columns * prior**2).T @ v
    hat = v - v @ jacobian @ covariance @ jacobian.T @ v
    own = np.diag(prior**2) - (columns * prior**2).T @ hat @ (columns * prior**2)
    deviance = np.linalg.slogdet(jacobian.T @ v @ jacobian)[1] - np.linalg.slogdet(v)[1] + left @ v @ left
    return moved, covariance, gain @ left, own, np.asarray(deviance)


def test_terms_are_those_of_generalised_least_squares(linear: Linear) -> None:
    residuals, jacobian, columns = linear
    moved, covariance, values, own, deviance = dense(residuals, jacobian, columns, PRIOR)
    found = solve(
        residuals, jacobian, [Term("one", columns[:, 0], 0.3), Term("two", columns[:, 1:], PRIOR[1:])]
    )
    np.testing.assert_allclose(found.values, values, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, own, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.law_shift, moved, rtol=1e-9)
    by = found.law_by_terms @ found.root
    law = np.linalg.inv(jacobian.T @ jacobian) + by @ by.T
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(law / size, covariance / size, atol=1e-9)
    restricted = RestrictedLikelihood(residuals, jacobian, [columns[:, :1], columns[:, 1:2], columns[:, 2:]])
    assert restricted.deviance(PRIOR) == pytest.approx(float(deviance), rel=1e-9)
    for group, size in enumerate(PRIOR):
        tried = restricted.deviances(PRIOR, group, np.array([0.0, size]))
        assert tried[1] == pytest.approx(float(deviance), rel=1e-9)
        without = np.where(np.arange(3) == group, 0.0, PRIOR)
        assert tried[0] == pytest.approx(restricted.deviance(without), rel=1e-9)
    np.testing.assert_allclose(restricted.unexplained(PRIOR), found.residuals, atol=1e-9)


def test_what_nothing_determines_is_infinite_and_what_is_known_stays(linear: Linear) -> None:
    residuals, jacobian, columns = linear
    lost = residuals.copy()
    lost[3] = np.nan
    like_the_law, nothing = jacobian[:, 1] / 1e6, np.zeros(ROWS)
    found = solve(
        lost, jacobian, [Term("known", columns, 0.0), Term("open", np.array([like_the_law, nothing]).T)]
    )
    assert np.all(found.values[:3] == 0.0)
    assert np.all(found.covariance[:3] == 0.0)
    assert found.covariance[4, 4] == np.inf
    assert found.residuals.shape == (ROWS - 1,)


def test_a_fit_with_terms_does_not_ask_for_their_order() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=30)
    at = LinearisedFit.of(points, pendulum, fit_exact(points, pendulum))
    shared = Term("shared", at.residual_changes(amplitude=1e-9 * np.ones((len(points), 1))), 1.0, "cover")
    late = Term("late", at.residual_changes(time_s=1e-3 * points.amplitude[:, None]), 1.0, "cover")
    both = at.solve_terms(shared, late)
    by = at.to_physical @ both.law_by_terms
    fits = [at.with_terms(*terms) for terms in ((shared, late), (late, shared))]
    fits.append(at.fit.with_terms_of(fits[0], "late", "shared"))
    for fit in fits:
        np.testing.assert_array_equal(fit.values, at.fit.values)
        assert set(fit.terms) == {*at.fit.terms, "shared", "late"}
        np.testing.assert_allclose(fit.covariance, fits[0].covariance, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance, at.fit.covariance + by @ both.covariance @ by.T, rtol=1e-9)
        wider = fit.standard_uncertainty / at.fit.standard_uncertainty
        np.testing.assert_allclose(fit.u_inflation, at.fit.u_inflation * wider, rtol=1e-9)
    with pytest.raises(DataError, match="do not determine nothing"):
        at.with_terms(Term("nothing", np.zeros(len(at.residuals))))


def test_an_interval_is_students_and_of_a_factor_where_the_logarithm_is_normal() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=60)
    found = fit_asymptotic(points, pendulum)
    twos = np.full(len(found.values), 2.0)
    fit = replace(found, degrees_of_freedom=10, values=twos, covariance=np.diag(0.125 * twos))
    # tabulated: 97.5 % of Student's t of 10 degrees of freedom
    reach = 0.5 * 2.228139
    assert fit.interval("p") == pytest.approx((2 - reach, 2 + reach))
    assert fit.interval("b") == pytest.approx((2 * np.exp(-reach / 2), 2 * np.exp(reach / 2)))
    assert replace(fit, values=-fit.values).interval("b") == pytest.approx((-2 - reach, -2 + reach))
    changes = np.zeros((len(fit.values), 2))
    changes[0], changes[2] = [1.5, 2.0], [0.0, np.inf]
    by_term = replace(fit, terms={"term": changes}).covariance_by("term")
    assert (by_term[0, 0], by_term[2, 2], by_term[0, 2], by_term[1, 1]) == (6.25, np.inf, 0.0, 0.0)
    # what was held has no uncertainty to be enlarged, what is open stays so
    held = fit.covariance.copy()
    held[1, 1], held[2, 2] = 0.0, np.inf
    wider = replace(fit, covariance=held).with_term("term", np.where(np.isinf(changes), 1.0, changes))
    assert wider.u_inflation is not None
    assert wider.u_inflation[:3] == pytest.approx([np.sqrt(1 + 6.25 / 0.25), 1.0, 1.0])
    assert (wider.covariance[0, 0], wider.covariance[2, 2]) == (6.5, np.inf)
