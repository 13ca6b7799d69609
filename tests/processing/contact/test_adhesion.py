"""The contact spot with adhesion, against the limits that its sources give and solutions by another way."""

from math import pi

import numpy as np
import pytest
import scipy

from processing.contact.moments import adhesive_contacts, maugis_radius, surface_energy, tabor_parameter
from processing.errors import DataError
from processing.estimate import Estimate
from tests.processing.fit.decays import PAIRS, paper_pair

LOAD_N, RADIUS_M, STIFFNESS_PA = 3.98, 6.05e-3, 1.5e11


@pytest.mark.parametrize("flat", PAIRS)
def test_jkr_makes_the_papers_spots_larger_and_their_surface_energy_smaller(flat: str) -> None:
    parameters, pendulum = paper_pair(flat)
    found = adhesive_contacts(parameters.c, pendulum)
    hertz = surface_energy(Estimate(parameters.c, 0.0), pendulum).table2.value
    larger = found.jkr.radius_m / pendulum.contact_radius_m - 1
    assert 0.0065 < larger < 0.014
    assert 0.013 < 1 - found.jkr.surface_energy_j_per_m2 / hertz < 0.028
    # the work of the loop is that of Table 2 for any radius
    assert found.jkr.surface_energy_j_per_m2 * (1 + larger) ** 2 == pytest.approx(hertz)
    assert found.dmt.radius_m < found.maugis.radius_m < found.jkr.radius_m
    assert 2.5 < found.tabor < 9


@pytest.mark.parametrize("work", [0.02, 0.5])
def test_maugis_lies_between_dmt_and_jkr_and_meets_both(work: float) -> None:
    pull = 3 * pi * work * RADIUS_M
    jkr = ((LOAD_N + pull + np.sqrt(2 * pull * LOAD_N + pull**2)) * RADIUS_M / STIFFNESS_PA) ** (1 / 3)
    dmt = ((LOAD_N + 2 * pi * work * RADIUS_M) * RADIUS_M / STIFFNESS_PA) ** (1 / 3)
    radii = [
        maugis_radius(LOAD_N, work, RADIUS_M, STIFFNESS_PA, transition)
        for transition in (1e-5, 0.1, 1.0, 5.0, 300.0)
    ]
    assert radii == sorted(radii)
    assert radii[0] == pytest.approx(dmt, rel=2e-5)
    assert radii[-1] == pytest.approx(jkr, rel=2e-6)


def test_the_gap_at_the_edge_of_attraction_is_where_the_work_is_done() -> None:
    """Maugis' equations with their units, the stress times the gap at r = m a being w."""
    work, transition = 0.06, 1.3
    radius = maugis_radius(LOAD_N, work, RADIUS_M, STIFFNESS_PA, transition)
    stress = transition / 2 * (RADIUS_M / (pi * work * STIFFNESS_PA**2)) ** (-1 / 3)

    def gap(m: float) -> float:
        """At r = m a: of Hertz's surfaces, and as much more as the attraction has deformed them."""
        root, arc = np.sqrt(m * m - 1), np.arccos(1 / m)
        of_hertz = radius**2 / (pi * RADIUS_M) * (root + (m * m - 2) * arc)
        return float(of_hertz + 4 * stress / (pi * 0.75 * STIFFNESS_PA) * radius * (root * arc - m + 1))

    m = scipy.optimize.brentq(lambda m: stress * gap(m) - work, 1 + 1e-9, 50)
    pulled = 2 * stress * radius**2 * (np.sqrt(m * m - 1) + m * m * np.arccos(1 / m))
    assert radius**3 * STIFFNESS_PA / RADIUS_M - pulled == pytest.approx(LOAD_N, rel=1e-9)


def test_the_tabor_parameter_of_a_textbook_contact() -> None:
    # R = 1 um, w = 0.1 J/m2, E* = 1 GPa, z0 = 0.3 nm
    expected = (1e-6 * 0.1**2 / (1e9**2 * 0.3e-9**3)) ** (1 / 3)
    assert tabor_parameter(0.1, 1e-6, 4e9 / 3) == pytest.approx(expected)


def test_without_adhesion_there_is_nothing_to_add() -> None:
    pendulum = paper_pair("steel")[1]
    with pytest.raises(DataError, match="without adhesion the contact is Hertz's"):
        adhesive_contacts(0.0, pendulum)
