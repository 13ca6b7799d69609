"""Results at the terminal: a table of parameters for every run, and what is said about them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from processing.contact.laws import PAPER
from processing.fit import FitMethod
from rig.analysis.results import Fit, RunResults, SessionResults, SurfaceEnergies
from rig.presentation import quantity


def print_results(results: SessionResults, paths: Sequence[tuple[str, Path]]) -> None:
    """The table of parameters of every run, then where everything is."""
    console = Console()
    for number, run in enumerate(results.runs, start=1):
        head = (
            f"run {number}: {run.half_cycles} half-cycles, {run.initial_amplitude:.2f} to "
            f"{run.final_amplitude:.2f} {run.amplitude_unit}, {run.frames} frames, "
            f"{run.dropped_frames} dropped"
        )
        console.print(head, highlight=False, markup=False)
        if run.problem:
            console.print(f"  no fit: {run.problem}", highlight=False, markup=False)
        if run.fits:
            console.print(parameter_table(run.fits, run.surface_energy_j_per_m2))
        for line in _verdicts(run):
            console.print(f"  {line}", highlight=False, markup=False)
        for line in run.instrument.text if run.instrument else ():
            console.print(f"  {line}", highlight=False, markup=False, soft_wrap=True)
        for warning in run.warnings:
            console.print(f"  note: {warning}", highlight=False, markup=False)
    if results.series is not None and results.series.instrument is not None:
        for line in results.series.instrument.text:
            console.print(line, highlight=False, markup=False)
    for name, path in paths:
        console.print(f"{name:<12} {path}", highlight=False, markup=False, soft_wrap=True)


def _verdicts(run: RunResults) -> list[str]:
    """What is said about a fit beyond its numbers, a line each."""
    found = [run.drag.text] if run.drag else []
    found += [item.text for item in run.identifiability if item.verdict != "determined"]
    if run.strong_correlations:
        pairs = ", ".join(f"{a}/{b} {value:+.3f}" for a, b, value in run.strong_correlations[:3])
        found.append(f"hardly told apart (correlation): {pairs}")
    return [*found, *run.notes]


def parameter_table(fits: Mapping[str, Fit], energy: SurfaceEnergies | None) -> Table:
    """Parameters, a column a fit."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    headings = {method.value: method.heading for method in FitMethod}
    for name in fits:
        table.add_column(headings.get(name, name), justify="right")
    table.add_column("unit")
    for name in PAPER.names(drag=True):
        estimates = [fit.parameters.get(name) for fit in fits.values()]
        if not any(estimates):
            continue
        shown = quantity(name)
        cells = ["" if e is None else shown.text(*e) for e in estimates]
        table.add_row(shown.symbol, *cells, shown.unit)
    if energy is not None:
        of_fits = [energy.of(name) for name in fits]
        for form in ("table2", "eq2"):
            shown = quantity(f"surface_energy_{form}_j_per_m2")
            texts = ["" if found is None else shown.text(*getattr(found, form)) for found in of_fits]
            table.add_row(shown.symbol, *texts, shown.unit)
    table.add_row("chi2/dof", *(f"{fit.chi2_per_dof:.3f}" for fit in fits.values()), "")
    table.add_row("ARAE (8), (9)", *(f"{f.arae_decay:.2g}, {f.arae_period:.2g}" for f in fits.values()), "")
    return table
