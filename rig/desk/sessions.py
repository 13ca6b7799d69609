"""The sessions of a folder: rows of the desk's list, search, summary of the last one, files to be served."""

import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from processing.errors import RigError
from processing.fit import FitMethod
from rig.analysis import results_path
from rig.instrument import BALANCE_CONDITIONS
from rig.measure import STATE_NAME, RunState, SessionSummary, read_session, session_summary
from rig.terminal import quantity, with_uncertainty

SERVED = "/sessions"
"""Path on the desk's server below which the files of the sessions' folder are served."""
_SERVED_SUFFIXES = frozenset({".html", ".svg", ".png", ".csv", ".json"})


@dataclass(frozen=True, slots=True)
class SessionRow:
    """One session in the list, as texts."""

    folder: Path
    state: str
    """How it ended, or why it cannot be read."""
    begun: str = ""
    sample: str = ""
    runs: str = ""
    """Number of complete runs of those wanted."""
    conditions: str = ""
    """First and last amplitude of its runs."""
    operator: str = ""
    sigma: str = ""
    """Surface energy of its last run with its whole uncertainty, in the unit of `NUMBERS`; so are b and c."""
    b: str = ""
    c: str = ""
    balance: str = ""
    """The verdict go or no; empty if the balance was not judged."""
    resumable: bool = False
    """Whether runs are missing that can still be made."""
    text: str = ""
    """Text that a search looks through."""

    @property
    def name(self) -> str:
        return self.folder.name


class SessionIndex:
    """All sessions of a folder, the newest first, as the last `look` has found them."""

    def __init__(self, output: Path) -> None:
        self._output = output
        self._known: dict[str, tuple[tuple[int, int], SessionRow]] = {}

    def rows(self, running: Path | None, words: str = "") -> list[SessionRow]:
        """The sessions whose `SessionRow.text` has all of these words; never blocks."""
        running = None if running is None else running.resolve()
        rows = [
            row for _, row in self._known.values() if all(word in row.text for word in words.lower().split())
        ]
        return [
            row
            if running is None or row.folder.resolve() != running
            else replace(row, state="running", resumable=False)
            for row in rows
        ]

    def look(self) -> None:
        """Read the sessions that are new, or whose files have changed; this may take long."""
        files: list[tuple[tuple[int, int], str]] = []
        with suppress(OSError), os.scandir(self._output) as entries:
            for entry in entries:
                with suppress(OSError):
                    files.append((_changed_ns(Path(entry.path)), entry.path))
        rows = {}
        for changed_ns, path in sorted(files, reverse=True):
            known = self._known.get(path)
            if known is None or known[0] != changed_ns:
                known = changed_ns, session_row(Path(path))
            rows[path] = known
        self._known = rows


def _changed_ns(folder: Path) -> tuple[int, int]:
    """Times in ns of the last changes of a session's state and of its folder; OSError without a session."""
    # every file is replaced whole, so that the folder shows new results and reports, whatever their number
    return (folder / STATE_NAME).stat().st_mtime_ns, folder.stat().st_mtime_ns


def session_row(folder: Path) -> SessionRow:
    """The row of one session; if its folder cannot be read as a session, `state` is the reason."""
    try:
        session, summary = read_session(folder), session_summary(folder)
    except RigError as error:
        return SessionRow(folder, str(error), text=f"{folder} {error}".lower())
    begun_utc = min((entry.begun_utc for entry in session.entries if entry.begun_utc), default="")
    begun = begun_utc.replace("T", " ").partition("+")[0].partition(".")[0]
    settings = session.configuration.get("session", {})
    state = "no run made" if summary.ended is None else summary.ended.value
    sample, operator, notes = (str(settings.get(key, "")) for key in ("sample", "operator", "notes"))
    first, last = settings.get("initial_amplitude_arcsec"), settings.get("final_amplitude_arcsec")
    return SessionRow(
        folder,
        state,
        begun=begun,
        sample=sample,
        runs=f"{len(session.complete)} of {session.runs_wanted}",
        conditions="" if first is None or last is None else f"{float(first):g} to {float(last):g} arcsec",
        operator=operator,
        resumable=summary.ended not in (None, RunState.COMPLETE),
        text=" ".join((folder.name, begun, sample, operator, state, notes)).lower(),
        **last_run(folder),
    )


NUMBERS = {"sigma": "surface_energy_table2_j_per_m2", "b": "b", "c": "c"}
"""Keys of the quantities in the list, by the name of their column."""


def last_run(folder: Path) -> dict[str, str]:
    """Columns of the list that follow from a session's last run; empty without results."""
    try:
        run = json.loads(results_path(folder).read_bytes())["runs"][-1]
        rows = {row["quantity"]: row for row in run["table"] if row["fit"] == FitMethod.EXACT}
        conditions = [condition for condition in run["conditions"] if condition["name"] in BALANCE_CONDITIONS]
        # a condition that is met and still has a remedy was not determined
        verdicts = [
            condition["ok"] for condition in conditions if not condition["ok"] or not condition.get("remedy")
        ]
        numbers = {name: _number(rows.get(key)) for name, key in NUMBERS.items()}
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return {}
    return {**numbers, "balance": "" if not verdicts else "go" if all(verdicts) else "no"}


def _number(row: Mapping[str, Any] | None) -> str:
    """Value and whole uncertainty in the unit shown, or the verdict on a quantity that is not determined."""
    if row is None:
        return ""
    if row["verdict"] != "determined":
        return str(row["verdict"])
    if row["value"] is None:
        return ""
    factor = quantity(row["quantity"]).factor
    u = row["u"] if row["u_total"] is None else row["u_total"]
    return with_uncertainty(factor * row["value"], factor * (u or math.nan))


@lru_cache(maxsize=8)
def _summary(folder: Path, _changed_ns: tuple[int, int]) -> SessionSummary:
    return session_summary(folder)


def last_summary(folder: Path) -> SessionSummary | None:
    """The summary of the session in a folder; None without one.

    It is read again only when the files of the session have changed.
    """
    try:
        return _summary(folder, _changed_ns(folder))
    except (OSError, RigError):
        return None


def last_state(folder: Path) -> str:
    """State of a session that has ended, as in the list; empty if it left no state."""
    summary = last_summary(folder)
    return "" if summary is None or summary.ended is None else str(summary.ended)


def served_file(output: Path, name: str) -> Path | None:
    """The file of a report by its name below the sessions' folder; None for a file that is not served."""
    try:
        path = (output / name).resolve()
        is_inside = path.is_relative_to(output.resolve())
        return path if is_inside and path.suffix in _SERVED_SUFFIXES and path.is_file() else None
    except (OSError, ValueError):
        # the name is too long for a file, or contains a zero byte
        return None
