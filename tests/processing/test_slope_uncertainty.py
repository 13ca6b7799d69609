"""The uncertainty of a slope is its scatter, whatever the noise about the line does."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.errors import DataError
from processing.slope_uncertainty import part_means, u_wandering_slope

N = 1000
Noise = Callable[[np.random.Generator], NDArray[np.float64]]


def white(rng: np.random.Generator) -> NDArray[np.float64]:
    return rng.standard_normal(N)


def random_walk(rng: np.random.Generator) -> NDArray[np.float64]:
    return 0.3 * np.cumsum(rng.standard_normal(N)) + rng.standard_normal(N)


def other_slopes_now_and_then(rng: np.random.Generator) -> NDArray[np.float64]:
    """About 20 pieces, each with a slope of its own, of mean zero."""
    new = rng.random(N) < 0.02
    slopes = rng.standard_normal(N)[np.maximum.accumulate(np.where(new, np.arange(N), 0))]
    return 0.1 * np.cumsum(slopes) + rng.standard_normal(N)


@pytest.mark.parametrize(
    ("noise", "least", "most"),
    [(white, 0.6, 1.2), (random_walk, 0.7, 1.4), (other_slopes_now_and_then, 0.6, 1.4)],
)
def test_the_slope_scatters_as_much_as_is_claimed(noise: Noise, least: float, most: float) -> None:
    design = part_means(np.column_stack([np.linspace(-1.0, 1.0, N), np.ones(N)]))
    z = []
    for seed in range(40):
        means = part_means(noise(np.random.default_rng([seed, 3])))
        found = np.linalg.lstsq(design, means, rcond=None)[0]
        z.append(found[0] / u_wandering_slope(design, means - design @ found))
    assert least < np.sqrt(np.mean(np.square(z))) < most


def test_parts_are_means_of_all_samples() -> None:
    values = np.random.default_rng(1).standard_normal((130, 2))
    means = part_means(values)
    assert means.shape == (64, 2)
    np.testing.assert_allclose(means[0], values[:2].mean(axis=0))
    assert len(part_means(np.arange(10.0))) == 10


def test_a_line_through_all_means_has_no_uncertainty_and_too_few_have_none() -> None:
    design = np.column_stack([np.arange(20.0), np.ones(20)])
    assert u_wandering_slope(design, np.zeros(20)) == 0.0
    with pytest.raises(DataError, match="9 means for 2 coefficients; 10 are needed"):
        u_wandering_slope(design[:9], np.zeros(9))
