"""Tables of a run and of a series: parameters, budget, adhesion, work, correlations."""

import math
from collections.abc import Mapping
from dataclasses import replace

from processing.contact import weight_moment
from processing.fit import Budget, FitMethod
from processing.units import ARCSEC_RAD
from rig.analysis import (
    DECAY,
    InstrumentSeries,
    ResultRow,
    RunResults,
    Series,
    instrument_rows,
    instrument_series_rows,
    instrument_series_table,
    instrument_table,
    law_table,
    parameter_table,
    quality_table,
)
from rig.terminal import NOT_KNOWN, SOURCES, Table, decimals, plain, quantity, with_uncertainty

_MIN_LISTED_SHARE = 0.005
"""Fraction of the variance below which sources are summed in one line."""


def budget_table(budget: Mapping[str, Budget], known: Mapping[str, ResultRow], name: str = "budget") -> Table:
    """GUM budgets of all quantities, largest contribution first; an undetermined quantity has its bound."""
    lines = []
    for key, item in budget.items():
        display, row = quantity(key), known[key]
        head = [display.label, row.text, row.interval_text if row.determined else ""]
        small = [line for line in item.sources if line.share < _MIN_LISTED_SHARE]
        for line in (line for line in item.sources if line not in small):
            source = SOURCES.get(line.source, line.source)
            contribution = _contribution_text(line.contribution * display.factor)
            lines.append([*head, source, line.type, contribution, f"{100 * line.share:.1f} %"])
            head = [""] * 3
        if small:
            rest = math.hypot(*(line.contribution for line in small)) * display.factor
            count = f"{len(small)} more" if len(small) < len(item.sources) else f"{len(small)} sources"
            share = sum(line.share for line in small)
            lines.append([*head, count, "", _contribution_text(rest), f"{100 * share:.2f} %"])
    return Table(
        name, "Uncertainty budget (GUM)",
        ("", "value ± u", "95 %", "source", "type", "u", "share"), lines,
        "Largest contribution first. Type A: from the swings; B: stated in the configuration. Sources "
        "without a stated uncertainty contribute nothing; those below 0.5 % of the variance are summed here "
        "and listed one by one in results.json. What is not determined has a bound and no contributions.",
    )  # fmt: skip


def _contribution_text(contribution: float) -> str:
    return "" if math.isnan(contribution) else plain(contribution, 2)


def series_table(series: Series) -> Table:
    """Table of a series' parameters: exact and asymptotic fits."""
    lines = []
    exact, asymptotic = (series.fits.get(method, {}) for method in (FitMethod.EXACT, FitMethod.ASYMPTOTIC))
    for name in exact or asymptotic:
        display, row, item = quantity(name), series.rows.get(name), asymptotic.get(name)
        between = exact[name].between_runs * display.factor if name in exact else math.nan
        texts = ["", ""] if row is None else [row.text, row.interval_text]
        is_shown = item is not None and (row is None or row.determined)
        lines.append(
            [
                display.label,
                *texts,
                plain(between, 2) if between else "none seen",
                display.text(*item.estimate) if is_shown and item is not None else "",
            ]
        )
    return Table(
        "series", "The series",
        ("", FitMethod.EXACT, "95 % interval", "between runs", FitMethod.ASYMPTOTIC.heading), lines,
        "Runs combined with their own and the between-run scatter, Student's t for the 95 % interval, and "
        "with the apparatus as far as stated; beside it Eqs. 5 and 6, of the swings alone.",
    )  # fmt: skip


def run_tables(results: RunResults) -> list[Table]:
    """All tables of one run; a table without content is left out."""
    tables = [instrument_table(results), conditions_table(results)]
    if not results.fits and results.instrument is None:
        tables = [decay_table(results), *tables]
    if results.fits:
        tables = [
            parameter_table(results),
            quality_table(results),
            adhesion_table(results),
            work_table(results),
            budget_table(results.budget, results.rows),
            correlation_table(results),
            *tables,
        ]
    if results.laws is not None:
        tables.append(law_table(results.laws))
    return [table for table in tables if table.shown]


