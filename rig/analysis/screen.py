"""What the terminal is told: lines, the preflight table, the table of results."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from processing.fit.result import CONTACT_NAMES, FitResult
from rig.analysis.other_instruments_series import reduce_series
from rig.analysis.results import RunResult, plain_values
from rig.control.ports import Check
from rig.measure.preflight import Verdict

DISPLAY = {
    "b": ("b", "rad^-p", 1.0),
    "p": ("p", "", 1.0),
    "c": ("c", "", 1.0),
    "n": ("n", "", 1.0),
    "period0_s": ("T0", "s", 1.0),
    "gamma_pa": ("gamma", "MPa", 1e-6),
}
"""How a parameter is printed: symbol, unit, and the factor to that unit."""


def say(text: str, *, error: bool = False) -> None:
    """One line on stderr, where it does not mix with what a program reads from stdout."""
    print(f"rig: {text}" if error else text, file=sys.stderr, flush=True)


def print_json_line(kind: str, values: Mapping[str, Any]) -> None:
    """One JSON object on one line of stdout; what is not a number is null."""
    print(json.dumps({"kind": kind, **plain_values(values)}), flush=True)


def print_preflight(console: Console, verdicts: Sequence[Verdict]) -> None:
    """The go / no-go table; below it why and what to do for each no."""
    table = Table(box=None, pad_edge=False, header_style="bold", expand=False)
    for name in ("", "check", "measured", "limit"):
        table.add_column(name, overflow="fold")
    for verdict in verdicts:
        mark = _mark(verdict, "go") if verdict.made else "[dim]-[/]"
        table.add_row(mark, verdict.name, verdict.measured, verdict.limit)
    console.print(table, highlight=False)
    for verdict in verdicts:
        if verdict.remedy:
            kind = "warning" if verdict.ok else "NO-GO"
            text = f"{kind} {verdict.name}: {verdict.reason}; {verdict.remedy}"
            console.print(text, highlight=False, markup=False)
    for reason in dict.fromkeys(v.reason for v in verdicts if not v.made and v.reason):
        names = ", ".join(v.name for v in verdicts if v.reason == reason)
        console.print(f"not measured: {names}: {reason}", highlight=False, markup=False)


def print_checks(checks: Sequence[Check]) -> None:
    """What was looked over; a remedy below each no."""
    console = Console()
    table = Table(box=None, pad_edge=False, show_header=False)
    for check in checks:
        table.add_row(_mark(check, "ok"), check.name, check.reason)
        if check.remedy:
            table.add_row("", "", f"-> {check.remedy}")
    console.print(table, highlight=False)


def _mark(line: Verdict | Check, well: str) -> str:
    """A warning is ok and has a remedy all the same."""
    if not line.ok:
        return "[bold red]NO[/]"
    return "[yellow]warn[/]" if line.remedy else f"[green]{well}[/]"


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


def value_with_uncertainty(estimate: tuple[float, float], scale: float = 1.0) -> str:
    """Value and standard uncertainty, to two digits of the uncertainty: ``(3.7330 ± 0.0012)e-03``."""
    value, u = estimate[0] * scale, estimate[1] * scale
    if not math.isfinite(value):
        return "not determined"
    if not math.isfinite(u) or u <= 0:
        return f"{value:.6g} ± ?"
    exponent = math.floor(math.log10(max(abs(value), u)))
    shift = 0 if -3 <= exponent <= 4 else exponent
    digits = max(0, 1 - math.floor(math.log10(u / 10.0**shift)))
    text = f"{value / 10.0**shift:.{digits}f} ± {u / 10.0**shift:.{digits}f}"
    return f"({text})e{shift:+03d}" if shift else text


def print_table(table: Table) -> None:
    """A table on stdout."""
    Console().print(table)


def parameter_table(fits: Mapping[str, FitResult], energy: Mapping[str, Any]) -> Table:
    """Parameters, a column a fit."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for name in fits:
        table.add_column(name, justify="right")
    table.add_column("unit")
    for name in (*CONTACT_NAMES, "drag_s"):
        estimates = [fit.estimate(name) if name in fit.names else None for fit in fits.values()]
        if not any(estimates):
            continue
        symbol, unit, scale = DISPLAY.get(name, ("drag", "s", 1.0))
        cells = ["" if e is None else value_with_uncertainty(e, scale) for e in estimates]
        table.add_row(symbol, *cells, unit)
    if energy:
        for key, label in (("table2", "sigma (Table 2)"), ("eq2", "sigma (Eq. 2)")):
            cells = [
                value_with_uncertainty((source[key]["value"], source[key]["standard_uncertainty"]), 1e3)
                for source in (energy["asymptotic"], energy)
            ]
            table.add_row(label, *cells, "mJ/m^2")
    table.add_row("chi2/dof", *(f"{fit.chi2_per_dof:.3f}" for fit in fits.values()), "")
    table.add_row("ARAE (8), (9)", *(f"{f.arae_decay:.2g}, {f.arae_period:.2g}" for f in fits.values()), "")
    return table
