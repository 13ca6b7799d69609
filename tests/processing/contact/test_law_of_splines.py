"""Splines of the contact's moments: their values and works by other means."""

import numpy as np

from processing.contact.law_of_splines import MomentSplines
from processing.units import ARCSEC_RAD


def test_works_are_the_integrals_of_the_moments_down_to_rest() -> None:
    """Below the smallest amplitude, too, where ln x has no end and the work has a closed form."""
    splines = MomentSplines(100 * ARCSEC_RAD, 10 * ARCSEC_RAD, 100 * ARCSEC_RAD)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for x in (0.02, 0.1):
        # x = y^2, so that the logarithm at rest is smooth enough for the quadrature
        y = 0.5 * np.sqrt(x) * (1 + nodes)
        for moment, work_to in (
            (splines.elastic, splines.elastic_work),
            (splines.friction, splines.friction_work),
        ):
            work = (0.5 * np.sqrt(x) * weights * 2 * y) @ moment(y**2)
            np.testing.assert_allclose(work_to(np.array([x]))[0], work, rtol=1e-5, atol=1e-8)


def test_below_the_lowest_amplitude_moments_go_on_as_straight_lines() -> None:
    """Friction in x, from its first coefficient at rest; g in ln x, whose slope changes by the last one."""
    splines = MomentSplines(100 * ARCSEC_RAD, 10 * ARCSEC_RAD, 100 * ARCSEC_RAD)
    # splines with equal coefficients are these everywhere: 2 at rest, 1 from the lowest amplitude on
    friction = np.array([2.0, *np.ones(splines.friction_count - 1)])
    x = np.array([0.025, 0.05, 0.1, 0.5, 1.0])
    np.testing.assert_allclose(splines.friction(x) @ friction, [1.75, 1.5, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        splines.friction_work(x) @ friction, [0.046875, 0.0875, 0.15, 0.55, 1.05], rtol=1e-6
    )
    g = splines.elastic(x) / x[:, None]
    np.testing.assert_allclose(g[:, -1], [np.log(0.25), np.log(0.5), 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(g[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(g[0] - g[1], g[1] - g[2], atol=1e-12)
    above = splines.elastic(np.array([0.1001]))[0] / 0.1001 - g[2]
    np.testing.assert_allclose(above[:-1], np.log(1.001) / np.log(0.5) * (g[1] - g[2])[:-1], atol=1e-4)
