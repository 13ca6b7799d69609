"""`rig compare`: series of several samples, days, humidities beside each other."""

from collections.abc import Mapping, Sequence
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from processing.contact.laws import PAPER
from processing.errors import RecordError
from processing.estimate import Estimate
from processing.fit import Combined, Comparison, FitMethod, FittedContact, SeriesResult, compare_series
from rig.analysis import read_results
from rig.presentation import (
    Cell,
    Table,
    determined_text,
    number,
    plain,
    quantity,
    series_verdicts,
)
from rig.report import html
from rig.report.drawing import styled
from rig.report.figures_contact import comparison_figure
from rig.report.session_report import save_figures, save_tables

DIFFERENT = 0.05
"""Chance, shared between all pairs and parameters, below which series are said to differ."""


def compare(folders: Sequence[Path], output: Path | None) -> list[Table]:
    """Tables of several sessions' exact parameters and of their differences.

    With `output` (an HTML file) a page with the plot is written, figures and CSV beside it.

    Raises RecordError for fewer than two folders, or one without fits.
    """
    if len(folders) < 2:
        raise RecordError(f"{len(folders)} folder: a comparison needs at least two sessions")
    series = {_label(folder, folders): series_of(folder) for folder in folders}
    verdicts = [verdicts_of(folder) for folder in folders]
    tables = [values_table(series, verdicts), differences_table(compare_series(series))]
    if output is not None:
        files = output.parent / output.stem
        names = [name for name in PAPER.names() if all(name in s.parameters for s in series.values())]
        bars = {
            label: {name: (item.value, item.expanded) for name, item in found.parameters.items()}
            for label, found in series.items()
        }
        try:
            files.mkdir(parents=True, exist_ok=True)
            save_tables(tables, files)
            with styled():
                figures = save_figures([comparison_figure(names, bars)], files)
            body = [*figures, *(html.table(content) for content in tables)]
            output.write_text(html.page("Series compared", ", ".join(series), body), encoding="utf-8")
        except OSError as error:
            raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
    return tables


def _label(folder: Path, folders: Sequence[Path]) -> str:
    """The folder's own name, or its whole path where two share the name."""
    if sum(other.resolve() == folder.resolve() for other in folders) > 1:
        raise RecordError(f"{folder}: named twice; a comparison needs different sessions")
    name = folder.resolve().name
    return name if sum(other.resolve().name == name for other in folders) == 1 else str(folder)


def series_of(folder: Path) -> SeriesResult:
    """The exact parameters of a session: the combined ones of a series, else those of its one fitted run.

    Raises RecordError where nothing was fitted.
    """
    tree = read_results(folder)
    combined = (tree.get("series") or {}).get(FitMethod.EXACT)
    if combined:
        parameters = {name: _combined(name, item) for name, item in combined.items()}
    else:
        fitted = [run for run in tree["runs"] if run.get("fits")]
        if not fitted:
            raise RecordError(f"{folder}: no run of it was fitted ({tree['runs'][0].get('problem')})")
        parameters = _single(fitted[0]["fits"][FitMethod.EXACT])
    names = tuple(parameters)
    u = np.array([parameters[name].standard_uncertainty for name in names])
    together = FittedContact(
        names, np.array([parameters[name].value for name in names]), np.diag(u**2),
        float(min(item.dof for item in parameters.values())), np.zeros(len(names)), nan,
    )  # fmt: skip
    return SeriesResult(parameters, (), together)


def verdicts_of(folder: Path) -> dict[str, Mapping[str, Any]]:
    """By parameter, whether a session's data determine it, as its report says it."""
    tree = read_results(folder)
    combined = (tree.get("series") or {}).get(FitMethod.EXACT)
    if combined:
        return dict(series_verdicts(combined))
    fitted: Mapping[str, Any] = next((run for run in tree["runs"] if run.get("fits")), {})
    return {item["name"]: item for item in fitted.get("identifiability") or []}


def _combined(name: str, item: Mapping[str, Any]) -> Combined:
    return Combined(
        name,
        number(item, "value"),
        number(item, "standard_uncertainty"),
        int(number(item, "degrees_of_freedom")),
        number(item, "expanded_uncertainty_95"),
        number(item, "within_runs"),
        number(item, "between_runs"),
        number(item, "p_homogeneous"),
        tuple(Estimate(number(run, "value"), number(run, "standard_uncertainty")) for run in item["runs"]),
    )


def _single(fit: Mapping[str, Any]) -> dict[str, Combined]:
    """One run as a series of its own: what scatters between runs is not known of it."""
    dof = int(number(fit, "degrees_of_freedom"))
    found = {}
    for name in PAPER.names():
        value, u = number(fit, name), number(fit, name, "standard_uncertainty")
        if isfinite(value) and isfinite(u):
            half = float(stdtrit(dof, 0.975)) * u
            found[name] = Combined(name, value, u, dof, half, u, 0.0, nan, (Estimate(value, u),))
    return found


def values_table(
    series: Mapping[str, SeriesResult], verdicts: Sequence[Mapping[str, Mapping[str, Any]]]
) -> Table:
    """One row a parameter, one column a series; what is not determined as interval or bound."""
    names = [name for name in PAPER.names() if any(name in found.parameters for found in series.values())]
    rows: list[list[Cell]] = []
    shown = []
    for name in names:
        items = [found.parameters.get(name) for found in series.values()]
        cells: list[Cell] = [name]
        for item in items:
            cells += (
                [nan, nan, nan] if item is None else [item.value, item.standard_uncertainty, item.expanded]
            )
        rows.append(cells)
        texts = [
            "–" if item is None else determined_text(name, item.value, item.standard_uncertainty, known)
            for item, known in zip(items, verdicts, strict=True)
        ]
        shown.append([quantity(name).label, *texts])
    columns = [f"{label}_{what}" for label in series for what in ("value", "u", "expanded_95")]
    runs = ", ".join(f"{label}: {len(_runs(found))}" for label, found in series.items())
    return Table(
        "values", "Parameters of each series", ("parameter", *columns), rows, ("", *series), shown,
        f"Exact fits, value ± standard uncertainty of the swings. Runs: {runs}.",
    )  # fmt: skip


def _runs(found: SeriesResult) -> tuple[Estimate, ...]:
    return next(iter(found.parameters.values())).runs


def differences_table(comparisons: Sequence[Comparison]) -> Table:
    """Every pair of series, parameter by parameter."""
    limit = DIFFERENT / max(len(comparisons), 1)
    rows: list[list[Cell]] = []
    shown = []
    for item in comparisons:
        verdict = "differ" if item.p_value < limit else "no difference seen"
        rows.append(
            [
                item.first,
                item.second,
                item.name,
                item.difference,
                item.standard_uncertainty,
                item.p_value,
                verdict,
            ]
        )
        shown.append(
            [
                f"{item.first} − {item.second}", quantity(item.name).label,
                quantity(item.name).text(item.difference, item.standard_uncertainty),
                plain(item.p_value, 2), verdict,
            ]
        )  # fmt: skip
    return Table(
        "differences", "Differences",
        ("first", "second", "parameter", "difference", "standard_uncertainty", "p_value", "verdict"), rows,
        ("", "", "difference", "chance", "verdict"), shown,
        "Welch's t. The chance is that of so large a difference between series that are alike; 5 % is shared "
        "between all rows. Mass, radius and scale, which move all series together, are left out.",
    )  # fmt: skip
