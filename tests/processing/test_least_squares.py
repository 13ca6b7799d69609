"""Weighted least squares: what is called a minimum, and where the data determine little.

NIST's certified datasets are rows of docs/validation.md, which tests/validation asks for.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.least_squares import solve

Floats = NDArray[np.float64]


def test_a_wall_beyond_which_there_is_no_value_is_no_minimum() -> None:
    """A law whose exponent has a range of its own, which is no box in the columns of the search."""

    def model(values: Floats) -> tuple[Floats, Floats]:
        x = np.linspace(1.0, 2.0, 30)
        jacobian = np.column_stack([x, np.ones_like(x)])
        inside = values.sum() < wall
        return (jacobian @ values - 3 * x) / 0.01 if inside else np.full(30, np.nan), jacobian / 0.01

    wall = 5.0
    free = solve(model, np.array([0.5, 0.0]))
    assert free.converged
    np.testing.assert_allclose(free.values, [3.0, 0.0], atol=1e-6)
    wall = 1.0
    stuck = solve(model, np.array([0.5, 0.0]))
    assert not stuck.converged
    assert stuck.message == "no further step was possible: the model has no value beyond"


def test_a_direction_without_information_has_infinite_variance() -> None:
    x = np.linspace(0, 1, 20)

    def model(values: Floats) -> tuple[Floats, Floats]:
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

        def model(values: Floats, y: Floats = y) -> tuple[Floats, Floats]:
            return jacobian @ values - y, jacobian

        solution = solve(model, np.zeros(2), loss=loss)  # type: ignore[arg-type]
        found.append(solution.values)
        stated.append(np.sqrt(np.diag(solution.covariance)))
    # a standard deviation from 200 draws is known to 5 %; three of those
    np.testing.assert_allclose(np.mean(stated, axis=0), np.std(found, axis=0), rtol=0.15)
    assert np.all(np.abs(np.mean(found, axis=0)) < 3.5 * np.std(found, axis=0) / np.sqrt(200))
