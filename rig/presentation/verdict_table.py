"""Verdicts as a person reads them."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from rig.presentation.verdict import Check, Verdict


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
