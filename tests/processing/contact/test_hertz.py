"""Hertz contact, the paper's Table 1 and surface energies."""

import numpy as np
import pytest

from processing.contact.hertz import MATERIALS, Material, contact_radius, material, pendulum_on_ball
from processing.contact.law import STANDARD_GRAVITY_M_PER_S2
from processing.contact.moments import surface_energy
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from tests.processing.fit.decays import PAIRS, paper_pair

FORCE = 0.406 * STANDARD_GRAVITY_M_PER_S2
CALCULATED = {
    "steel": (54.04, 0.483, 30.7),
    "silicon": (59.16, 0.579, 33.6),
    "glass_k8": (66.18, 0.724, 37.6),
}
SURFACE_ENERGY = {
    "steel": (27.22e-3, 0.243e-3),
    "silicon": (13.21e-3, 0.129e-3),
    "glass_k8": (28.90e-3, 0.316e-3),
}


@pytest.mark.parametrize("flat", PAIRS)
def test_table_1(flat: str) -> None:
    """To more digits than are printed; as printed it is a row of docs/validation.md."""
    a, radius = contact_radius(FORCE, 6.05e-3, MATERIALS["steel"], MATERIALS[flat]), 6.05e-3
    found = (a * 1e6, a**2 / radius * 1e6, np.degrees(a / radius) * 60)
    assert found == pytest.approx(CALCULATED[flat], rel=2e-3)


@pytest.mark.parametrize("flat", PAIRS)
def test_both_forms_of_surface_energy(flat: str) -> None:
    parameters, pendulum = paper_pair(flat)
    found = surface_energy(Estimate(parameters.c, 0.0), pendulum)
    assert found.table2.value == pytest.approx(SURFACE_ENERGY[flat][0], rel=1e-3)
    assert found.eq2.value == pytest.approx(SURFACE_ENERGY[flat][1], rel=3e-3)


def test_two_balls_carry_half_each() -> None:
    one = pendulum_on_ball(1.2, 5e-3, MATERIALS["steel"], MATERIALS["glass_k8"])
    two = pendulum_on_ball(0.6, 5e-3, MATERIALS["steel"], MATERIALS["glass_k8"])
    assert two.contact_radius_m / one.contact_radius_m == pytest.approx(2 ** (-1 / 3), rel=1e-12)


def test_own_materials_come_first_and_unknown_ones_are_named() -> None:
    sapphire = Material(4e11, 0.27)
    assert material("sapphire", {"sapphire": sapphire}) is sapphire
    assert material("steel") is MATERIALS["steel"]
    with pytest.raises(
        ConfigurationError, match="unknown material 'stel': take one of glass_k8, silicon, steel"
    ):
        material("stel")
