"""`rig compare --against humidity`: parameters of every run over what surrounded it."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from processing.contact.laws import DEFAULT_LAW
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Estimate
from processing.fit import FitMethod
from processing.surroundings import Surroundings, in_other_unit
from rig.analysis import SessionResults
from rig.presentation import Cell, Table, palette, plain, quantity
from rig.report.drawing import ASYMPTOTIC, DATA, EXACT, ReportFigure, canvas

_FEWEST = 3
"""Runs of a straight line with an uncertainty."""


class Seen(NamedTuple):
    """One run of a series: where it lies, and the exact parameters with their standard uncertainties."""

    series: str
    run: str
    at: float
    parameters: Mapping[str, Estimate]


def chosen_surrounding(name: str) -> str:
    """The name of a quantity of the surroundings, which may be given without its unit.

    Raises
    ------
    ConfigurationError
        There is none of that name.
    """
    known = {field.name: field.name for field in fields(Surroundings)}
    known |= {key.rpartition("_")[0]: key for key in list(known)}
    if name not in known:
        short = sorted(set(known) - set(known.values()))
        raise ConfigurationError(f"--against {name}: there is no such quantity; there are {', '.join(short)}")
    return known[name]


def seen_runs(sessions: Mapping[str, SessionResults], name: str) -> list[Seen]:
    """The fitted runs of which a quantity of the surroundings is known.

    Raises
    ------
    RecordError
        It is known of fewer than two.
    """
    found = []
    fitted = [(label, run) for label, one in sessions.items() for run in one.runs if run.fits]
    for label, run in fitted:
        at = nan if run.surroundings is None else getattr(run.surroundings, name)
        if isfinite(at):
            exact = run.fits[FitMethod.EXACT]
            values = {key: exact.estimate(key) for key in DEFAULT_LAW.names()}
            found.append(Seen(label, run.record, at, values))
    if len(found) < 2:
        raise RecordError(
            f"--against {name}: known for {len(found)} of {len(fitted)} fitted runs, two are needed: state "
            "it in the configuration or let a sensor read it"
        )
    return found


def against_table(runs: Sequence[Seen], name: str) -> Table:
    """Every run for the file; for the eye the straight line through all runs of each parameter."""
    columns: list[str] = ["series", "run", name]
    for key in DEFAULT_LAW.names():
        columns += [key, f"u_{key}"]
    rows: list[list[Cell]] = []
    for run in runs:
        cells: list[Cell] = [run.series, run.run, run.at]
        for key in DEFAULT_LAW.names():
            cells += run.parameters.get(key, (nan, nan))
        rows.append(cells)
    over = quantity(name)
    shown = []
    for key in DEFAULT_LAW.names():
        slope, u, chance = _line(runs, key)
        if isfinite(u):
            of = quantity(key)
            factor = of.factor / over.factor
            unit = f"{of.unit or '1'}/{over.unit}"
            shown.append([of.symbol, plain(slope * factor, 3), plain(u * factor, 2), unit, plain(chance, 2)])
    note = f"{len(runs)} runs. Slope of a straight line, with u from the scatter of the runs about it; "
    note += "chance: the probability of a slope this steep if there is no dependence."
    if not shown:
        note = f"{len(runs)} runs: too few, or all at the same value, for a line."
    other = in_other_unit(name, {f"{run.series} {run.run}": run.at for run in runs})
    note += f" {other}." if other else ""
    return Table(
        "against", f"Parameters against {over.name}", columns, rows,
        ("", "slope", "u", "unit", "chance"), shown, note,
    )  # fmt: skip


def _line(runs: Sequence[Seen], key: str) -> tuple[float, float, float]:
    """Slope, its standard uncertainty and the chance of one so large; NaN where there is no line."""
    from scipy.special import stdtr

    known = np.array([(run.at, *tuple(run.parameters[key])) for run in runs if key in run.parameters])
    if len(known) < _FEWEST or np.ptp(known[:, 0]) == 0 or not np.all(known[:, 2] > 0):
        return nan, nan, nan
    weight = known[:, 2] ** -2.0
    x = known[:, 0] - np.average(known[:, 0], weights=weight)
    y = known[:, 1] - np.average(known[:, 1], weights=weight)
    power = float(weight @ x**2)
    slope = float(weight @ (x * y)) / power
    dof = len(known) - 2
    u = float(np.sqrt(weight @ (y - slope * x) ** 2 / dof / power))
    return slope, u, 2 * float(stdtr(dof, -abs(slope) / u)) if u else 0.0


def against_figure(runs: Sequence[Seen], name: str) -> ReportFigure:
    """One panel a parameter, one point a run with its standard uncertainty, one colour a series."""
    names = [key for key in DEFAULT_LAW.names() if any(key in run.parameters for run in runs)]
    rows = (len(names) + 2) // 3
    figure = canvas(0.5 + 1.9 * rows)
    panels = figure.subplots(rows, 3, squeeze=False, sharex=True)
    figure.subplots_adjust(left=0.1, right=0.985, bottom=0.13, top=0.86, wspace=0.5, hspace=0.45)
    over = quantity(name)
    labels = list(dict.fromkeys(run.series for run in runs))
    colours = dict(zip(labels, (DATA, EXACT, ASYMPTOTIC, *palette.SEQUENCE) * len(labels), strict=False))
    for axes, key in zip(panels.flat, names, strict=False):
        of = quantity(key)
        for label in labels:
            seen = [run for run in runs if run.series == label and key in run.parameters]
            if seen:
                value, u = np.array([tuple(run.parameters[key]) for run in seen]).T * of.factor
                at = np.array([run.at for run in seen]) * over.factor
                style = {"color": colours[label], "label": label}
                axes.errorbar(at, value, u, fmt="o", ms=4, capsize=2.5, elinewidth=0.9, **style)
        axes.set_title(of.label)
        axes.tick_params(axis="y", labelsize=7)
        axes.ticklabel_format(axis="y", useOffset=False, scilimits=(-3, 4))
    for axes in panels[-1]:
        axes.set_xlabel(over.label)
    figure.legend(*panels.flat[0].get_legend_handles_labels(), loc="upper center", ncols=4)
    for axes in list(panels.flat)[len(names) :]:
        axes.set_visible(False)
    return ReportFigure(
        "against",
        f"Parameters against {over.name}",
        "Exact fit of every run with its standard uncertainty, of the swings alone.",
        figure,
    )
