"""The sessions of a folder as the desk lists and finds them, and the commands that look at them again."""

import json
import math
import os
import re
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from processing.errors import ConfigurationError, RigError
from processing.fit import FitMethod
from rig.calibrate import next_free
from rig.desk.jobs import Job
from rig.instrument import BALANCE_CONDITIONS
from rig.measure import STATE_NAME, RunState, read_session, state_of
from rig.presentation import quantity, with_uncertainty

SERVED = "/sessions"
"""Where the server has the files of the sessions' folder."""
_SHOWN = frozenset({".html", ".svg", ".png", ".csv", ".json"})
_STATE = "session.json"
_LEAST_WAIT_S, _WAIT_OF_WORK = 1.0, 15.0
"""A large folder is looked through less often: one part in fifteen of a core at most."""
_LAST_LINES = 14


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session: its folder, when it began, what of, by whom, how many runs are complete, what is the matter.

    `conditions` are the amplitudes it was to run between. `resumable`: it lacks runs, which can be made;
    `died`: it was killed.
    """

    folder: Path
    begun: str
    sample: str
    runs: str
    state: str
    operator: str = ""
    conditions: str = ""
    resumable: bool = False
    died: bool = False
    text: str = field(default="", compare=False)

    @property
    def report(self) -> Path | None:
        """Its newest report."""
        with suppress(OSError):
            return max(self.folder.glob("report*.html"), key=lambda path: path.stat().st_mtime, default=None)
        return None


class SessionPage(NamedTuple):
    """Some of the sessions that were found, and how many those are."""

    rows: Sequence[SessionRow]
    found: int
    all: int


class SessionIndex:
    """All sessions of a folder, the newest first; a file is read again only when it has changed.

    `look` reads the folder once; after `start` that is done again and again beside, while somebody asks.
    """

    def __init__(self, output: Path) -> None:
        self._output = output
        self._known: dict[str, tuple[int, SessionRow]] = {}
        self._sorted: list[SessionRow] = []
        self._ended, self._asked = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None

    def page(self, running: Path | None, words: str = "", first: int = 0, most: int = 20) -> SessionPage:
        """The sessions with all these words in folder, sample, operator, state or date; never blocks long."""
        self._asked.set()
        rows = self._sorted
        wanted = words.lower().split()
        # without words all are found
        found = [row for row in rows if all(word in row.text for word in wanted)]
        now = None if running is None else running.resolve()
        return SessionPage([_running(row, now) for row in found[first : first + most]], len(found), len(rows))

    def start(self) -> None:
        """Look again and again, in a thread; the first look begins at once."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._follow, name="sessions", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._asked.set()

    def look(self) -> None:
        """Read what is new or has changed."""
        files: list[tuple[int, str]] = []
        with suppress(OSError), os.scandir(self._output) as entries:
            for entry in entries:
                with suppress(OSError):
                    files.append((os.stat(f"{entry.path}/{_STATE}").st_mtime_ns, entry.path))
        files.sort(reverse=True)
        there = {path for _, path in files}
        for gone in self._known.keys() - there:
            del self._known[gone]
        for changed_ns, path in files:
            before = self._known.get(path)
            if before is None or before[0] != changed_ns:
                self._known[path] = changed_ns, session_row(Path(path))
        self._sorted = [self._known[path][1] for _, path in files if path in self._known]

    def _follow(self) -> None:
        while not self._ended.is_set():
            began_s = time.monotonic()
            self.look()
            self._asked.clear()
            self._ended.wait(max(_LEAST_WAIT_S, _WAIT_OF_WORK * (time.monotonic() - began_s)))
            self._asked.wait()


def _running(row: SessionRow, running: Path | None) -> SessionRow:
    if running is None or row.folder.resolve() != running:
        return row
    return SessionRow(row.folder, row.begun, row.sample, row.runs, "running", row.operator, row.conditions)


