"""The headline: the surface energy with its whole budget, and what dominates it."""

from dataclasses import replace

from processing.estimate import Determinacy, Estimate
from processing.fit import Budget, Drag, DragFinding
from processing.fit.uncertainty import BudgetSource
from rig.analysis import RunResults
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow
from rig.analysis.run_remarks import drag_headline, whole_result


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


def test_what_is_said_first_is_named_and_has_the_whole_uncertainty() -> None:
    """Sigma stood there without a name; a drag was 1.93 +- 0.10 where its interval is uneven."""
    run = RunResults(record="run-1.mcap", table=(ROW,), budget={SURFACE_ENERGY: BUDGET})
    assert whole_result(run).text == "surface energy σ (Table 2's form) = 83.4 ± 1.3 mJ/m²"
    drag = ResultRow(quantity="drag_s", verdict=Determinacy.INTERVAL, lower=1.58e-3, upper=2.09e-3)
    seen = Drag(drag_s=Estimate(1.93e-3, 1e-4), finding=DragFinding.SEEN)
    said = drag_headline(seen, {"drag_s": drag, "b": replace(drag, quantity="b")}, fitted=True)
    assert said == "The drag of the air is seen, (1.58 … 2.09) × 10⁻³ (95 %) s."
