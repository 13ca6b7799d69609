"""What is reported of pendulums that swing by degrees: the result that is looked for first, and its table."""

from collections.abc import Iterator, Mapping
from math import nan
from typing import NamedTuple

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
    found = list(_results(values))
    if series is not None:
        many = series.time_s is not None and series.time_s.places > 1
        found = [*_ratios(series), *(_of_places(series) if many else found)]
    return [(item.label, item.text) for item in found[:_MOST_FIRST]]


def instrument_table(results: RunResults) -> Table:
    """Every number with its unit; in the file under its name of results.json."""
    values = results.instrument
    if values is None:
        return Table("instrument", "", (), ())
    shown = [[item.name, item.text, item.unit, ""] for item in (*_results(values), *_more(values))]
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


def _results(values: InstrumentResults) -> Iterator[Reported]:
    """What the kind is made to measure, first things first."""
    if values.time_hardness_s is not None:
        yield Reported("time hardness, ten single swings", values.time_hardness_s, "s")
    if values.scale_hardness is not None:
        yield Reported("scale hardness, first swing", values.scale_hardness, "divisions")
    if values.time_hardness_first_swing_s is not None:
        yield Reported("time hardness, first swing × 10", values.time_hardness_first_swing_s, "s")
    if (damping := values.damping) is not None:
        span = f"{damping.start_amplitude_deg:g}° to {damping.end_amplitude_deg:g}°"
        yield Reported(f"damping time, {span}", damping.time_s, "s")
        yield Reported(f"swings, {span}", damping.swings)
    law = values.friction_law
    at = f" at {law.reference_amplitude_deg:.3g}°" if law is not None else ""
    if values.rolling_friction_coefficient is not None:
        yield Reported(f"coefficient of rolling friction{at}", values.rolling_friction_coefficient)
    if values.log_decrement is not None:
        yield Reported(f"log decrement of a whole swing{at}", values.log_decrement)
    if values.period0_s is not None:
        yield Reported("period at vanishing amplitude", values.period0_s, "s")
    if values.circular_factor is not None:
        yield Reported("circular error over the ideal pendulum's", values.circular_factor)
    if (plane := values.swing_plane) is not None:
        yield Reported("turning of the swing plane", plane.rate_deg_per_min, "deg/min")


def _more(values: InstrumentResults) -> Iterator[Reported]:
    """What belongs to the result."""
    if values.first_amplitude_deg is not None:
        yield Reported("first amplitude", Estimate(values.first_amplitude_deg, nan), "deg")
    if values.damping is not None:
        yield Reported("half-cycles missing in it", Estimate(values.damping.missing_half_cycles, nan))
    if (law := values.friction_law) is not None:
        yield Reported("power of the amplitude of the friction", law.exponent)
        yield Reported("frictional moment over m g d", law.moment)
        yield Reported("χ² per degree of freedom of that power", Estimate(law.chi2_per_dof, nan))
    if values.chi2_per_dof is not None:
        yield Reported("χ² per degree of freedom", Estimate(values.chi2_per_dof, nan))
    if (plane := values.swing_plane) is not None:
        yield Reported("turned in all", plane.turned_deg, "deg")
        yield Reported("width of the swing over its length", Estimate(plane.width_ratio, nan))
    if values.inferred_half_cycles is not None:
        yield Reported("turning points off the sensor", Estimate(values.inferred_half_cycles, nan))
    if values.amplitude_deg is not None:
        for which, value in zip(("first", "last"), values.amplitude_deg, strict=True):
            yield Reported(f"{which} amplitude", Estimate(value, nan), "deg")
    if values.mean_period_s is not None:
        yield Reported("mean period", Estimate(values.mean_period_s, nan), "s")


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
