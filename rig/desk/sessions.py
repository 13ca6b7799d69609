"""The sessions of a folder as the desk lists them, and the commands that look at them again."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from processing.errors import ConfigurationError, RigError
from rig.desk.jobs import Job
from rig.measure import SessionState, read_session

SERVED = "/sessions"
"""Where the server has the files of the sessions' folder."""
_SHOWN = frozenset({".html", ".svg", ".png", ".csv", ".json"})
_MOST = 500
_IN_RERUN = ("view", "replay")
INTERRUPTED = "interrupted"
"""State of a session that was killed: its missing runs can be made."""


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session: its folder, when it began, what of, how many runs are complete, what is the matter."""

    folder: Path
    begun: str
    sample: str
    runs: str
    state: str
    report: Path | None


def list_sessions(output: Path, running: Path | None) -> list[SessionRow]:
    """The sessions in a folder, the newest first; at most 500."""
    files = sorted(output.glob("*/session.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    return [_row(path.parent, running) for path in files[:_MOST]]


def _row(folder: Path, running: Path | None) -> SessionRow:
    reports = sorted(folder.glob("report*.html"), key=lambda path: path.stat().st_mtime)
    report = reports[-1] if reports else None
    try:
        session = read_session(folder)
    except RigError as error:
        return SessionRow(folder, "", "", "", str(error), report)
    begun = min((entry.begun_utc for entry in session.entries if entry.begun_utc), default="")
    made = len(session.complete)
    stated = session.configuration.get("session", {})
    runs_now = running is not None and running.resolve() == folder.resolve()
    state = "running" if runs_now else state_of(session)
    sample = str(stated.get("sample", ""))
    runs = f"{made} of {session.runs_wanted}"
    return SessionRow(folder, begun.replace("T", " ").partition("+")[0], sample, runs, state, report)


def state_of(session: SessionState) -> str:
    """How a session that does not run has ended: complete, stopped, failed, interrupted, no run made.

    One that was killed is interrupted: a run of it is still noted as being recorded, or its next run did not
    begin.
    """
    if len(session.complete) >= session.runs_wanted:
        return "complete"
    if not session.entries:
        return "no run made"
    states = [entry.state for entry in session.entries]
    ended = "recording" not in states and states[-1] in ("stopped", "failed")
    return states[-1] if ended else INTERRUPTED


def served_file(output: Path, name: str) -> Path | None:
    """The file of a report by its name below the sessions' folder; None for what is not to be seen."""
    path = (output / name).resolve()
    if not path.is_relative_to(output.resolve()) or path.suffix not in _SHOWN or not path.is_file():
        return None
    return path


class LookingAgain:
    """Commands about closed sessions; they need no camera.

    One of each name runs at a time, and one of those that show something in Rerun, whose port is one.
    """

    def __init__(self) -> None:
        self.jobs: dict[str, Job] = {}

    def start(self, name: str, words: Sequence[str]) -> None:
        """Start a command; raises ConfigurationError while the last one of this name runs."""
        for other in _IN_RERUN if name in _IN_RERUN else (name,):
            before = self.jobs.get(other)
            if before is not None and before.running:
                raise ConfigurationError(f"rig {other} still runs; wait, or end it")
        self.jobs[name] = Job([name, *words])

    def end(self, name: str) -> None:
        """End a command, as Ctrl-C does."""
        if name in self.jobs:
            self.jobs[name].end()

    def close(self) -> None:
        """End all."""
        for job in self.jobs.values():
            job.end()

    def address(self, name: str) -> str:
        """The address that a command has printed, for a page that it serves; empty without one."""
        job = self.jobs.get(name)
        said = [] if job is None or not job.running else list(job.said)
        found = [match[0] for line in said if (match := re.search(r"http://127\.0\.0\.1:\d+\S*", line))]
        return found[-1] if found else ""