def series_tables(series: Series) -> list[Table]:
    """The tables of a series."""
    if series.instrument is not None:
        return [instrument_series_table(series.instrument)]
    return [series_table(series), budget_table(series.budget, series.rows, "series-budget")]


def conditions_table(results: RunResults) -> Table:
    """The conditions of the run against their limits."""
    rows = []
    for verdict in results.conditions:
        judged = ("warning" if verdict.remedy else "ok") if verdict.ok else "NOT OK"
        rows.append((verdict.name, judged, verdict.measured, verdict.limit, verdict.reason))
    head = ("condition", "verdict", "measured", "limit", "reason")
    return Table("conditions", "Conditions of the run", head, rows)


_THEORIES = ("JKR", "Maugis-Dugdale", "DMT")


def adhesion_table(results: RunResults) -> Table:
    """Table of the contact with adhesion, if c is determined; Hertz's contact is in the table of results."""
    rows = [row for row in results.table if row.fit in _THEORIES]
    lines = [_line(f"{row.shown.symbol}, {row.fit}", row) for row in rows]
    note = (
        "With adhesion the spot is larger than Hertz's and the surface energy smaller. The Tabor parameter "
        f"of {results.number('tabor').value:.2g} (equilibrium separation 0.3 nm) selects {results.adhesion}; "
        "all other values follow the paper, with Hertz's theory."
    )
    return Table("adhesion", "Contact with adhesion", ("", "value", "unit"), lines, note)


def work_table(results: RunResults) -> Table:
    """Work 4A and 4A_t at the amplitude of Table 4, or the nearest measured one, and at the run's start."""
    lines = []
    c = results.rows.get("c")
    for work in results.work_per_cycle:
        dissipated, adhesive = work.dissipated_4a_j, work.adhesive_4at_j
        texts = [with_uncertainty(value * 1e15, u * 1e15) for value, u in (dissipated, adhesive)]
        share = f"{100 * adhesive.value / dissipated.value:.1f} %" if dissipated.value else NOT_KNOWN
        if math.isnan(adhesive.value):
            # if c is only bounded, so is the work of adhesion, which is proportional to c
            share = NOT_KNOWN
            if c is not None and results.pendulum is not None:
                moment_n_m = weight_moment(results.pendulum)
                texts[1] = c.scaled_text(1e15 * 4 * moment_n_m * work.amplitude_arcsec * ARCSEC_RAD)
        lines.append([plain(work.amplitude_arcsec, 4), *texts, share])
    head = ("α / arcsec", "4A / fJ", "4Aₜ / fJ", "share of adhesion")
    return Table("work", "Work over one cycle", head, lines)


def correlation_table(results: RunResults) -> Table:
    """The correlation matrix of the exact fit."""
    correlation = results.fits[FitMethod.EXACT].correlation
    symbols = [quantity(name).symbol for name in correlation.names]
    lines = [
        [symbol, *(decimals(coefficient, 3) for coefficient in row)]
        for symbol, row in zip(symbols, correlation.matrix, strict=True)
    ]
    return Table(
        "correlation", "Correlations of the exact fit", ("", *symbols), lines,
        "What two parameters share: near ±1 the data hardly distinguish them, though each may be determined.",
    )  # fmt: skip


_MAX_HEADLINES = 4


def headline(results: RunResults, series: InstrumentSeries | None) -> list[tuple[str, str]]:
    """Labels and texts of the main results: of a series with several places, else of the run.

    The ratio to a reference is always that of the series.
    """
    rows = instrument_rows(results)
    if series is not None:
        has_places = series.time_s is not None and series.time_s.places > 1
        rows = [*instrument_series_rows(series, with_places=has_places), *([] if has_places else rows)]
    return [(replace(row.shown, symbol=name).label, row.text) for name, row in rows[:_MAX_HEADLINES]]


def decay_table(results: RunResults) -> Table:
    """Table of the quantities of a decay that need no law."""
    rows = [row for row in results.table if row.fit == DECAY and math.isfinite(row.value)]
    lines = [_line(row.shown.name, row) for row in rows]
    return Table("decay", "The decay", ("", "value ± u", "unit"), lines)


def _line(name: str, row: ResultRow) -> list[str]:
    return [name, row.text, row.shown.unit]
