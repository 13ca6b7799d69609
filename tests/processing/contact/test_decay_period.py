"""Eqs. 5 and 6 agree with direct quadrature, their limits, and each other."""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.contact.asymptotic import decay_path, period
from processing.contact.law import ContactParameters
from tests.processing.fit.decays import ARCSEC, paper_pair


def by_quadrature(low: float, high: float, b: float, p: float, c: float, period_s: float) -> float:
    """Eq. 5 by Gauss-Legendre in the logarithm of the amplitude, 40 panels of 60 nodes."""
    x, w = np.polynomial.legendre.leggauss(60)
    edges = np.linspace(np.log(low), np.log(high), 41)
    half = np.diff(edges)[:, None] / 2
    u = (edges[:-1, None] + edges[1:, None]) / 2 + half * x
    return float(period_s / 4 * np.sum(half * w * np.exp(u) / (c + b / (p + 1) * np.exp(p * u))))


@pytest.mark.parametrize("p", [0.0, 0.1, 0.944, 1 - 1e-12, 1.0, 3.0])
@pytest.mark.parametrize(("b", "c"), [(4e-3, 1e-3), (4e-3, 1e-9), (1e-6, 1e-3), (4e-3, 0.0)])
def test_a_path_without_drag_takes_the_time_of_the_integral(p: float, b: float, c: float) -> None:
    start = 3.0
    s = np.linspace(0.0, 2.0 * start / (c + b * start**p), 20)
    path, _ = decay_path(s, start, b / (p + 1), p, c, 0.0)
    late = path > 1e-3
    assert np.count_nonzero(late) > 5
    taken = [by_quadrature(x, start, b, p, c, 4.0) for x in path[late].tolist()]
    np.testing.assert_allclose(taken[1:], s[late][1:], rtol=1e-10)


def test_derivatives_of_a_path_with_drag_are_those_of_differences() -> None:
    s = np.concatenate([np.linspace(0, 200, 60), [400.0]])
    values = np.array([3.0, 4e-3, 0.9, 1e-3, 2e-3])
    _, gradient = decay_path(s, *values)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6 * values[i]
        up = decay_path(s, *(values + step))[0]
        down = decay_path(s, *(values - step))[0]
        np.testing.assert_allclose(
            gradient[:, i], (up - down) / (2 * step[i]), rtol=1e-6, atol=1e-7 * np.abs(gradient[:, i]).max()
        )


def test_constant_friction_ends_the_path_at_rest() -> None:
    """In finite time."""
    start, c = 3.0, 1e-3
    s = np.array([0.0, 0.5, 0.9, 1.001, 2.0]) * start / c
    path, _ = decay_path(s, start, 0.0, 1.0, c, 0.0)
    np.testing.assert_allclose(path, [3.0, 1.5, 0.3, np.nan, np.nan], rtol=1e-12)


def averaged_frequency_drop(
    alpha: NDArray[np.float64], n: float, kappa: float, rho: float
) -> NDArray[np.float64]:
    """First average of Eq. 3 over a swing, by quadrature: what Eq. 6 has in closed form."""
    theta, w = np.polynomial.legendre.leggauss(400)
    theta, w = np.pi / 4 * (theta + 1), np.pi / 4 * w
    phi = alpha[:, None] * np.cos(theta)
    moment = kappa * phi ** (n + 1) * (np.pi / 2 - rho * phi)
    # 4 quarters, of which 1/(2 pi a) times moment cos is the relative fall of w0^2, halved
    return np.asarray(0.5 * 4 / (np.pi * alpha) * np.sum(w * moment * np.cos(theta), axis=1))


@pytest.mark.parametrize("n", [0.0, 1e-9, 0.092, 0.552, 1.0])
def test_eq6_is_the_average_of_eq3(n: float) -> None:
    _, pendulum = paper_pair("glass_k8")
    parameters = ContactParameters(1e-3, 0.9, 1e-8, n, 4.0, 3e6)
    alpha = np.geomspace(2, 124, 9) * ARCSEC
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2
    kappa = 2 * parameters.gamma_pa * pendulum.contact_radius_m**2 / weight
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    expected = 4.0 / (1 - averaged_frequency_drop(alpha, n, kappa, rho))
    np.testing.assert_allclose(period(alpha, parameters, pendulum), expected, rtol=1e-10)
