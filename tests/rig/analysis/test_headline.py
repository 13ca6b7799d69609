"""The headline: the surface energy with its whole budget, and what dominates it."""

from dataclasses import replace

from processing.estimate import Determinacy
from processing.fit import Budget
from processing.fit.uncertainty import BudgetSource
from rig.analysis.headline import headline
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow


def source(name: str, kind: str, share: float) -> BudgetSource:
    return BudgetSource(name, "A" if kind == "A" else "B", 1.0, 1.0, share**0.5, share)


BUDGET = Budget(
    value=0.0834,
    standard_uncertainty=0.0013,
    sources=(
        source("swings", "A", 0.28),
        source("flat_youngs_modulus_pa", "B", 0.7),
        source("mass_kg", "B", 0.02),
    ),
)
ROW = ResultRow(quantity=SURFACE_ENERGY, value=0.0834, u=0.0007, u_total=0.0013)


def test_the_headline_names_what_dominates() -> None:
    text = headline({SURFACE_ENERGY: ROW}, {SURFACE_ENERGY: BUDGET})
    assert "83.4 ± 1.3 mJ/m² with the whole budget" in text
    assert text.endswith("of its variance: E of the flat 70 %, swings (fit) 28 %.")


def test_there_is_none_without_the_apparatus_or_where_the_data_set_a_bound() -> None:
    alone = replace(BUDGET, sources=(source("swings", "A", 1.0), source("mass_kg", "B", 0.0)))
    assert headline({SURFACE_ENERGY: ROW}, {SURFACE_ENERGY: alone}) == ""
    bound = replace(ROW, verdict=Determinacy.UPPER_BOUND)
    assert headline({SURFACE_ENERGY: bound}, {SURFACE_ENERGY: BUDGET}) == ""
    assert headline({}, {}) == ""
