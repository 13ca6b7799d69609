"""Weighted least squares: what is called a minimum."""

import numpy as np
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
