"""Tables of what is known how well: identifiability, budget, Monte Carlo, the series."""

import math
from collections.abc import Mapping

from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import Budget, FitMethod
from rig.analysis import (
    AveragedCurves,
    MonteCarlo,
    RunResults,
    Series,
    determined_text,
    series_verdicts,
)
from rig.presentation import SOURCES, Cell, Table, interval, plain, quantity

_NEGLIGIBLE = 0.005
"""Share of the variance below which a source is shown with others in one line."""


def identifiability_table(results: RunResults) -> Table:
    """Which parameters the data determine."""
    rows: list[list[Cell]] = []
    shown = []
    for item in results.identifiability:
        shown_as = quantity(item.name)
        rows.append(
            [
                item.name, item.verdict, item.value, item.standard_uncertainty, item.lower_95, item.upper_95,
                str(item.profile_likelihood),
            ]
        )  # fmt: skip
        relative = abs(item.standard_uncertainty / item.value) if item.value else math.inf
        shown.append(
            [
                shown_as.symbol, item.verdict, plain(relative, 2),
                interval(item.lower_95 * shown_as.factor, item.upper_95 * shown_as.factor), shown_as.unit,
                "profile likelihood" if item.profile_likelihood else "covariance",
            ]
        )  # fmt: skip
    return Table(
        "identifiability", "What the data determine",
        ("parameter", "verdict", "value", "standard_uncertainty", "lower_95", "upper_95",
         "profile_likelihood"),
        rows, ("", "verdict", "u relative", "95 % interval", "unit", "by"), shown,
    )  # fmt: skip


def budget_table(budget: Mapping[str, Budget], name: str = "budget") -> Table:
    """GUM budgets of all quantities, largest contribution first."""
    rows: list[list[Cell]] = []
    shown = []
    for key, item in budget.items():
        scale = quantity(key).factor
        value, u = item.value, item.standard_uncertainty
        head = [quantity(key).label, quantity(key).text(value, u)]
        head.append(f"± {plain(item.expanded_uncertainty_95 * scale, 2)} (k = {item.coverage_factor_95:.2f})")
        small = []
        for line in item.sources:
            contribution, share = line.contribution, line.share
            rows.append(
                [
                    key, value, u, line.source, line.type, line.u_source, line.sensitivity,
                    contribution, share,
                ]
            )  # fmt: skip
            if share < _NEGLIGIBLE:
                small.append(contribution)
                continue
            cells = [SOURCES.get(line.source, line.source), line.type]
            shown.append([*head, *cells, plain(contribution * scale, 2), f"{100 * share:.1f} %"])
            head = [""] * 3
        if small:
            rest = math.hypot(*small)
            count = f"{len(small)} more" if len(small) < len(item.sources) else f"{len(small)} sources"
            shown.append([*head, count, "", plain(rest * scale, 2), f"{100 * (rest / u) ** 2:.2f} %"])
    return Table(
        name, "Uncertainty budget (GUM)",
        ("quantity", "value", "standard_uncertainty", "source", "type", "u_source", "sensitivity",
         "contribution", "share"),
        rows, ("", "value ± u", "95 %", "source", "type", "u", "share"), shown,
        "Largest contribution first. Type A: from the swings; B: stated in the configuration. Sources "
        "without a stated uncertainty contribute nothing; those below 0.5 % of the variance are summed here "
        "and listed one by one in budget.csv.",
    )  # fmt: skip


def monte_carlo_table(results: RunResults) -> Table:
    """Monte Carlo after JCGM 101 beside the budget."""
    found = results.monte_carlo or MonteCarlo()
    rows: list[list[Cell]] = []
    shown = []
    for name, item in found.quantities.items():
        scale = quantity(name).factor
        mean, u, low, high = item.mean, item.standard_uncertainty, item.lower_95, item.upper_95
        rows.append([name, mean, u, low, high, str(item.gum_holds)])
        if u == 0:
            continue
        value, half = results.budget[name].value, results.budget[name].expanded_uncertainty_95
        shown.append(
            [
                quantity(name).label, quantity(name).text(mean, u),
                interval(low * scale, high * scale),
                interval((value - half) * scale, (value + half) * scale),
                "agrees" if item.gum_holds else "take Monte Carlo's",
            ]
        )  # fmt: skip
    return Table(
        "monte-carlo", f"Monte Carlo propagation (JCGM 101), {found.draws:,} draws".replace(",", " "),
        ("quantity", "mean", "standard_uncertainty", "lower_95", "upper_95", "gum_holds"), rows,
        ("", "mean ± u", "95 % interval", "budget's interval", "budget"), shown,
    )  # fmt: skip


def series_table(series: Series) -> Table:
    """A series combined: exact, asymptotic, and the paper's way."""
    rows: list[list[Cell]] = []
    shown = []
    exact, asymptotic = (series.fits.get(method, {}) for method in (FitMethod.EXACT, FitMethod.ASYMPTOTIC))
    average = series.averaged_curves or AveragedCurves()
    verdicts = series_verdicts(exact)
    for name in exact or asymptotic:
        shown_as = quantity(name)
        cells = [getattr(exact.get(name), key, math.nan) for key in _SERIES_KEYS]
        item = asymptotic.get(name)
        others = [
            NOT_DETERMINED if item is None else Estimate(item.value, item.standard_uncertainty),
            average.parameters.get(name, NOT_DETERMINED),
        ]
        rows.append([name, *cells, *others[0], *others[1]])
        between = cells[4] * shown_as.factor
        shown.append(
            [
                shown_as.label,
                determined_text(name, Estimate(cells[0], cells[1]), verdicts),
                plain(cells[2] * shown_as.factor, 2),
                plain(between, 2) if between else "none seen",
                *(shown_as.text(value, u) for value, u in others),
            ]
        )  # fmt: skip
    return Table(
        "series", "The series",
        ("parameter", *(f"exact_{key}" for key in _SERIES_KEYS), "asymptotic_value",
         "asymptotic_standard_uncertainty", "averaged_curves_value", "averaged_curves_standard_uncertainty"),
        rows,
        ("", FitMethod.EXACT, "95 % (±)", "between runs", FitMethod.ASYMPTOTIC.heading,
         "curves averaged first"), shown,
        "Runs combined with their own and the between-run scatter, Student's t for the 95 % half-width; "
        "last, the paper's way: the runs' curves averaged, then Eqs. 5 and 6 fitted.",
    )  # fmt: skip


_SERIES_KEYS = (
    "value", "standard_uncertainty", "expanded_uncertainty_95", "within_runs", "between_runs",
    "p_homogeneous",
)  # fmt: skip
