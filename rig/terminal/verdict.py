"""The verdict of one check of preflight or doctor, with finding and remedy, and the table of verdicts."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table
from rich.text import Text

from rig.terminal.printing import folded


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the table of preflight or doctor.

    Attributes
    ----------
    ok
        Whether a measurement is possible. A result that is ok and has a remedy is a warning.
    reason
        The finding, or the reason of a failure; empty if `measured` is sufficient.
    remedy
        What to do; empty if nothing is to be done.
    measured, limit
        Value and limit of a measurement, with units.
    made
        False if there was nothing to check, for the stated reason; `ok` is then True.
    """

    name: str
    ok: bool
    reason: str = ""
    remedy: str = ""
    measured: str = ""
    limit: str = ""
    made: bool = True

    @classmethod
    def failed(cls, name: str, error: Exception, remedy: str = "") -> "Verdict":
        """The verdict of an error; the remedy follows a semicolon in its message, or else is `remedy`."""
        reason, _, own = str(error).partition("; ")
        return cls(name, False, reason, own or remedy)

    @classmethod
    def checked(cls, name: str, ok: bool, finding: str, remedy: str, fault: str = "") -> "Verdict":
        """The verdict of a check: its `finding`, or else its `fault`, if that differs, and `remedy`."""
        return cls(name, ok, finding) if ok else cls(name, ok, fault or finding, remedy)

    @property
    def line(self) -> str:
        """The verdict in one line: `beam quality: go, one Gaussian, ...`, with reason and remedy."""
        return f"{self.name}: {self.judgement_text}"

    @property
    def found(self) -> str:
        """Value with its limit, and reason, as far as they exist."""
        value = f"{self.measured} (limit {self.limit})" if self.limit else self.measured
        return "; ".join(text for text in (value, self.reason) if text)

    @property
    def judgement_text(self) -> str:
        """The line without its name."""
        judged = (
            "NO-GO" if not self.ok else "caution" if self.remedy else "go" if self.made else "not checked"
        )
        why = "; ".join(text for text in (self.reason, self.remedy) if text)
        found = f"{judged}, {self.measured}" if self.measured else judged
        return f"{found}: {why}" if why else found


def failures(verdicts: Sequence[Verdict]) -> str:
    """The failed checks in one line; empty if all passed."""
    bad = [f"{v.name}: {'; '.join(filter(None, (v.found, v.remedy)))}" for v in verdicts if not v.ok]
    return "; ".join(bad)


def print_verdicts(console: Console, verdicts: Sequence[Verdict]) -> None:
    """Print the go / no-go table, and below it reason and remedy of each warning and each no-go."""
    table = Table(box=None, pad_edge=False, header_style="bold", expand=False)
    names = ["", "check", "found"]
    limited = any(verdict.limit for verdict in verdicts)
    for name in [*names, "limit"] if limited else names:
        table.add_column(name, overflow="fold")
    for verdict in verdicts:
        cells = [verdict.name, verdict.measured or verdict.reason]
        # a remedy may name an extra in brackets, which a cell of text would take for a style
        table.add_row(_mark(verdict), *map(Text, [*cells, *([verdict.limit] if limited else [])]))
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
