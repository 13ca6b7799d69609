"""The half-swing map agrees with an independent integration of the equation of motion."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from processing.contact import scaled_contact, turning_points_of
from processing.contact.half_cycle_table import HalfCycleTable, iterate_decay
from processing.contact.law import ContactParameters, PendulumOnBall
from processing.contact.laws import PAPER
from processing.errors import DataError
from tests.processing.contact.gradients import assert_gradients
from tests.processing.fit.decays import ARCSEC, PAIRS, paper_pair


def integrated(
    parameters: ContactParameters, pendulum: PendulumOnBall, amplitude_rad: float, half_cycles: int
) -> NDArray[np.float64]:
    """Turning points (amplitude, time) of Eq. 4 with Eqs. 1 and 3, each stretch without a kink.

    A stretch ends at the zero crossing or at the turning point, where friction and the powers of
    |phi| have no derivative and no integrator keeps its order.
    """
    w2 = (2 * np.pi / parameters.period0_s) ** 2
    a, radius = pendulum.contact_radius_m, pendulum.ball_radius_m
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2

    def motion(_: float, y: NDArray[np.float64]) -> list[float]:
        phi, speed = y[0] * amplitude_rad, y[1] * amplitude_rad
        size = abs(phi)
        elastic = (
            2 * parameters.gamma_pa * a**2 * size ** (parameters.n + 1) * (np.pi / 2 - radius / a * size)
        )
        friction = parameters.c + parameters.b * size**parameters.p
        # moving down from a positive turning point: friction pushes up
        acceleration = -phi + np.sign(phi) * elastic / weight + friction - parameters.drag_s * speed
        return [y[1], w2 * acceleration / amplitude_rad]

    def crossing(_: float, y: NDArray[np.float64]) -> float:
        return float(y[0])

    def turning(_: float, y: NDArray[np.float64]) -> float:
        return float(y[1])

    crossing.terminal = turning.terminal = True  # type: ignore[attr-defined]
    out = [(amplitude_rad, 0.0)]
    x, time = 1.0, 0.0
    # left to itself the integrator takes steps over which its interpolation finds events to 1e-10
    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-16, "max_step": 0.05}
    for _ in range(half_cycles):
        first = scipy.integrate.solve_ivp(motion, (0, 10), [x, -0.0], events=crossing, **options)
        speed = first.y_events[0][0][1]
        second = scipy.integrate.solve_ivp(motion, (0, 10), [-0.0, speed], events=turning, **options)
        time += first.t_events[0][0] + second.t_events[0][0]
        x = -second.y_events[0][0][0]
        out.append((x * amplitude_rad, time))
    return np.array(out)


def other_exponents(p: float, n: float) -> tuple[ContactParameters, PendulumOnBall]:
    """Glass with other exponents, and the same loss and moment at 124 arcsec; in air."""
    printed, pendulum = paper_pair("glass_k8")
    size = 124 * ARCSEC
    b, gamma_pa = printed.b * size ** (printed.p - p), printed.gamma_pa * size ** (printed.n - n)
    return ContactParameters(b, p, printed.c, n, 2.5, gamma_pa, 2e-3), pendulum


def eight_times_the_friction() -> tuple[ContactParameters, PendulumOnBall]:
    """From 124 arcsec to some 20 in 60 half-cycles."""
    printed, pendulum = paper_pair("steel", 1e-4)
    return replace(printed, b=8 * printed.b, c=8 * printed.c), pendulum


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contact", "half_cycles", "rtol"),
    [
        *((paper_pair(flat, 1e-3 * (flat != PAIRS[0])), 10, 1e-10) for flat in PAIRS),
        *((other_exponents(p, n), 10, 1e-9) for p, n in ((0.0, 0.0), (1.0, 1.0), (1.7, 0.01), (0.3, 1.5))),
        (eight_times_the_friction(), 60, 1e-9),
    ],
)
def test_agrees_with_integration(
    contact: tuple[ContactParameters, PendulumOnBall], half_cycles: int, rtol: float
) -> None:
    expected = integrated(*contact, 124 * ARCSEC, half_cycles)
    amplitude, time = turning_points_of(*contact, 124 * ARCSEC, half_cycles)
    np.testing.assert_allclose(amplitude, expected[:, 0], rtol=rtol)
    np.testing.assert_allclose(time, expected[:, 1], rtol=rtol)


@pytest.mark.parametrize("drag_s", [0.0, 0.03])
def test_linear_drag_alone_is_the_damped_oscillator_and_nothing_keeps_the_swing(
    drag_s: float,
) -> None:
    _, pendulum = paper_pair("steel")
    only_drag = ContactParameters(0.0, 1.0, 0.0, 0.5, 3.0, 0.0, drag_s)
    amplitude, time = turning_points_of(only_drag, pendulum, 1e-3, 30)
    damping = 0.5 * 2 * np.pi / 3.0 * drag_s  # of phi'' + 2 damping w0 phi' + w0^2 phi = 0
    half_period = 1.5 / np.sqrt(1 - damping**2)
    np.testing.assert_allclose(time, half_period * np.arange(31), rtol=1e-11)
    fall = np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    np.testing.assert_allclose(amplitude, 1e-3 * fall ** np.arange(31), rtol=1e-11)


def test_constant_friction_takes_the_same_from_every_swing_until_it_holds() -> None:
    _, pendulum = paper_pair("steel")
    c = 1e-6
    amplitude, time = turning_points_of(ContactParameters(0.0, 1.0, c, 0.5, 3.0, 0.0), pendulum, 9.5e-6, 8)
    np.testing.assert_allclose(amplitude[:5], 9.5e-6 - 2 * c * np.arange(5), rtol=1e-7)
    np.testing.assert_allclose(time[:5], 1.5 * np.arange(5), rtol=1e-12)
    assert np.all(np.isnan(amplitude[6:])), "friction of 1e-6 holds a pendulum that turns below it"
    assert np.all(np.isnan(time[6:]))


def in_map(parameters: ContactParameters, pendulum: PendulumOnBall) -> NDArray[np.float64]:
    """The map's parameters from 120 arcsec down, in units of 50 arcsec."""
    *own, rho = scaled_contact(parameters, pendulum, 50 * ARCSEC)
    return np.array([*own, 50 * ARCSEC, rho, 2.4])


