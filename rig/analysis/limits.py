"""The result of a run that is looked for first, what makes its uncertainty, and what to do about that."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import Determinacy
from processing.fit import Budget, FitMethod
from rig.analysis.headline import SURFACE_ENERGY, budget_of
from rig.analysis.results import RunResults
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


def whole_result(run: RunResults, of_series: Mapping[str, Budget] | None = None) -> WholeResult:
    """The surface energy, else the first parameter of the law that the data determine.

    `of_series` is the budget of a series of runs, which is taken instead of the run's own.
    """
    if run.instrument is not None:
        return WholeResult(run.instrument.text[0] if run.instrument.text else "", "the swings")
    exact, verdicts = run.fits.get(FitMethod.EXACT), run.verdicts()
    if exact is None or not exact.parameters:
        return WholeResult()
    budget = of_series or run.budget
    for name in (SURFACE_ENERGY, *DEFAULT_LAW.names(drag=False)):
        item = budget_of(name, budget, verdicts)
        if item is not None:
            shown = quantity(name)
            text = f"{shown.symbol} = {shown.text(item.value, item.standard_uncertainty)} {shown.unit}"
            sources = sorted(item.sources, key=lambda line: -line.share)
            limits = [Limit(one.source, one.share) for one in sources if one.share >= _SHOWN_SHARE]
            return WholeResult(text.rstrip(), "the whole budget, swings and apparatus", limits, shown.symbol)
    for name in DEFAULT_LAW.names(drag=False):
        verdict = verdicts.get(name)
        if name in exact.parameters and (verdict is None or verdict.verdict is Determinacy.DETERMINED):
            shown = quantity(name)
            text = f"{shown.symbol} = {shown.text(*exact.parameters[name])} {shown.unit}"
            return WholeResult(text.rstrip(), "the swings alone", [Limit("swings", 1.0)], shown.symbol)
    return WholeResult("No parameter is determined", "", [Limit("swings", 1.0)])
