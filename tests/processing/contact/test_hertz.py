"""Hertz contact, the paper's Table 1 and surface energies."""

import numpy as np
import pytest

from processing.contact.hertz import MATERIALS, Material, material
from processing.contact.moments import surface_energy
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from tests.processing.fit.decays import PAIRS, paper_pair

PRINTED = {
    "steel": (54.04, 0.483, 30.7, 27.22e-3, 0.243e-3),
    "silicon": (59.16, 0.579, 33.6, 13.21e-3, 0.129e-3),
    "glass_k8": (66.18, 0.724, 37.6, 28.90e-3, 0.316e-3),
}
"""Contact radius in um, depth in um, angle in arcmin, surface energies of Table 2 and Eq. 2 in J/m^2."""


@pytest.mark.parametrize("flat", PAIRS)
def test_contact_and_surface_energies_are_those_of_the_paper(flat: str) -> None:
    """To more digits than are printed; as printed they are rows of docs/validation.md."""
    parameters, pendulum = paper_pair(flat)
    a, radius = pendulum.contact_radius_m, pendulum.ball_radius_m
    *contact, table2, eq2 = PRINTED[flat]
    assert (a * 1e6, a**2 / radius * 1e6, np.degrees(a / radius) * 60) == pytest.approx(contact, rel=2e-3)
    found = surface_energy(Estimate(parameters.c, 0.0), pendulum)
    assert found.table2.value == pytest.approx(table2, rel=1e-3)
    assert found.eq2.value == pytest.approx(eq2, rel=3e-3)


def test_own_materials_come_first_and_unknown_ones_are_named() -> None:
    sapphire = Material(4e11, 0.27)
    assert material("sapphire", {"sapphire": sapphire}) is sapphire
    assert material("steel") is MATERIALS["steel"]
    with pytest.raises(
        ConfigurationError, match="unknown material 'stel': take one of glass_k8, silicon, steel"
    ):
        material("stel")
