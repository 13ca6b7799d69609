"""Tables of what is known how well: identifiability, budget, the series."""

import math
from collections.abc import Mapping

from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import Budget, FitMethod
from rig.analysis import AveragedCurves, ResultRow, RunResults, Series
from rig.presentation import SOURCES, Cell, Table, interval, law_parameters, plain, quantity

_NEGLIGIBLE = 0.005
"""Share of the variance below which a source is shown with others in one line."""


def identifiability_table(results: RunResults) -> Table:
    """Which quantities the data determine, and the interval in which each lies."""
    fitted = [row for row in results.table if row.quantity in law_parameters()]
    shown = [
        [
            row.shown.symbol, row.verdict,
            interval(row.lower * row.shown.factor, row.upper * row.shown.factor), row.shown.unit,
            "profile likelihood" if row.by_profile else "covariance",
        ]
        for row in fitted
    ]  # fmt: skip
    rows: list[list[Cell]] = [
        [row.quantity, row.verdict, row.lower, row.upper, str(row.by_profile)] for row in fitted
    ]
    return Table(
        "identifiability", "What the data determine",
        ("parameter", "verdict", "lower_95", "upper_95", "profile_likelihood"),
        rows, ("", "verdict", "95 % interval", "unit", "by"), shown,
    )  # fmt: skip


def budget_table(budget: Mapping[str, Budget], known: Mapping[str, ResultRow], name: str = "budget") -> Table:
    """GUM budgets of all quantities, largest contribution first.

    Of what the data do not determine, its bound and the shares of the sources alone.
    """
    rows: list[list[Cell]] = []
    shown = []
    for key, item in budget.items():
        scale = quantity(key).factor
        u, row = item.standard_uncertainty, known.get(key)
        text = quantity(key).text(item.value, u) if row is None else row.text
        ends = ""
        if row is not None and row.determined:
            ends = interval(row.lower * scale, row.upper * scale)
        head = [quantity(key).label, text, ends]
        small = []
        for line in item.sources:
            contribution, share = line.contribution, line.share
            rows.append(
                [
                    key, item.value, u, line.source, line.type, line.u_source, line.sensitivity,
                    contribution, share,
                ]
            )  # fmt: skip
            if share < _NEGLIGIBLE:
                small.append(line)
                continue
            cells = [SOURCES.get(line.source, line.source), line.type]
            shown.append([*head, *cells, _part(contribution * scale), f"{100 * share:.1f} %"])
            head = [""] * 3
        if small:
            rest = math.hypot(*(line.contribution for line in small)) * scale
            count = f"{len(small)} more" if len(small) < len(item.sources) else f"{len(small)} sources"
            share = sum(line.share for line in small)
            shown.append([*head, count, "", _part(rest), f"{100 * share:.2f} %"])
    return Table(
        name, "Uncertainty budget (GUM)",
        ("quantity", "value", "u_total", "source", "type", "u_source", "sensitivity",
         "contribution", "share"),
        rows, ("", "value ± u", "95 %", "source", "type", "u", "share"), shown,
        "Largest contribution first. Type A: from the swings; B: stated in the configuration. Sources "
        "without a stated uncertainty contribute nothing; those below 0.5 % of the variance are summed here "
        "and listed one by one in budget.csv. What is not determined has a bound and no contributions.",
    )  # fmt: skip


def _part(contribution: float) -> str:
    return "" if math.isnan(contribution) else plain(contribution, 2)


def series_table(series: Series) -> Table:
    """A series combined: exact, asymptotic, and the paper's way."""
    rows: list[list[Cell]] = []
    shown = []
    exact, asymptotic = (series.fits.get(method, {}) for method in (FitMethod.EXACT, FitMethod.ASYMPTOTIC))
    average = series.averaged_curves or AveragedCurves()
    for name in exact or asymptotic:
        shown_as, row = quantity(name), series.rows.get(name)
        cells = [getattr(exact.get(name), key, math.nan) for key in _SERIES_KEYS]
        item = asymptotic.get(name)
        others = [
            NOT_DETERMINED if item is None else Estimate(item.value, item.standard_uncertainty),
            average.parameters.get(name, NOT_DETERMINED),
        ]
        known = (row.value, row.u_total, row.lower, row.upper) if row is not None else [math.nan] * 4
        rows.append([name, *known, *cells, *others[0], *others[1]])
        between = cells[1] * shown_as.factor
        told = row is None or row.determined
        shown.append(
            [
                shown_as.label,
                "" if row is None else row.text,
                "" if row is None else interval(row.lower * shown_as.factor, row.upper * shown_as.factor),
                plain(between, 2) if between else "none seen",
                *(shown_as.text(value, u) if told else "" for value, u in others),
            ]
        )  # fmt: skip
    return Table(
        "series", "The series",
        ("parameter", "value", "u_total", "lower_95", "upper_95", *_SERIES_KEYS, "asymptotic_value",
         "asymptotic_u", "averaged_curves_value", "averaged_curves_u"),
        rows,
        ("", FitMethod.EXACT, "95 % interval", "between runs", FitMethod.ASYMPTOTIC.heading,
         "curves averaged first"), shown,
        "Runs combined with their own and the between-run scatter, Student's t for the 95 % interval, and "
        "with the apparatus as far as stated; beside it, of the swings alone, Eqs. 5 and 6, and the paper's "
        "way: the runs' curves averaged, then Eqs. 5 and 6 fitted.",
    )  # fmt: skip


_SERIES_KEYS = ("within_runs", "between_runs", "p_homogeneous")
