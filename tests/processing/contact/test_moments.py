"""Loops, work and losses agree with each other."""

from dataclasses import asdict

import numpy as np
import pytest

from processing.contact import turning_points_of, weight_moment
from processing.contact.law import ContactParameters, PendulumOnBall
from processing.contact.laws import PAPER
from processing.contact.moments import measured_losses, model_losses, moment_loop
from processing.errors import DataError
from processing.fit import works_per_cycle_j
from tests.processing.fit.decays import ARCSEC, PAIRS, decay, paper_pair, without


def works(
    amplitude_rad: float, parameters: ContactParameters, pendulum: PendulumOnBall
) -> dict[str, np.ndarray]:
    known = {name: np.array(value) for name, value in asdict(parameters).items()}
    return works_per_cycle_j(amplitude_rad, known, np.array(weight_moment(pendulum)))


@pytest.mark.parametrize("flat", PAIRS)
def test_area_of_the_loop_is_the_work_per_cycle(flat: str) -> None:
    parameters, pendulum = paper_pair(flat)
    alpha = 3.1 * ARCSEC  # Table 4
    loop = moment_loop(alpha, asdict(parameters), pendulum, points=20_001)
    work = works(alpha, parameters, pendulum)
    # trapezoid over |phi|^p: the kink at zero costs (1/points)^(1+p), 1e-7
    area = -np.trapezoid(loop.friction_n_m, loop.phi_rad)
    assert area == pytest.approx(work["dissipated"], rel=1e-6)
    total = -np.trapezoid(loop.total_n_m, loop.phi_rad)
    assert total == pytest.approx(work["dissipated"], rel=1e-6), "the elastic part gives back what it takes"
    c_only = ContactParameters(0.0, 1.0, parameters.c, parameters.n, parameters.period0_s, 0.0)
    rectangle = moment_loop(alpha, asdict(c_only), pendulum)
    assert -np.trapezoid(rectangle.friction_n_m, rectangle.phi_rad) == pytest.approx(
        work["adhesive"], rel=1e-12
    )


@pytest.mark.parametrize("drag_s", [0.0, 1e-3])
def test_work_per_cycle_is_what_the_exact_map_loses(drag_s: float) -> None:
    parameters, pendulum = paper_pair("steel", drag_s)
    alpha = 50 * ARCSEC
    amplitude, _ = turning_points_of(parameters, pendulum, alpha, 2)
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2
    kappa = 2 * parameters.gamma_pa * pendulum.contact_radius_m**2 / weight

    def potential(x: float) -> float:
        n = parameters.n
        elastic = np.pi / 2 * x ** (n + 2) / (n + 2) - rho * x ** (n + 3) / (n + 3)
        return float(weight_moment(pendulum) * (x**2 / 2 - kappa * elastic))

    lost = potential(amplitude[0]) - potential(amplitude[2])
    work = works(float(amplitude[1]), parameters, pendulum)
    # the work belongs to a steady amplitude; over one cycle it falls by a few tenths of a per cent
    fall = 1 - amplitude[2] / amplitude[0]
    assert lost == pytest.approx(work["dissipated"] + work["drag"], rel=fall)


def test_elastic_moment_works_against_gravity() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    phi = np.array([-10, -1, 0, 1, 10]) * ARCSEC
    moment = PAPER.branch_moments(phi, np.ones(5), asdict(parameters), pendulum).elastic_n_m
    np.testing.assert_array_equal(np.sign(moment), np.sign(phi))
    np.testing.assert_allclose(moment, -moment[::-1])
    assert moment[2] == 0


def test_losses_of_a_viscous_pendulum_do_not_depend_on_amplitude() -> None:
    _, pendulum = paper_pair("steel")
    drag_s = 0.01
    parameters = ContactParameters(0.0, 1.0, 0.0, 0.5, 3.0, 0.0, drag_s)
    losses = model_losses(np.array([1e-5, 1e-4, 1e-3]), parameters, pendulum)
    damping = 0.5 * 2 * np.pi / 3.0 * drag_s
    decrement = 2 * np.pi * damping / np.sqrt(1 - damping**2)
    np.testing.assert_allclose(losses.log_decrement, decrement, rtol=1e-11)
    np.testing.assert_allclose(losses.quality, np.pi / decrement, rtol=1e-11)


def test_measured_losses_scatter_as_stated_about_the_model() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=8)
    losses = measured_losses(points)
    start = points.amplitude[0 : 2 * len(losses.amplitude_rad) : 2]
    model = model_losses(start, parameters, pendulum)
    z = (losses.log_decrement - model.log_decrement) / losses.u_log_decrement
    # consecutive windows share an end, which leaves the variance as it is
    assert np.mean(z**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 * 1.5 / len(z)))
    coarse = measured_losses(points, cycles=5)
    assert np.median(coarse.u_log_decrement) < 0.3 * np.median(losses.u_log_decrement)
    # a window with a missing end is left out
    fewer = measured_losses(without(points, np.array([20])))
    assert len(fewer.amplitude_rad) == len(losses.amplitude_rad) - 2
    with pytest.raises(DataError, match="at least one"):
        measured_losses(points, cycles=0)
