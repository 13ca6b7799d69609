"""`rig paper`: printed values compared with those of simulation and analysis."""

import pytest

from processing.contact.hertz import MATERIALS, pendulum_on_ball
from processing.contact.moments import surface_energy
from processing.estimate import Estimate
from rig.report.paper import (
    BALL_RADIUS_M,
    CONTRADICTION,
    MASS_KG,
    PAIRS,
    PairSeries,
    _agreement,
    elastic_rows,
    friction_rows,
    simulate_pair,
    table1,
)


@pytest.fixture(scope="module")
def glass() -> PairSeries:
    """The pair whose decay is the shortest."""
    return simulate_pair(PAIRS[0], seed=5)


def test_table_1_is_reproduced_as_rounded() -> None:
    table = table1()
    assert len(table.shown) == 9
    assert {row[-1] for row in table.shown} == {"agrees as rounded"}


def test_the_printed_surface_energies_are_those_of_the_swept_area() -> None:
    """28.90, 13.21 and 27.22 mJ/m^2: 0.3 % or less from Table 2; Eq. 2 as printed is 1 % of it."""
    for pair in PAIRS:
        pendulum = pendulum_on_ball(MASS_KG, BALL_RADIUS_M, MATERIALS["steel"], MATERIALS[pair.flat])
        energy = surface_energy(Estimate(pair.c, 0.0), pendulum)
        assert energy.table2.value == pytest.approx(pair.surface_energy_j_per_m2, rel=3e-3)
        assert energy.eq2.value < 0.012 * pair.surface_energy_j_per_m2


def test_the_exact_fit_gives_the_printed_parameters_back(glass: PairSeries) -> None:
    rows = {row.label: row for row in (*friction_rows(glass), *elastic_rows(glass))}
    for name in ("b", "p", "c", "n", "T₀", "γ"):
        row = rows[name]
        assert row.verdict.startswith("agrees"), (name, row.verdict)
        # five combined uncertainties, or half of the last printed digit
        assert abs(row.exact - row.printed) < max(5 * row.u, 5e-4 * row.printed)
    assert rows["σ, m g R c/(2a²)"].verdict.startswith("agrees")
    assert rows["σ, Eq. 2: m g c/(2a)"].verdict.startswith(CONTRADICTION)


def test_eqs_5_and_6_are_biased_as_known(glass: PairSeries) -> None:
    """On glass b comes out 6.2 %, c 3.6 %, gamma 1.7 to 1.9 % too large."""
    rows = {row.label: row.differences[1] for row in (*friction_rows(glass), *elastic_rows(glass))}
    assert rows["b"] == pytest.approx(0.062, abs=0.002)
    assert rows["c"] == pytest.approx(0.036, abs=0.002)
    assert rows["γ"] == pytest.approx(0.018, abs=0.002)


@pytest.mark.parametrize(
    ("found", "printed", "half", "verdict"),
    [(27.22, 27.3, 0.06, ""), (27.26, 27.3, 0.03, "agrees as rounded"), (27.22, 27.3, 0.09, "agrees (95 %)")],
)
def test_rounding_is_half_of_the_last_digit_and_no_more(
    found: float, printed: float, half: float, verdict: str
) -> None:
    """Sigma of steel, 27.22 +- 0.03 against 27.3, was said to agree as rounded."""
    assert _agreement(found - printed, half, 0.1) == verdict
