"""What the terminal is told: lines, the preflight table, the table of results."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from processing.contact.laws import PAPER
from processing.fit import FitMethod, FitResult
from rig.analysis.other_instruments_series import reduce_series
from rig.analysis.results import RunResult
from rig.presentation import quantity


def print_results(results: Sequence[RunResult], paths: Sequence[tuple[str, Path]]) -> None:
    """The table of parameters of every run, then where everything is."""
    console = Console()
    for number, run in enumerate(results, start=1):
        head = (
            f"run {number}: {run.half_cycles} half-cycles, {run.initial_amplitude_arcsec:.2f} to "
            f"{run.final_amplitude_arcsec:.2f} {run.unit}, {run.frames} frames, {run.dropped_frames} dropped"
        )
        console.print(head, highlight=False, markup=False)
        if run.problem:
            console.print(f"  no fit: {run.problem}", highlight=False, markup=False)
        if run.fits:
            console.print(parameter_table(run.fits, run.surface_energy_j_per_m2))
        for line in run.evaluation.lines() if run.evaluation else ():
            console.print(f"  {line}", highlight=False, markup=False)
        for line in run.reduction.lines if run.reduction else ():
            console.print(f"  {line}", highlight=False, markup=False, soft_wrap=True)
        for warning in run.warnings:
            console.print(f"  note: {warning}", highlight=False, markup=False)
    for line in reduce_series([run.reduction for run in results if run.reduction])[1]:
        console.print(line, highlight=False, markup=False)
    for name, path in paths:
        console.print(f"{name:<12} {path}", highlight=False, markup=False, soft_wrap=True)


def parameter_table(fits: Mapping[str, FitResult], energy: Mapping[str, Any]) -> Table:
    """Parameters, a column a fit."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    headings = {method.value: method.heading for method in FitMethod}
    for name in fits:
        table.add_column(headings.get(name, name), justify="right")
    table.add_column("unit")
    for name in PAPER.names(drag=True):
        estimates = [fit.estimate(name) if name in fit.names else None for fit in fits.values()]
        if not any(estimates):
            continue
        cells = ["" if e is None else quantity(name).text(*e) for e in estimates]
        table.add_row(quantity(name).symbol, *cells, quantity(name).unit)
    if energy:
        for key in ("table2", "eq2"):
            shown = quantity(f"surface_energy_{key}_j_per_m2")
            cells = [
                shown.text(source[key]["value"], source[key]["standard_uncertainty"])
                for source in (energy[FitMethod.ASYMPTOTIC], energy)
            ]
            table.add_row(shown.symbol, *cells, shown.unit)
    table.add_row("chi2/dof", *(f"{fit.chi2_per_dof:.3f}" for fit in fits.values()), "")
    table.add_row("ARAE (8), (9)", *(f"{f.arae_decay:.2g}, {f.arae_period:.2g}" for f in fits.values()), "")
    return table
