"""Verdicts of preflight and doctor, with finding and remedy, and their table."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table
from rich.text import Text

from rig.terminal.printing import folded


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of one check of preflight or doctor."""

    name: str
    ok: bool
    """Whether a measurement is possible. A verdict that is ok and has a remedy is a warning."""
    reason: str = ""
    """The finding, or the reason of a failure; empty if `measured` is sufficient."""
    remedy: str = ""
    """What to do; empty if nothing is to be done."""
    measured: str = ""
    """The measured value with its unit."""
    limit: str = ""
    """The limit of the measured value, with its unit."""
    made: bool = True
    """Whether there was something to check; if not, `ok` is True, and `reason` or `measured` says why."""

    @classmethod
    def failed(cls, name: str, error: Exception, remedy: str = "") -> "Verdict":
        """The verdict of an error; the remedy follows a semicolon in its message, or else is `remedy`."""
        reason, _, stated_remedy = str(error).partition("; ")
        return cls(name, False, reason, stated_remedy or remedy)

    @classmethod
    def checked(cls, name: str, ok: bool, finding: str, remedy: str, fault: str = "") -> "Verdict":
        """The verdict of a check: its `finding`, or else its `fault`, if that differs, and `remedy`."""
        return cls(name, ok, finding) if ok else cls(name, ok, fault or finding, remedy)

    @property
    def line(self) -> str:
        """The verdict in one line: `beam quality: go, one Gaussian, ...`, with reason and remedy."""
        return f"{self.name}: {self.judgement_text}"

    @property
    def finding(self) -> str:
        """Value with its limit, and reason, as far as they exist."""
        value = f"{self.measured} (limit {self.limit})" if self.limit else self.measured
        return "; ".join(text for text in (value, self.reason) if text)

    @property
    def judgement_text(self) -> str:
        """The line without its name."""
        judgement = (
            "NO-GO" if not self.ok else "caution" if self.remedy else "go" if self.made else "not checked"
        )
        reasons = "; ".join(text for text in (self.reason, self.remedy) if text)
        text = f"{judgement}, {self.measured}" if self.measured else judgement
        return f"{text}: {reasons}" if reasons else text


def failures(verdicts: Sequence[Verdict]) -> str:
    """The failed checks in one line; empty if all passed."""
    return "; ".join(
        f"{v.name}: {'; '.join(filter(None, (v.finding, v.remedy)))}" for v in verdicts if not v.ok
    )


def print_verdicts(console: Console, verdicts: Sequence[Verdict]) -> None:
    """Print the go / no-go table, and below it reason and remedy of each warning and each no-go."""
    table = Table(box=None, pad_edge=False, header_style="bold", expand=False)
    has_limits = any(verdict.limit for verdict in verdicts)
    for heading in ["", "check", "found", *(["limit"] if has_limits else [])]:
        table.add_column(heading, overflow="fold")
    for verdict in verdicts:
        cells = [verdict.name, verdict.measured or verdict.reason, *([verdict.limit] if has_limits else [])]
        # as `Text`, because rich would take brackets in a string, such as the name of an extra, for a style
        table.add_row(_mark(verdict), *map(Text, cells))
    console.print(table, highlight=False)
    for verdict in verdicts:
        if verdict.remedy:
            kind = "warning" if verdict.ok else "NO-GO"
            reasons = "; ".join(text for text in (verdict.reason, verdict.remedy) if text)
            _print(console, f"{kind} {verdict.name}: {reasons}")
    for reason in dict.fromkeys(v.reason for v in verdicts if not v.made and v.reason):
        names = ", ".join(v.name for v in verdicts if v.reason == reason)
        _print(console, f"not checked: {names}: {reason}")


def _print(console: Console, text: str) -> None:
    console.print(folded(text, console.width), highlight=False, markup=False)


def _mark(verdict: Verdict) -> str:
    if not verdict.made:
        return "[dim]-[/]"
    if not verdict.ok:
        return "[bold red]NO[/]"
    return "[yellow]warn[/]" if verdict.remedy else "[green]go[/]"
