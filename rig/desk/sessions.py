"""The sessions of a folder as the desk lists and finds them."""

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
from rig.instrument import BALANCE_CONDITIONS
from rig.measure import STATE_NAME, HandOver, RunState, hand_over, read_session, state_of
from rig.terminal import quantity, with_uncertainty

SERVED = "/sessions"
"""Where the server has the files of the sessions' folder."""
RESULTS_NAME = "results.json"
_SHOWN = frozenset({".html", ".svg", ".png", ".csv", ".json"})


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session: its folder, when it began, what of, by whom, how many runs are complete, what is the matter.

    `conditions` are the amplitudes it was to run between. `sigma`, `b` and `c` are those of its last run,
    with their whole uncertainty, in the units of `NUMBERS`; `balance` is go, no, or empty where it was not
    judged. `resumable`: it lacks runs, which can be made. `text` is what is searched.
    """

    folder: Path
    state: str
    begun: str = ""
    sample: str = ""
    runs: str = ""
    conditions: str = ""
    operator: str = ""
    sigma: str = ""
    b: str = ""
    c: str = ""
    balance: str = ""
    resumable: bool = False
    text: str = ""

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    @property
    def report(self) -> Path | None:
        """Its newest report."""
        with suppress(OSError):
            return max(self.folder.glob("report*.html"), key=lambda path: path.stat().st_mtime, default=None)
        return None


class SessionIndex:
    """All sessions of a folder, the newest first, as the last `look` has found them."""

    def __init__(self, output: Path) -> None:
        self._output = output
        self._known: dict[str, tuple[tuple[int, int], SessionRow]] = {}

    def rows(self, running: Path | None, words: str = "") -> list[SessionRow]:
        """The sessions with all these words in folder, sample, operator, state or date; never blocks."""
        wanted = words.lower().split()
        now = None if running is None else running.resolve()
        return [
            replace(row, state="running", resumable=False)
            if now is not None and row.folder.resolve() == now
            else row
            for _, row in self._known.values()
            if all(word in row.text for word in wanted)
        ]

    def look(self) -> None:
        """Read the sessions that are new, or whose files have changed; may take long."""
        files: list[tuple[tuple[int, int], str]] = []
        with suppress(OSError), os.scandir(self._output) as entries:
            for entry in entries:
                with suppress(OSError):
                    changed_ns = os.stat(f"{entry.path}/{STATE_NAME}").st_mtime_ns
                    files.append(((changed_ns, _changed_ns(f"{entry.path}/{RESULTS_NAME}")), entry.path))
        found = {}
        for changed, path in sorted(files, reverse=True):
            known = self._known.get(path)
            if known is None or known[0] != changed:
                known = changed, session_row(Path(path))
            found[path] = known
        self._known = found


def _changed_ns(path: str) -> int:
    """When a file was written last; 0 without one."""
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


def session_row(folder: Path) -> SessionRow:
    """The row of one session; of a file that is none, what is wrong with it."""
    try:
        session = read_session(folder)
    except RigError as error:
        return SessionRow(folder, str(error), text=f"{folder} {error}".lower())
    begun = min((entry.begun_utc for entry in session.entries if entry.begun_utc), default="")
    stated = session.configuration.get("session", {})
    ended = state_of(session)
    state = "no run made" if ended is None else ended.value
    sample, operator = str(stated.get("sample", "")), str(stated.get("operator", ""))
    when = begun.replace("T", " ").partition("+")[0].partition(".")[0]
    first, last = stated.get("initial_amplitude_arcsec"), stated.get("final_amplitude_arcsec")
    notes = str(stated.get("notes", ""))
    return SessionRow(
        folder,
        state,
        begun=when,
        sample=sample,
        runs=f"{len(session.complete)} of {session.runs_wanted}",
        conditions="" if first is None or last is None else f"{float(first):g} to {float(last):g} arcsec",
        operator=operator,
        resumable=ended not in (None, RunState.COMPLETE),
        text=" ".join((folder.name, when, sample, operator, state, notes)).lower(),
        **last_run(folder),
    )


NUMBERS = {"sigma": "surface_energy_table2_j_per_m2", "b": "b", "c": "c"}
"""Quantities of the list by the name of their column."""


def last_run(folder: Path) -> dict[str, str]:
    """What the list shows of the last run, from the results of a session; nothing without them."""
    try:
        run = json.loads((folder / RESULTS_NAME).read_bytes())["runs"][-1]
        rows = {row["quantity"]: row for row in run["table"] if row["fit"] == FitMethod.EXACT}
        of_balance = [one for one in run["conditions"] if one["name"] in BALANCE_CONDITIONS]
        # what is ok and has a remedy is not known
        judged = [one["ok"] for one in of_balance if not (one["ok"] and one.get("remedy"))]
        numbers = {name: _number(rows.get(key)) for name, key in NUMBERS.items()}
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return {}
    return {**numbers, "balance": "" if not judged else "go" if all(judged) else "no"}


def _number(row: Mapping[str, Any] | None) -> str:
    """Value and whole uncertainty in the unit shown; none of what is not determined."""
    if row is None or row["value"] is None:
        return ""
    if row["verdict"] != "determined":
        return str(row["verdict"])
    factor = quantity(row["quantity"]).factor
    u = row["u"] if row["u_total"] is None else row["u_total"]
    return with_uncertainty(factor * row["value"], factor * (u or math.nan))


@lru_cache(maxsize=8)
def _state_at(folder: Path, _changed_ns: int) -> str:
    try:
        state = state_of(read_session(folder))
    except RigError:
        return ""
    return "" if state is None else str(state)


def last_state(folder: Path) -> str:
    """The word of the list for a session that has ended; empty if it left none."""
    return _state_at(folder, _changed_ns(f"{folder}/{STATE_NAME}"))


@lru_cache(maxsize=1)
def _hand_over_at(folder: Path, *_changed_ns: int) -> HandOver | None:
    try:
        return hand_over(folder)
    except RigError:
        return None


def last_hand_over(folder: Path) -> HandOver | None:
    """What a session hands over, None where there is none; read again when its files have changed."""
    names = (STATE_NAME, RESULTS_NAME, "report.html")
    return _hand_over_at(folder, *(_changed_ns(f"{folder}/{name}") for name in names))


def served_file(output: Path, name: str) -> Path | None:
    """The file of a report by its name below the sessions' folder; None for what is not to be seen."""
    try:
        path = (output / name).resolve()
        shown = path.is_relative_to(output.resolve()) and path.suffix in _SHOWN and path.is_file()
    except (OSError, ValueError):
        # no name that a file can have: too long, or with a zero in it
        return None
    return path if shown else None
