"""Humid air, and the drag that it is expected to exert."""

from math import pi, sqrt

import pytest

from processing.ambient import humid_air
from processing.contact import bar_of, expected_drag_s
from processing.contact.free_swing import UniformBar
from tests.processing.fit.decays import paper_pair

PENDULUM = paper_pair("glass_k8")[1]
PERIOD_S = 4.07


def test_air_is_as_dense_and_viscous_as_tables_say() -> None:
    """CIPM-2007 for the density; 18.2 uPa s at 20 degrees Celsius, 19.0 at 40 (Kadoya et al. 1985)."""
    assert humid_air(20.0, 50.0, 101325.0).density_kg_per_m3 == pytest.approx(1.1992, rel=2e-3)
    assert humid_air(20.0, 100.0, 101325.0).density_kg_per_m3 == pytest.approx(1.1940, rel=2e-3)
    assert humid_air(20.0, 0.0, 90000.0).density_kg_per_m3 == pytest.approx(1.0699, rel=2e-3)
    assert humid_air(20.0, 0.0, 1e5).viscosity_pa_s == pytest.approx(18.2e-6, rel=0.01)
    assert humid_air(40.0, 0.0, 1e5).viscosity_pa_s == pytest.approx(19.1e-6, rel=0.01)


def test_a_thick_bar_feels_the_boundary_layer_alone() -> None:
    """Twice the flow's speed at its sides: 2 sqrt(2) pi r sqrt(rho eta omega) per length, for thin layers."""
    air, omega = humid_air(20.0, 50.0, 101325.0), 2 * pi / PERIOD_S
    weight = PENDULUM.mass_kg * PENDULUM.gravity_m_per_s2 * PENDULUM.ball_radius_m
    for radius_m in (1.0, 10.0):
        thin = 2 * sqrt(2) * pi * radius_m * sqrt(air.density_kg_per_m3 * air.viscosity_pa_s * omega)
        found = expected_drag_s(air, UniformBar(0.5, 2 * radius_m), PENDULUM, PERIOD_S)
        assert found == pytest.approx(thin * 0.5**3 / 12 / weight, rel=0.01 / radius_m)


def test_a_bar_has_the_pendulums_inertia_unless_it_is_stated() -> None:
    bar = bar_of(PENDULUM, PERIOD_S)
    inertia = PENDULUM.mass_kg * bar.length_m**2 / 12
    stiffness = PENDULUM.mass_kg * PENDULUM.gravity_m_per_s2 * PENDULUM.ball_radius_m
    assert 2 * pi * sqrt(inertia / stiffness) == pytest.approx(PERIOD_S)
    assert bar_of(PENDULUM, PERIOD_S, 0.4) == UniformBar(0.4, 0.08)
    assert bar_of(PENDULUM, PERIOD_S, 0.4, 0.02) == UniformBar(0.4, 0.02)
