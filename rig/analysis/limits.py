"""The result of a run that is looked for first, what makes its uncertainty, and what to do about that."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from processing.contact.laws import DEFAULT_LAW
from rig.analysis.headline import has_apparatus
from rig.analysis.result_rows import SURFACE_ENERGY, named
from rig.analysis.results import RunResults, Series
from rig.presentation import SOURCES, quantity

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
