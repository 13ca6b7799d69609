"""What dominates a result's uncertainty, and what is said first of a drag."""

from collections.abc import Mapping

from processing.estimate import Determinacy
from processing.fit import Budget, Drag
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow
from rig.presentation import SOURCES, quantity, signed_percent

_LARGE = 0.25
"""Share of the variance from which on a source is named; the largest one always is."""


def has_apparatus(item: Budget | None) -> bool:
    """Whether the apparatus has a part in a budget."""
    return item is not None and any(line.type == "B" and line.share > 0 for line in item.sources)


def dominant_text(item: Budget) -> str:
    """`E of the flat 71 %, swings (fit) 26 %`: what makes most of the variance, largest first."""
    lines = sorted(item.sources, key=lambda line: -line.share)
    named = [line for line in lines if line.share >= _LARGE] or lines[:1]
    return ", ".join(f"{SOURCES.get(line.source, line.source)} {100 * line.share:.0f} %" for line in named)


def drag_headline(drag: Drag | None, rows: Mapping[str, ResultRow], *, fitted: bool) -> str:
    """A drag that is seen, or that the fit has none; empty otherwise."""
    shown = quantity("drag_s")
    if not fitted:
        text = "Fitted without a drag, as in vacuum: if there was air, its drag is in b and c"
        if drag is not None and drag.significant:
            text += f"; the data show a drag of {shown.text(*drag.of_data_s)} s"
        return f"{text}."
    if drag is None or not drag.significant:
        return ""
    row, seen = rows.get("drag_s"), "The drag of the air is seen"
    if row is None or row.verdict is not Determinacy.UNDETERMINED:
        seen += f", {shown.text(*drag.drag_s) if row is None else row.text} s"
    shifts = shifts_by_drag(drag, rows)
    return f"{seen}; without it b would differ by {shifts['b']}." if "b" in shifts else f"{seen}."


def shifts_by_drag(drag: Drag, rows: Mapping[str, ResultRow]) -> dict[str, str]:
    """What the drag does to b and c; of one that is not determined, a change in per cent says nothing."""
    return {
        name: signed_percent(shift)
        for name, shift in (("b", drag.relative_shift_b), ("c", drag.relative_shift_c))
        if name not in rows or rows[name].determined
    }


def headline(rows: Mapping[str, ResultRow], budget: Mapping[str, Budget]) -> str:
    """The surface energy with the whole budget, and what dominates; empty without a type B uncertainty."""
    row, item = rows.get(SURFACE_ENERGY), budget.get(SURFACE_ENERGY)
    if row is None or item is None or not (row.determined and has_apparatus(item)):
        return ""
    sources = f"main sources of its variance: {dominant_text(item)}"
    return f"{row.equation} with the whole budget, swings and apparatus; {sources}."
