"""The result of a run that is looked for first, what makes its uncertainty, and what to do about that."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import Determinacy
from processing.fit import Budget, Drag
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow, named
from rig.analysis.results import RunResults, Series
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


_SHOWN_SHARE = 0.02
_LIMITS_FROM = 0.25
_DO: Final[Mapping[str, str]] = {
    "swings": "measure longer, or make more runs",
    "ground": "measure while the ground is quieter, or record it beside the run (rig fit --witness)",
    "misfit": "see in the report where the law misses the decay, and compare laws (rig fit --law all)",
    "position_errors": "correct the sensor's errors of position",
    "friction_step": "fit the parts of the decay on their own, or make more runs",
    "ageing": "wait until the contact has settled, or state its history",
    "adhesion_ageing": "wait until the contact has settled, or state its history",
    "drag_drift": "let the air and its temperature settle, or measure in vacuum",
    "plane_of_swing_rad": "let the pendulum settle before the release, and calibrate the axes",
    "period_drift": "let the temperature settle before the next run",
}


class Limit(NamedTuple):
    """A source of a result's uncertainty, and its share of the variance."""

    source: str
    share: float

    @property
    def name(self) -> str:
        """As a person reads it."""
        return SOURCES.get(self.source, self.source)


class WholeResult(NamedTuple):
    """A result as text, whether its uncertainty is the whole or the swings' alone, and what makes it.

    Empty where nothing was fitted. `limits` are the largest first; `symbol` is
    that of a quantity which the data determine.
    """

    text: str = ""
    of: str = ""
    limits: Sequence[Limit] = ()
    symbol: str = ""

    @property
    def next_steps(self) -> list[str]:
        """What to do about each of the sources that make most of the uncertainty."""
        large = [one for one in self.limits if one.share >= _LIMITS_FROM]
        steps = [_DO.get(one.source, f"determine {one.name} more accurately") for one in large]
        return list(dict.fromkeys(steps))


def whole_result(run: RunResults, series: Series | None = None) -> WholeResult:
    """The surface energy, else the first parameter of the law that the data determine.

    Of a `series` with a table of its own its rows are taken instead of the run's.
    """
    if run.instrument is not None:
        return WholeResult(run.instrument.text[0] if run.instrument.text else "", "the swings")
    found = series if series is not None and series.table else run
    if not found.table:
        return WholeResult()
    rows = found.rows
    names = (name for name in (SURFACE_ENERGY, *DEFAULT_LAW.names(drag=False)) if name in rows)
    row = next((rows[name] for name in names if rows[name].determined), None)
    if row is None:
        return WholeResult("No parameter is determined", "", [Limit("swings", 1.0)])
    item = found.budget.get(row.quantity)
    symbol = quantity(row.quantity).symbol
    text = row.equation.replace(symbol, named(row.quantity).partition(" / ")[0], 1)
    if item is None or not has_apparatus(item):
        return WholeResult(text, "the swings alone", [Limit("swings", 1.0)], symbol)
    sources = sorted(item.sources, key=lambda line: -line.share)
    limits = [Limit(one.source, one.share) for one in sources if one.share >= _SHOWN_SHARE]
    return WholeResult(text, "the whole budget, swings and apparatus", limits, symbol)
