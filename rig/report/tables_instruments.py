"""What is reported of pendulums that swing by degrees: the result that is looked for first, and its table."""

from collections.abc import Iterator, Mapping, Sequence
from math import nan
from typing import Any, Final, NamedTuple

from pydantic import JsonValue

from processing.estimate import Estimate
from rig.analysis import InstrumentResults, InstrumentSeries, RunResults, encoded
from rig.presentation import Cell, Table, with_uncertainty

_SHORT_LIST = 12
"""Longer lists (a value for every half-cycle) stay in results.json."""
_MOST_FIRST = 4


class Reported(NamedTuple):
    """A number as a person reads it; the uncertainty of a count is NaN."""

    name: str
    value: Estimate
    unit: str = ""

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} / ({self.unit})" if "/" in self.unit else " / ".join(filter(None, self[::2]))

    @property
    def text(self) -> str:
        """Value and standard uncertainty."""
        return with_uncertainty(*self.value)


def headline(values: InstrumentResults, series: InstrumentSeries | None) -> list[tuple[str, str]]:
    """Labels and texts of what is looked for first.

    They are those of the series where it has several places, else of the run; the ratio to a reference is the
    series'.
    """
    found = list(_reported(values, _RESULTS))
    if series is not None:
        many = series.time_s is not None and series.time_s.places > 1
        found = [*_ratios(series), *(_of_places(series) if many else found)]
    return [(item.label, item.text) for item in found[:_MOST_FIRST]]


def instrument_table(results: RunResults) -> Table:
    """Every number with its unit; in the file under its name of results.json."""
    values = results.instrument
    if values is None:
        return Table("instrument", "", (), ())
    shown = [[item.name, item.text, item.unit, ""] for item in _reported(values, (*_RESULTS, *_MORE))]
    for check in (*(values.environment or ()), *(values.apparatus or ())):
        limits = f"{check.lowest:g} to {check.highest:g} wanted: {check.verdict}"
        shown.append([check.name, f"{check.value:.5g}", check.unit, limits])
    if not any(row[-1] for row in shown):
        shown = [row[:-1] for row in shown]
    rows: list[list[Cell]] = [[*row] for row in _numbers(encoded(values))]
    head = ("", "value ± u", "unit", "standard")[: len(shown[0]) if shown else 0]
    return Table(
        "instrument", "What this kind of pendulum reports",
        ("quantity", "value", "standard_uncertainty"), rows, head, shown,
    )  # fmt: skip


def instrument_series_table(series: InstrumentSeries) -> Table:
    """What the places of a sample say together, and their ratio to a reference."""
    found = [*_ratios(series), *_of_places(series)]
    if series.reference_time_s is not None:
        found.append(Reported("damping time of the reference", series.reference_time_s, "s"))
    rows: list[list[Cell]] = [[*row] for row in _numbers(encoded(series))]
    return Table(
        "series", "The series",
        ("quantity", "value", "standard_uncertainty"), rows, ("", "value ± u", "unit"),
        [[item.name, item.text, item.unit] for item in found],
    )  # fmt: skip


_RESULTS: Final = (
    ("time_hardness_s", "time hardness, ten single swings", "s"),
    ("scale_hardness", "scale hardness, first swing", "divisions"),
    ("time_hardness_first_swing_s", "time hardness, first swing × 10", "s"),
    ("damping.time_s", "damping time, {span}", "s"),
    ("damping.swings", "swings, {span}", ""),
    ("rolling_friction_coefficient", "coefficient of rolling friction{at}", ""),
    ("log_decrement", "log decrement of a whole swing{at}", ""),
    ("period0_s", "period at vanishing amplitude", "s"),
    ("circular_factor", "circular error over the ideal pendulum's", ""),
    ("swing_plane.rate_deg_per_min", "turning of the swing plane", "deg/min"),
)
"""What the kinds are made to measure, first things first: names of `InstrumentResults`, words, units."""
_MORE: Final = (
    ("first_amplitude_deg", "first amplitude", "deg"),
    ("damping.missing_half_cycles", "half-cycles missing in it", ""),
    ("friction_law.exponent", "power of the amplitude of the friction", ""),
    ("friction_law.moment", "frictional moment over m g d", ""),
    ("friction_law.chi2_per_dof", "χ² per degree of freedom of that power", ""),
    ("chi2_per_dof", "χ² per degree of freedom", ""),
    ("swing_plane.turned_deg", "turned in all", "deg"),
    ("swing_plane.width_ratio", "width of the swing over its length", ""),
    ("inferred_half_cycles", "turning points off the sensor", ""),
    ("amplitude_deg.0", "first amplitude", "deg"),
    ("amplitude_deg.1", "last amplitude", "deg"),
    ("mean_period_s", "mean period", "s"),
)
"""What belongs to the result."""


def _reported(values: InstrumentResults, named: Sequence[tuple[str, str, str]]) -> Iterator[Reported]:
    """Those of some numbers that there are."""
    words, law, damping = {"at": "", "span": ""}, values.friction_law, values.damping
    if law is not None:
        words["at"] = f" at {law.reference_amplitude_deg:.3g}°"
    if damping is not None:
        words["span"] = f"{damping.start_amplitude_deg:g}° to {damping.end_amplitude_deg:g}°"
    for path, name, unit in named:
        found: Any = values
        for part in path.split("."):
            found = found[int(part)] if isinstance(found, tuple) else getattr(found, part, None)
        if found is not None:
            value = found if isinstance(found, Estimate) else Estimate(found, nan)
            yield Reported(name.format(**words), value, unit)


def _of_places(series: InstrumentSeries) -> Iterator[Reported]:
    for name, unit, found in (("damping time", "s", series.time_s), ("swings", "", series.swings)):
        if found is not None:
            mean = Estimate(found.value, found.standard_uncertainty)
            yield Reported(f"{name}, mean of {found.places} places", mean, unit)


def _ratios(series: InstrumentSeries) -> Iterator[Reported]:
    for name, found in (("damping times", series.ratio), ("swings", series.ratio_of_swings)):
        if found is not None:
            yield Reported(f"ratio of {name}, sample to reference", found)


def _numbers(tree: Mapping[str, JsonValue], above: str = "") -> Iterator[tuple[str, float | str, float]]:
    """Every number with its dotted name and its standard uncertainty, NaN where it has none."""
    for key, value in tree.items():
        name = f"{above}{key}"
        if name == "text":
            continue
        if isinstance(value, dict) and "value" in value:
            yield name, _float(value["value"]), _float(value.get("standard_uncertainty"))
        elif isinstance(value, dict):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, list) and len(value) <= _SHORT_LIST:
            yield from _numbers({str(place): item for place, item in enumerate(value, start=1)}, f"{name}.")
        elif isinstance(value, bool | str):
            yield name, str(value), nan
        elif isinstance(value, int | float):
            yield name, float(value), nan


def _float(value: JsonValue) -> float:
    return float(value) if isinstance(value, int | float) else nan
