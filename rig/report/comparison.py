"""`rig compare`: compares series of several samples, days or humidities."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition import atomic_write
from processing.ambient import AmbientConditions, other_unit_warning
from processing.contact.laws import DEFAULT_LAW
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Estimate
from processing.fit import FitMethod
from processing.series import CombinedValue, Comparison, combine, compare_series
from rig.analysis import (
    HISTORY_KEYS,
    SURFACE_ENERGY,
    ResultRow,
    RunResults,
    SessionResults,
    plain_row,
    read_results,
)
from rig.report import html
from rig.report.drawing import ASYMPTOTIC, DATA, EXACT, ReportFigure, three_columns
from rig.report.figures_contact import comparison_figure
from rig.terminal import (
    Cell,
    Table,
    TableRow,
    palette,
    plain,
    quantity,
    written,
)

_MIN_RUNS = 3
"""Fewest runs for a fitted line whose slope has an uncertainty."""


class RunAtCondition(NamedTuple):
    """A fitted run of a series, and the value of an ambient condition."""

    series: str
    run: RunResults
    ambient_value: float

    def estimate(self, key: str) -> Estimate:
        """A parameter of the exact fit."""
        return self.run.fits[FitMethod.EXACT].estimate(key)


def ambient_condition_name(name: str) -> str:
    """Full name of an ambient condition, which may be given without its unit.

    Raises ConfigurationError for an unknown name.
    """
    known = {field.name: field.name for field in fields(AmbientConditions)}
    known |= {key.rpartition("_")[0]: key for key in list(known)}
    if name not in known:
        short = sorted(set(known) - set(known.values()))
        raise ConfigurationError(f"--against {name}: there is no such quantity; there are {', '.join(short)}")
    return known[name]


def runs_with_condition(sessions: Mapping[str, SessionResults], name: str) -> list[RunAtCondition]:
    """The fitted runs for which an ambient condition is known; raises RecordError for fewer than two."""
    fitted = [
        RunAtCondition(label, run, getattr(run.ambient, name, nan))
        for label, one in sessions.items()
        for run in one.runs
        if run.fits
    ]
    found = [run for run in fitted if isfinite(run.ambient_value)]
    if len(found) < 2:
        history = HISTORY_KEYS.get(name)
        remedy = f"session.{history}" if history else f"environment.{name}, or let a sensor read it"
        raise RecordError(
            f"--against {name}: known for {len(found)} of {len(fitted)} fitted runs, two are needed: state "
            f"{remedy}"
        )
    return found


def ambient_table(runs: Sequence[RunAtCondition], name: str) -> Table:
    """Table of parameters against an ambient condition: runs in the CSV, fitted lines where it is shown."""
    columns = ["series", "run", name, *(each for key in DEFAULT_LAW.names() for each in (key, f"u_{key}"))]
    lines = []
    for run in runs:
        numbers = (number for key in DEFAULT_LAW.names() for number in run.estimate(key))
        lines.append(TableRow([run.series, run.run.record, run.ambient_value, *numbers]))
    over = quantity(name)
    for key in DEFAULT_LAW.names():
        slope, u, chance = _line(runs, key)
        if isfinite(u):
            of = quantity(key)
            factor = of.factor / over.factor
            unit = f"{of.unit or '1'}/{over.unit}"
            texts = [of.symbol, plain(slope * factor, 3), plain(u * factor, 2), unit, plain(chance, 2)]
            lines.append(TableRow((), texts))
    note = f"{len(runs)} runs. Slope of a straight line, with u from the scatter of the runs about it; "
    note += "chance: the probability of a slope this steep if there is no dependence."
    if len(lines) == len(runs):
        note = f"{len(runs)} runs: too few, or all at the same value, for a line."
    other = other_unit_warning(name, {f"{run.series} {run.run.record}": run.ambient_value for run in runs})
    note += f" {other}." if other else ""
    return Table(
        "against", f"Parameters against {over.name}", columns,
        ("", "slope", "u", "unit", "chance"), lines, note,
    )  # fmt: skip


def _line(runs: Sequence[RunAtCondition], key: str) -> tuple[float, float, float]:
    """Slope, its u, and the probability of a slope as large by chance; NaN without a line."""
    from scipy.special import stdtr

    known = np.array([(run.ambient_value, *run.estimate(key)) for run in runs])
    if len(known) < _MIN_RUNS or np.ptp(known[:, 0]) == 0 or not np.all(known[:, 2] > 0):
        return nan, nan, nan
    # about the middle: far from zero the slope would lose digits
    x, y, weight = known[:, 0] - known[:, 0].mean(), known[:, 1], 1 / known[:, 2]
    found, covariance = np.polyfit(x, y, 1, w=weight, cov=True)
    slope, u = float(found[0]), float(np.sqrt(covariance[0, 0]))
    return slope, u, 2 * float(stdtr(len(known) - 2, -abs(slope) / u)) if u else 0.0


def ambient_figure(runs: Sequence[RunAtCondition], name: str) -> ReportFigure:
    """Figure of parameters against an ambient condition: a panel each, a point a run, a colour a series."""
    names = DEFAULT_LAW.names()
    margins = {"left": 0.1, "bottom": 0.13, "top": 0.86, "wspace": 0.5, "hspace": 0.45}
    figure, panels = three_columns(len(names), lambda rows: 0.5 + 1.9 * rows, **margins)
    over = quantity(name)
    labels = list(dict.fromkeys(run.series for run in runs))
    colours = dict(zip(labels, (DATA, EXACT, ASYMPTOTIC, *palette.SEQUENCE) * len(labels), strict=False))
    for axes, key in zip(panels, names, strict=True):
        of = quantity(key)
        for label in labels:
            seen = [run for run in runs if run.series == label]
            value, u = np.array([tuple(run.estimate(key)) for run in seen]).T * of.factor
            at = np.array([run.ambient_value for run in seen]) * over.factor
            axes.errorbar(
                at, value, u, fmt="o", ms=4, capsize=2.5, elinewidth=0.9, color=colours[label], label=label
            )
        axes.set_title(of.label)
        axes.tick_params(axis="y", labelsize=7)
        axes.ticklabel_format(axis="y", useOffset=False, scilimits=(-3, 4))
    for axes in panels[-3:]:
        axes.set_xlabel(over.label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="upper center", ncols=4)
    return ReportFigure(
        "against",
        f"Parameters against {over.name}",
        "Exact fit of every run with its standard uncertainty, of the swings alone.",
        figure,
    )


_DECAY_QUANTITIES = ("mean_period_s", "log_decrement")
"""Quantities that are compared if no run was fitted."""
_MIN_SHOWN_U = 3.0
"""Smallest difference of two single runs that is shown, in standard uncertainties."""
SIGNIFICANCE_LEVEL = 0.05
"""Significance level of a difference, shared by all pairs of series and parameters."""


def compare(folders: Sequence[Path], output: Path | None, against: str = "") -> list[Table]:
    """Tables of several sessions' exact parameters and of their differences.

    With `output` (an HTML file) a page with the plot is written, and figures and CSV next to it. `against`
    names an ambient condition against which the parameters of all runs are tabulated and plotted, too; one
    session is then enough.

    Raises RecordError for a folder without fits, ConfigurationError for a folder named twice, a run that two
    folders hold, or unknown `against`.
    """
    over = ambient_condition_name(against) if against else ""
    sessions = {}
    for folder in folders:
        found = read_results(folder)
        origin = " (SIMULATED)" if any(run.simulated for run in found.runs) else ""
        sessions[_label(folder, folders) + origin] = found
    _refuse_shared_runs(sessions)
    fitted = any(_combined_of(found) or any(run.fits for run in found.runs) for found in sessions.values())
    series = {
        label: (series_of if fitted else decays_of)(found, folder)
        for (label, found), folder in zip(sessions.items(), folders, strict=True)
    }
    seen = runs_with_condition(sessions, over) if over else []
    rows = {label: rows_of(found, series[label]) for label, found in sessions.items()}
    tables = [values_table(series, rows, _seismometer_note(sessions))]
    tables += [differences_table(compare_series(series))] if len(series) > 1 else []
    tables += [ambient_table(seen, over)] if over else []
    if output is not None:
        files = output.parent / output.stem
        compared = (*DEFAULT_LAW.names(), *_DECAY_QUANTITIES)
        names = [name for name in compared if all(name in known for known in rows.values())]
        with written(output, "name"):
            figures = html.save_parts(
                files,
                tables,
                lambda: [comparison_figure(names, rows), *([ambient_figure(seen, over)] if over else [])],
            )
            body = [*figures.values(), *(html.table(content) for content in tables)]
            page = html.page("Series compared", ", ".join(series), body)
            atomic_write.write_new(output, page.encode())
    return tables


def _label(folder: Path, folders: Sequence[Path]) -> str:
    """The name of a folder, or its whole path if two share the name."""
    if sum(other.resolve() == folder.resolve() for other in folders) > 1:
        raise ConfigurationError(f"{folder}: named twice; a comparison needs different sessions")
    name = folder.resolve().name
    return name if sum(other.resolve().name == name for other in folders) == 1 else str(folder)


def _refuse_shared_runs(sessions: Mapping[str, SessionResults]) -> None:
    """Raise ConfigurationError for a run of two sessions, whose difference is no difference of contacts."""
    for (other, earlier), (label, later) in combinations(sessions.items(), 2):
        for run in later.runs:
            if any(run.is_of_same_motion(one) for one in earlier.runs):
                raise ConfigurationError(
                    f"{label}: its {run.record} is a run of {other} (same hash); a comparison needs "
                    "different runs"
                )


def series_of(session: SessionResults, folder: Path) -> Mapping[str, CombinedValue]:
    """The exact parameters of a session: combined over its series, else of its one fitted run.

    Raises RecordError if nothing was fitted.
    """
    if combined := _combined_of(session):
        return combined
    if session.series is not None and session.series.fits:
        raise RecordError(f"{folder}: its runs together determine no parameter of the contact")
    run = next((run for run in session.runs if run.fits), None)
    if run is None:
        raise RecordError(f"{folder}: no run of it was fitted ({session.runs[0].problem})")
    dof = run.fits[FitMethod.EXACT].degrees_of_freedom
    rows = (row for name in DEFAULT_LAW.names() if (row := run.rows.get(name)) is not None)
    single = {row.quantity: _single_run(Estimate(row.value, row.u), dof) for row in rows if row.determined}
    if not single:
        raise RecordError(f"{folder}: its run determines no parameter of the contact")
    return single


def decays_of(session: SessionResults, folder: Path) -> Mapping[str, CombinedValue]:
    """Period and decrement of a session without fits: means over its decays, or values of its only decay.

    Raises RecordError if it has no decay.
    """
    runs = [run for run in session.runs if run.number("mean_period_s").value > 0]
    if not runs:
        raise RecordError(f"{folder}: has no decay ({session.runs[0].problem})")
    if len(runs) == 1:
        dof = max(runs[0].half_cycles - 2, 1)
        return {name: _single_run(runs[0].number(name), dof) for name in _DECAY_QUANTITIES}
    # all runs share one clock: its u is not averaged out
    by_clock = [
        0.0 if run.clock is None else run.clock.u_rate * run.number("mean_period_s").value for run in runs
    ]
    shared = {"mean_period_s": by_clock}
    return {
        name: combine(name, [run.number(name) for run in runs], shared.get(name, ()))
        for name in _DECAY_QUANTITIES
    }


def rows_of(session: SessionResults, series: Mapping[str, CombinedValue]) -> Mapping[str, ResultRow]:
    """The table of results of a session: of its series, of its one fitted run, or of its mean decay."""
    if rows := {row.quantity: row for row in session.table if row.fit == FitMethod.EXACT}:
        return rows
    return {
        name: plain_row(
            name,
            item.estimate,
            "series",
            lower=item.value - item.expanded_uncertainty_95,
            upper=item.value + item.expanded_uncertainty_95,
        )
        for name, item in series.items()
    }


def _combined_of(session: SessionResults) -> Mapping[str, CombinedValue]:
    """The parameters that have a mean: those whose runs only limit them have none to compare."""
    if session.series is None:
        return {}
    combined = session.series.fits.get(FitMethod.EXACT, {})
    return {name: item for name, item in combined.items() if isfinite(item.value)}


def _single_run(estimate: Estimate, dof: int) -> CombinedValue:
    """One run as a series of its own; without a scatter of runs it cannot be tested."""
    value, u = estimate
    return CombinedValue(
        value=value,
        standard_uncertainty=u,
        degrees_of_freedom=dof,
        within_runs=u,
        between_runs=0.0,
        runs=(estimate,),
    )


def values_table(
    series: Mapping[str, Mapping[str, CombinedValue]], found: Mapping[str, Mapping[str, ResultRow]], note: str
) -> Table:
    """Table with a row for each quantity and a column for each series; bounds if undetermined."""
    known = {name for rows in found.values() for name in rows}
    names = [name for name in (*DEFAULT_LAW.names(), SURFACE_ENERGY, *_DECAY_QUANTITIES) if name in known]
    lines = []
    for name in names:
        items = [each.get(name) for each in found.values()]
        cells: list[Cell] = [name]
        for row in items:
            numbers = (nan,) * 4 if row is None else (row.value, row.u_total, row.lower, row.upper)
            cells += [*numbers, "" if row is None else row.verdict]
        texts = ("–" if row is None else row.text for row in items)
        lines.append(TableRow(cells, [quantity(name).label, *texts]))
    what = ("value", "u_total", "lower_95", "upper_95", "verdict")
    columns = [f"{label}_{each}" for label in series for each in what]
    runs = ", ".join(f"{label}: {len(next(iter(one.values())).runs)}" for label, one in series.items())
    return Table(
        "values", "Parameters of each series", ("parameter", *columns), ("", *series), lines,
        ("Means over the decays" if known <= set(_DECAY_QUANTITIES) else "Exact fits")
        + f", value ± standard uncertainty of swings and apparatus, as far as stated. Runs: {runs}.{note}",
    )  # fmt: skip


def _seismometer_note(sessions: Mapping[str, SessionResults]) -> str:
    """Number of runs of each series fitted with an auxiliary seismometer, in words; empty if none."""
    notes = []
    for label, session in sessions.items():
        used = sum(run.seismometer is not None and run.seismometer.used for run in session.runs)
        notes += [f"{label}: {used} of {len(session.runs)} runs"] if used else []
    return f" With a seismometer: {', '.join(notes)}." if notes else ""


def differences_table(comparisons: Sequence[Comparison]) -> Table:
    """Table of the differences of all pairs of series; those of two single runs have no test."""
    limit = SIGNIFICANCE_LEVEL / max(sum(isfinite(item.p_value) for item in comparisons), 1)
    untested = sum(not isfinite(item.p_value) for item in comparisons)
    lines = []
    for item in comparisons:
        verdict = "differ" if item.p_value < limit else "no difference seen"
        if not isfinite(item.p_value):
            far = abs(item.difference) > _MIN_SHOWN_U * item.standard_uncertainty
            verdict = "not tested" if far else "not tested, within the swings' u"
        difference, of = (item.difference, item.standard_uncertainty), quantity(item.name)
        chance = plain(item.p_value, 2) if isfinite(item.p_value) else "–"
        is_shown = verdict in ("differ", "not tested")
        shown = [f"{item.first} − {item.second}", of.label, of.text(*difference), chance, verdict]
        cells: list[Cell] = [item.first, item.second, item.name, *difference, item.p_value, verdict]
        lines.append(TableRow(cells, shown if is_shown else ()))
    tested = len(lines) - untested
    notes = []
    if tested:
        differ = sum(line.cells[-1] == "differ" for line in lines)
        notes.append(
            f"{differ} of {tested} comparisons differ (-o FILE.html writes all of them). Welch's t test; "
            "chance: the probability of a difference at least as large between identical series, the 5 % "
            "level being shared by all rows."
        )
    if untested:
        far_apart = sum(line.cells[-1] == "not tested" for line in lines) or "none"
        notes.append(
            f"{untested} comparisons are of two single runs, {far_apart} of which differ by more than "
            f"{_MIN_SHOWN_U:g} u: their u is of half-cycles only, and how runs of one contact scatter, which "
            "may be many times more, is not known; measure series (rig fit A1 A2 A3 combines runs, rig "
            "compare --model default --by-sample takes their scatter)."
        )
    notes.append("Errors common to all series (mass, radius, scale) are left out.")
    return Table(
        "differences", "Differences",
        ("first", "second", "parameter", "difference", "standard_uncertainty", "p_value", "verdict"),
        ("", "", "difference", "chance", "verdict"), lines,
        " ".join(notes),
    )  # fmt: skip
