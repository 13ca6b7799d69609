"""The test of the residuals' order keeps its level; correlation widens the covariance as it should."""

import numpy as np
import pytest
import scipy

from processing.fit.exact_result import (
    _u_ratio,
    correlated_covariance,
    neighbours_covariance,
    whiteness,
)


def test_the_chances_are_uniform_for_noise() -> None:
    """Short series, where 20 lags of 60 half-cycles need the weights of Ljung and Box."""
    rng = np.random.default_rng(3)
    found = [whiteness(rng.standard_normal(120)) for _ in range(2000)]
    for chances in ([each.p_amplitude for each in found], [each.p_time for each in found]):
        assert np.mean(chances) == pytest.approx(0.5, abs=0.045)
        assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.02)
    assert found[0].lags == 12
    assert whiteness(rng.standard_normal(400)).lags == 20
    assert np.mean([each.first_amplitude for each in found]) == pytest.approx(0, abs=0.02)


def test_only_the_series_that_is_correlated_is_called_so() -> None:
    rng = np.random.default_rng(4)
    noise, slow = rng.standard_normal(300), scipy.signal.lfilter([0.8], [1, -0.6], rng.standard_normal(300))
    found = whiteness(np.concatenate([noise, slow]))
    assert found.p_amplitude > 0.01
    assert found.p_time < 1e-10
    assert found.first_time == pytest.approx(0.6, abs=0.12)
    assert found.correlated
    assert whiteness(np.concatenate([slow, noise])).correlated
    assert not whiteness(np.concatenate([noise, noise[::-1]])).correlated


def test_one_wild_value_neither_hides_nor_feigns_a_correlation() -> None:
    rng = np.random.default_rng(5)
    slow = scipy.signal.lfilter([0.8], [1, -0.6], rng.standard_normal(200))
    for position in (50, 51):
        slow[position] = 1e4 * (-1) ** position
    assert whiteness(np.tile(slow, 2)).p_amplitude < 1e-6
    calm = rng.standard_normal(200)
    calm[[50, 51]] = 1e4
    assert not whiteness(np.tile(calm, 2)).correlated


def test_too_few_or_exact_residuals_say_nothing() -> None:
    for residuals in (np.arange(8.0), np.zeros(100)):
        found = whiteness(residuals)
        assert np.isnan(found.p_amplitude)
        assert not found.correlated


@pytest.mark.parametrize(("neighbour", "ratio"), [(0.5, 3.0), (0.0, 1.0), (-0.4, 0.43)])
def test_the_widened_covariance_is_the_actual_scatter(neighbour: float, ratio: float) -> None:
    """A constant fitted to noise whose neighbours are alike scatters (1 + rho)/(1 - rho) times as much."""
    rng, count = np.random.default_rng(6), 2000
    jacobian, covariance = np.ones((2 * count, 1)), np.array([[0.5 / count]])
    claimed, means = [], []
    for _ in range(60):
        white = rng.standard_normal((2, count + 100))
        # amplitudes and times alike, as when one cause moves both
        noise = scipy.signal.lfilter([np.sqrt(1 - neighbour**2)], [1, -neighbour], white)[:, 100:]
        claimed.append(correlated_covariance(noise.ravel(), jacobian, covariance, 20)[0, 0])
        means.append(noise.mean())
    assert np.mean(claimed) == pytest.approx(ratio * covariance[0, 0], rel=0.1)
    assert np.var(means) == pytest.approx(ratio * covariance[0, 0], rel=0.6)


@pytest.mark.parametrize("lags", [4, 5, 20])
def test_alternating_residuals_never_make_a_variance_negative(lags: int) -> None:
    """What the weights of the neighbours, falling to nothing at the first one left out, are for."""
    count = 400
    residuals = np.tile([1.0, -1.0], count)
    jacobian = np.repeat([[1.0], [0.0]], count, axis=0)  # a column of the amplitudes
    found = correlated_covariance(residuals, jacobian, np.array([[1 / count]]), lags)[0, 0] * count
    assert 0 <= found < 1.1 / lags


def test_times_of_neighbours_that_are_a_little_alike_widen_and_noise_does_not() -> None:
    """300 half-cycles whose times are alike by 0.2: the test of 20 lags sees it in few of them."""
    rng, count = np.random.default_rng(8), 300
    jacobian = np.concatenate([np.zeros((count, 1)), np.ones((count, 1))])
    covariance = np.array([[1.0 / count]])
    claimed, white_claimed, means, seen = [], [], [], 0
    for _ in range(200):
        amplitudes, step = rng.standard_normal(count), rng.standard_normal(count + 1)
        # neighbours alike by a/(1 + a^2) = 0.2, no others
        a = 0.2087
        times = (step[1:] + a * step[:-1]) / np.hypot(1.0, a)
        found = whiteness(np.concatenate([amplitudes, times]))
        seen += found.correlated
        claimed.append(neighbours_covariance(found, jacobian, covariance)[0, 0])
        means.append(times.mean())
        noise = whiteness(np.concatenate([amplitudes, step[1:]]))
        white_claimed.append(neighbours_covariance(noise, jacobian, covariance)[0, 0])
    assert seen < 60
    assert np.mean(claimed) == pytest.approx(np.mean(np.square(means)), rel=0.25)
    assert np.mean(claimed) > 1.25 / count
    assert np.mean(white_claimed) == pytest.approx(1.0 / count, rel=0.04)
    assert neighbours_covariance(whiteness(np.arange(8.0)), jacobian, covariance) == covariance


def test_what_one_column_leaves_open_hides_no_correlation_of_the_others() -> None:
    rng = np.random.default_rng(7)
    noise = scipy.signal.lfilter([0.8], [1, -0.6], rng.standard_normal((2, 300)), axis=1).ravel()
    jacobian = np.column_stack([np.ones(600), np.zeros(600)])
    covariance = np.diag([1 / 600, np.inf])
    found = whiteness(noise)
    with np.errstate(invalid="raise"):
        by_lags = correlated_covariance(noise, jacobian, covariance, 20)
        by_neighbours = neighbours_covariance(found, jacobian, covariance)
    alone = np.array([[1 / 600]])
    assert by_lags[0, 0] == pytest.approx(correlated_covariance(noise, jacobian[:, :1], alone, 20)[0, 0])
    assert by_neighbours[0, 0] > 1.5 * alone[0, 0]
    # the second value is that of the open column
    np.testing.assert_allclose(_u_ratio(np.eye(2), by_lags, covariance) ** 2, [600 * by_lags[0, 0], 1.0])