@pytest.mark.parametrize("drag_s", [0.0, 1e-3])
def test_derivatives_are_those_of_the_map(drag_s: float) -> None:
    q = in_map(*paper_pair("glass_k8", drag_s))
    # a central difference over 1e-6 of the value leaves the rounding of times of 200
    steps = 1e-6 * np.maximum(np.abs(q), 1e-3)
    assert_gradients(PAPER, q, np.array([0, 1, 2, 10, 57, 200]), steps, rtol=1e-5, of_largest=1e-5)


def test_gaps_are_run_over_exactly() -> None:
    q = in_map(*paper_pair("silicon"))
    every = PAPER.turning_points(q, np.arange(101, dtype=np.int64))
    some = PAPER.turning_points(q, np.array([0, 3, 50, 100], dtype=np.int64))
    for whole, part in zip(every, some, strict=True):
        assert np.array_equal(whole[[0, 3, 50, 100]], part)


def test_a_swing_that_a_law_makes_grow_ends_the_decay() -> None:
    log_a = np.log(np.geomspace(0.1, 1.0, 5))
    rows = np.tile([[1.5], [0.5], [0.0], [0.0]], 5)  # each half-swing is half as large again
    table = HalfCycleTable.of(log_a, rows, 1, 0)
    found = iterate_decay(lambda _: table, 2, 1.0, 1999).turning_points(1.0, np.arange(2000, dtype=np.int64))
    np.testing.assert_allclose(found.amplitude[:3], [1.0, 1.5, 2.25])
    assert np.isnan(found.amplitude[3:]).all()
    assert np.isnan(found.time[3:]).all()


def test_an_amplitude_that_is_none_is_refused() -> None:
    parameters, pendulum = paper_pair("silicon")
    with pytest.raises(DataError, match="must be positive"):
        turning_points_of(parameters, pendulum, 0.0, 10)
