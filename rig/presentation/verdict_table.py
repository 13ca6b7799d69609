"""Prints the table of preflight or doctor."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from rig.presentation.printing import folded
from rig.presentation.verdict import Verdict


def print_verdicts(console: Console, verdicts: Sequence[Verdict]) -> None:
    """Print the go / no-go table, and below it reason and remedy of each warning and each no-go."""
    table = Table(box=None, pad_edge=False, header_style="bold", expand=False)
    names = ["", "check", "found"]
    limited = any(verdict.limit for verdict in verdicts)
    for name in [*names, "limit"] if limited else names:
        table.add_column(name, overflow="fold")
    for verdict in verdicts:
        cells = [verdict.name, verdict.measured or verdict.reason]
        table.add_row(_mark(verdict), *cells, *([verdict.limit] if limited else []))
    console.print(table, highlight=False)
    for verdict in verdicts:
        if verdict.remedy:
            kind = "warning" if verdict.ok else "NO-GO"
            why = "; ".join(text for text in (verdict.reason, verdict.remedy) if text)
            _print(console, f"{kind} {verdict.name}: {why}")
    for reason in dict.fromkeys(v.reason for v in verdicts if not v.made and v.reason):
        found = ", ".join(v.name for v in verdicts if v.reason == reason)
        _print(console, f"not checked: {found}: {reason}")


def _print(console: Console, text: str) -> None:
    console.print(folded(text, console.width), highlight=False, markup=False)


def _mark(verdict: Verdict) -> str:
    if not verdict.made:
        return "[dim]-[/]"
    if not verdict.ok:
        return "[bold red]NO[/]"
    return "[yellow]warn[/]" if verdict.remedy else "[green]go[/]"
