"""The least-squares layer on NIST's Statistical Reference Datasets, and where the data determine little."""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.least_squares import solve
from tests.processing.fit.nist import NAMES, dataset, digits, fitted

ON_A_PLATEAU = ("MGH17", 1)
"""From its far start the search creeps along a bent valley and ends where 60 evaluations gain little, though
some 900 reach the minimum. The linear model promises 10 there, in units of what a residual adds to chi2/2. On
plateaus of runs that determine little (`test_identifiability`) it promises 2 to 2.5, and all evaluations gain
none of it: a search that went on for what is promised would end those fits without a result.
"""
ROUNDED = "Lanczos1"
"""Its residuals are the rounding of the data: nothing that follows from their sum has more digits."""


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_certified_values_and_standard_errors(name: str, start: int) -> None:
    data = dataset(name)
    solution = fitted(data, start)
    assert solution.converged, solution.message
    if (name, start) == ON_A_PLATEAU:
        assert solution.chi2 > 1.2 * data.residual_sum
        return
    assert digits(solution.values, data.certified) > 6
    # the data come without uncertainties: their scatter about the curve gives the scale
    errors = np.sqrt(np.diag(solution.covariance) * solution.chi2 / solution.dof)
    assert digits(errors, data.standard_error) > (2 if name == ROUNDED else 6)
    assert digits(np.array([solution.chi2]), np.array([data.residual_sum])) > (2 if name == ROUNDED else 9)


def test_all_of_them_are_here() -> None:
    assert len(NAMES) == 27


def test_a_direction_without_information_has_infinite_variance() -> None:
    x = np.linspace(0, 1, 20)

    def model(values: NDArray) -> tuple[NDArray, NDArray]:
        # the first two appear only as their sum
        return values[0] + values[1] + values[2] * x - 3 * x, np.column_stack([x**0, x**0, x])

    solution = solve(model, np.array([1.0, 2.0, 0.0]))
    variance = np.diag(solution.covariance)
    assert np.isinf(variance[0])
    assert np.isinf(variance[1])
    assert variance[2] == pytest.approx(1 / np.sum((x - x.mean()) ** 2), rel=1e-9)


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_a_robust_loss_states_its_own_scatter(loss: str) -> None:
    """Over seeded repetitions with one wild point in twenty, the stated u is the scatter seen."""
    rng = np.random.default_rng(11)
    x = np.linspace(-1, 1, 100)
    jacobian = np.column_stack([x**0, x])
    found, stated = [], []
    for _ in range(200):
        y = rng.standard_normal(100)
        wild = rng.random(100) < 0.05
        y[wild] += rng.choice([-1, 1], wild.sum()) * 20

        def model(values: NDArray, y: NDArray = y) -> tuple[NDArray, NDArray]:
            return jacobian @ values - y, jacobian

        solution = solve(model, np.zeros(2), loss=loss)  # type: ignore[arg-type]
        found.append(solution.values)
        stated.append(np.sqrt(np.diag(solution.covariance)))
    # a standard deviation from 200 draws is known to 5 %; three of those
    np.testing.assert_allclose(np.mean(stated, axis=0), np.std(found, axis=0), rtol=0.15)
    assert np.all(np.abs(np.mean(found, axis=0)) < 3.5 * np.std(found, axis=0) / np.sqrt(200))
