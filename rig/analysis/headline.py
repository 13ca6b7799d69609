"""The result that is looked for first, with its whole uncertainty and what dominates it."""

from collections.abc import Mapping

from processing.estimate import Determinacy
from processing.fit import Budget, Determination, Drag
from rig.presentation import SOURCES, quantity, signed_percent

SURFACE_ENERGY = "surface_energy_table2_j_per_m2"
_LARGE = 0.25
"""Share of the variance from which on a source is named; the largest one always is."""


def budget_of(
    name: str, budget: Mapping[str, Budget], verdicts: Mapping[str, Determination]
) -> Budget | None:
    """The budget of a quantity that the data determine, if the apparatus has a part in it; else None."""
    item = budget.get(name)
    verdict = verdicts.get("c" if name == SURFACE_ENERGY else name)
    if item is None or (verdict is not None and verdict.verdict is not Determinacy.DETERMINED):
        return None
    return item if any(line.type == "B" and line.share > 0 for line in item.sources) else None


def dominant_text(item: Budget) -> str:
    """`E of the flat 71 %, swings (fit) 26 %`: what makes most of the variance, largest first."""
    lines = sorted(item.sources, key=lambda line: -line.share)
    named = [line for line in lines if line.share >= _LARGE] or lines[:1]
    return ", ".join(f"{SOURCES.get(line.source, line.source)} {100 * line.share:.0f} %" for line in named)


def drag_headline(drag: Drag | None, verdicts: Mapping[str, Determination], *, fitted: bool) -> str:
    """A drag that is seen, or that the fit has none; empty otherwise."""
    shown = quantity("drag_s")
    if not fitted:
        text = "Fitted without a drag, as in vacuum: if there was air, its drag is in b and c"
        if drag is not None and drag.significant:
            text += f"; the data show a drag of {shown.text(*drag.of_data_s)} s"
        return f"{text}."
    if drag is None or not drag.significant:
        return ""
    seen = "The drag of the air is seen"
    if not is_withheld("drag_s", verdicts):
        seen += f", {shown.text(*drag.drag_s)} s"
    shifts = shifts_by_drag(drag, verdicts)
    return f"{seen}; without it b would differ by {shifts['b']}." if "b" in shifts else f"{seen}."


def is_withheld(name: str, verdicts: Mapping[str, Determination]) -> bool:
    """Whether nothing is stated of a parameter."""
    return name in verdicts and verdicts[name].verdict is Determinacy.UNDETERMINED


def shifts_by_drag(drag: Drag, verdicts: Mapping[str, Determination]) -> dict[str, str]:
    """What the drag does to b and c; of one that is not determined, a change in per cent says nothing."""
    return {
        name: signed_percent(shift)
        for name, shift in (("b", drag.relative_shift_b), ("c", drag.relative_shift_c))
        if name not in verdicts or verdicts[name].verdict is Determinacy.DETERMINED
    }


def headline(budget: Mapping[str, Budget], verdicts: Mapping[str, Determination]) -> str:
    """The surface energy with the whole budget, and what dominates; empty without a type B uncertainty."""
    item = budget_of(SURFACE_ENERGY, budget, verdicts)
    if item is None:
        return ""
    shown = quantity(SURFACE_ENERGY)
    text = f"{shown.symbol} = {shown.text(item.value, item.standard_uncertainty)} {shown.unit}"
    sources = f"main sources of its variance: {dominant_text(item)}"
    return f"{text} with the whole budget, swings and apparatus; {sources}."
