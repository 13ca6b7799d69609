"""Comparison of laboratories against its definitions and against known truth."""

from math import sqrt

import numpy as np
import pytest

from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import compare_laboratories


def test_laboratories_that_agree_share_the_weighted_mean() -> None:
    values = [Estimate(10.0, 1.0), Estimate(10.5, 0.5), Estimate(9.8, 2.0)]
    found = compare_laboratories("c", values)
    assert found.between_dl == found.between_mp == 0.0
    assert found.mean_dl == pytest.approx(found.weighted)
    u_mean = 1 / sqrt(1 + 4 + 0.25)
    assert found.weighted.standard_uncertainty == pytest.approx(u_mean)
    for value, degree in zip(values, found.degrees, strict=True):
        assert degree.distance == pytest.approx(value.value - found.weighted.value)
        assert degree.expanded == pytest.approx(2 * sqrt(value.standard_uncertainty**2 - u_mean**2))
        assert not degree.differs


def test_equal_uncertainties_give_the_scatter_that_is_left_over_them() -> None:
    """Of equal weights both ways give the variance of the values less that of the measurements."""
    x, u = np.array([1.0, 4.0, 7.0, 9.0]), 0.5
    found = compare_laboratories("c", [Estimate(value, u) for value in x])
    excess = sqrt(np.var(x, ddof=1) - u**2)
    assert found.between_dl == pytest.approx(excess)
    assert found.between_mp == pytest.approx(excess, rel=1e-6)
    assert found.reference.value == pytest.approx(x.mean())
    assert found.p_homogeneous < 1e-6
    assert [degree.differs for degree in found.degrees] == [True, False, False, True]


def test_the_scatter_between_laboratories_is_found_and_the_reference_holds_the_truth() -> None:
    random = np.random.default_rng(4)
    held, between = 0, []
    for _ in range(200):
        u = random.uniform(0.5, 2.0, 12)
        x = 5.0 + random.normal(0.0, 1.5, 12) + random.normal(0.0, u)
        found = compare_laboratories("c", [Estimate(*pair) for pair in zip(x, u, strict=True)])
        # Student's t of eleven degrees of freedom
        held += abs(found.reference.value - 5.0) < 2.2 * found.reference.standard_uncertainty
        between.append([found.between_dl**2, found.between_mp**2])
    assert 180 <= held <= 200
    assert np.sqrt(np.mean(between, axis=0)) == pytest.approx([1.5, 1.5], abs=0.15)


def test_one_laboratory_is_no_comparison() -> None:
    with pytest.raises(DataError, match="at least 2"):
        compare_laboratories("c", [Estimate(1.0, 0.1)])
