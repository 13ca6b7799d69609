"""What is reported of pendulums that swing by degrees: the result that is looked for first, and its table."""

from collections.abc import Iterator
from dataclasses import fields
from math import nan
from typing import Final

from processing.quantity import OfInstrument
from rig.analysis import INSTRUMENT, InstrumentSeries, ResultRow, RunResults
from rig.presentation import Cell, Table, TableRow

_MOST_FIRST = 4
_ORDER: Final = [field.name for field in fields(OfInstrument)]


def _rows(results: RunResults) -> list[ResultRow]:
    """The rows of what this kind of pendulum reports, first things first."""
    hidden = ("damping_start_deg", "damping_end_deg")
    found = [row for row in results.table if row.fit.startswith(INSTRUMENT) and row.quantity not in hidden]
    return sorted(found, key=lambda row: _ORDER.index(row.quantity))


def _name(row: ResultRow) -> str:
    """In words, with the part of the decay of which it is."""
    return f"{row.shown.name}{row.fit.removeprefix(INSTRUMENT)}"


def _labelled(name: str, unit: str) -> str:
    return f"{name} / ({unit})" if "/" in unit else " / ".join(filter(None, (name, unit)))


def headline(results: RunResults, series: InstrumentSeries | None) -> list[tuple[str, str]]:
    """Labels and texts of what is looked for first.

    They are those of the series where it has several places, else of the run; the ratio to a reference is the
    series'.
    """
    found = [(_labelled(_name(row), row.shown.unit), row.text) for row in _rows(results)]
    if series is not None:
        many = series.time_s is not None and series.time_s.places > 1
        of_series = [*_ratios(series), *(_place_rows(series) if many else ())]
        of_series_text = [(_labelled(name, row.shown.unit), row.text) for name, row in of_series]
        found = [*of_series_text, *([] if many else found)]
    return found[:_MOST_FIRST]


def instrument_table(results: RunResults) -> Table:
    """Every number with its unit, and what the standard wants of environment and apparatus."""
    checks = () if results.instrument is None else results.instrument.checks
    more = [""] if checks else []
    lines = [_line(row.quantity, _name(row), row, more) for row in _rows(results)]
    for check in checks:
        limits = f"{check.lowest:g} to {check.highest:g} wanted: {check.verdict}"
        cells: list[Cell] = [check.name, check.value, check.standard_uncertainty]
        lines.append(TableRow(cells, [check.name, f"{check.value:.5g}", check.unit, limits]))
    head = ("", "value ± u", "unit", *(["standard"] if checks else []))
    return Table.of("instrument", "What this kind of pendulum reports", _COLUMNS, head, lines)


_COLUMNS = "quantity value standard_uncertainty"


def _line(key: str, name: str, row: ResultRow, more: list[str]) -> TableRow:
    return TableRow([key, *row], [name, row.text, row.shown.unit, *more])


def instrument_series_table(series: InstrumentSeries) -> Table:
    """What the places of a sample say together, and their ratio to a reference."""
    found = [*_ratios(series), *_place_rows(series)]
    if series.reference_time_s is not None:
        value, u = series.reference_time_s
        row = ResultRow(quantity="damping_time_s", value=value, u_total=u)
        found.append(("damping time of the reference", row))
    lines = [_line(name, name, row, []) for name, row in found]
    return Table.of("series", "The series", _COLUMNS, ("", "value ± u", "unit"), lines)


def _place_rows(series: InstrumentSeries) -> Iterator[tuple[str, ResultRow]]:
    for key, found in (("damping_time_s", series.time_s), ("damping_swings", series.swings)):
        if found is not None:
            row = ResultRow(quantity=key, value=found.value, u_total=found.standard_uncertainty)
            yield f"{row.shown.name}, mean of {found.places} places", row


def _ratios(series: InstrumentSeries) -> Iterator[tuple[str, ResultRow]]:
    for name, found in (("damping times", series.ratio), ("swings", series.ratio_of_swings)):
        value, u = found or (nan, nan)
        if found is not None:
            row = ResultRow(quantity="damping_swings", value=value, u_total=u)
            yield f"ratio of {name}, sample to reference", row