def session_row(folder: Path) -> SessionRow:
    """The row of one session; of a file that is none, what is wrong with it."""
    try:
        session = read_session(folder)
    except RigError as error:
        return SessionRow(folder, "", "", "", str(error), text=f"{folder} {error}".lower())
    begun = min((entry.begun_utc for entry in session.entries if entry.begun_utc), default="")
    stated = session.configuration.get("session", {})
    ended = state_of(session)
    state = "no run made" if ended is None else ended.value
    sample, operator = str(stated.get("sample", "")), str(stated.get("operator", ""))
    runs = f"{len(session.complete)} of {session.runs_wanted}"
    when = begun.replace("T", " ").partition("+")[0].partition(".")[0]
    first, last = stated.get("initial_amplitude_arcsec"), stated.get("final_amplitude_arcsec")
    conditions = "" if first is None or last is None else f"{float(first):g} to {float(last):g} arcsec"
    notes = str(stated.get("notes", ""))
    text = " ".join((folder.name, when, sample, operator, state, notes)).lower()
    lacks = ended not in (None, RunState.COMPLETE)
    died = ended is RunState.INTERRUPTED
    return SessionRow(folder, when, sample, runs, state, operator, conditions, lacks, died, text)


class LastRun(NamedTuple):
    """What the list shows of a session's last run; empty where it has no results.

    `balance` is go, no or empty where it was not judged; sigma, b and c have their whole uncertainty, in the
    units of `NUMBERS`.
    """

    sigma: str = ""
    b: str = ""
    c: str = ""
    balance: str = ""


NUMBERS = {"sigma": "surface_energy_table2_j_per_m2", "b": "b", "c": "c"}
"""Quantities of the list by the name of their column."""


def last_run(folder: Path) -> LastRun:
    """Read it from the results of a session."""
    try:
        run = json.loads((folder / "results.json").read_bytes())["runs"][-1]
        rows = {row["quantity"]: row for row in run["table"] if row["fit"] == FitMethod.EXACT}
        of_balance = [one for one in run["conditions"] if one["name"] in BALANCE_CONDITIONS]
        # what is ok and has a remedy is not known
        judged = [one["ok"] for one in of_balance if not (one["ok"] and one.get("remedy"))]
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return LastRun()
    numbers = {name: _number(rows.get(key)) for name, key in NUMBERS.items()}
    balance = "" if not judged else "go" if all(judged) else "no"
    return LastRun(**numbers, balance=balance)


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
    try:
        return _state_at(folder, (folder / STATE_NAME).stat().st_mtime_ns)
    except OSError:
        return ""


def served_file(output: Path, name: str) -> Path | None:
    """The file of a report by its name below the sessions' folder; None for what is not to be seen."""
    try:
        path = (output / name).resolve()
        shown = path.is_relative_to(output.resolve()) and path.suffix in _SHOWN and path.is_file()
    except (OSError, ValueError):
        # no name that a file can have: too long, or with a zero in it
        return None
    return path if shown else None


class SessionCommands:
    """Commands about closed sessions; they need no camera. One of each name runs at a time."""

    def __init__(self) -> None:
        self.jobs: dict[str, Job] = {}

    def _start(self, name: str, *words: str) -> None:
        before = self.jobs.get(name)
        if before is not None and before.running:
            raise ConfigurationError(f"rig {name} still runs; wait, or end it")
        self.jobs[name] = Job([name, *words])

    def report(self, folder: Path) -> None:
        """Make the report of a session; as all of these, refused while the last one of its name runs."""
        self._start("report", str(folder))

    def view(self, folder: Path) -> None:
        """Show a session in Rerun."""
        self._start("view", str(folder), "--view", "web")

    def fit(self, folder: Path) -> None:
        """Fit the runs of a session again, into a folder of their own."""
        self._start("fit", str(folder), "-o", str(next_free(folder, "fit")))

    def end(self) -> None:
        """End what runs."""
        for job in self.jobs.values():
            if job.running:
                job.end()

    @property
    def running(self) -> bool:
        """Whether one of them runs."""
        return any(job.running for job in self.jobs.values())

    def said(self) -> list[str]:
        """How each command stands, and its last lines."""
        lines: list[str] = []
        for name, job in self.jobs.items():
            state = "runs" if job.running else "done" if job.status == 0 else "failed"
            lines += [f"rig {name}: {state}", *list(job.said)[-_LAST_LINES:]]
        return lines

    def address(self, name: str) -> str:
        """The address that a command has printed, for a page that it serves; empty without one."""
        job = self.jobs.get(name)
        said = [] if job is None or not job.running else list(job.said)
        found = [match[0] for line in said if (match := re.search(r"http://127\.0\.0\.1:\d+\S*", line))]
        return found[-1] if found else ""
