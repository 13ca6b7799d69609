"""The sessions of a folder as the desk lists them, and the commands that look at them again."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from processing.errors import ConfigurationError, RigError
from rig.desk.jobs import Job
from rig.measure import RunState, SessionState, read_session

SERVED = "/sessions"
"""Where the server has the files of the sessions' folder."""
_SHOWN = frozenset({".html", ".svg", ".png", ".csv", ".json"})
_MOST = 500
_IN_RERUN = ("view", "replay")


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session: its folder, when it began, what of, how many runs are complete, what is the matter.

    `resumable` is True for one that was killed: its missing runs can be made.
    """

    folder: Path
    begun: str
    sample: str
    runs: str
    state: str
    report: Path | None
    resumable: bool = False


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
    ended = state_of(session)
    state = "running" if runs_now else "no run made" if ended is None else ended.value
    resumable = ended is RunState.INTERRUPTED and not runs_now
    sample = str(stated.get("sample", ""))
    runs = f"{made} of {session.runs_wanted}"
    when = begun.replace("T", " ").partition("+")[0]
    return SessionRow(folder, when, sample, runs, state, report, resumable)


def state_of(session: SessionState) -> RunState | None:
    """How a session that does not run has ended: complete, stopped, failed, interrupted; None without a run.

    One that was killed is interrupted: a run of it is still noted as being recorded, or its next run did not
    begin.
    """
    if len(session.complete) >= session.runs_wanted:
        return RunState.COMPLETE
    if not session.entries:
        return None
    states = [entry.state for entry in session.entries]
    ended = RunState.RECORDING not in states and states[-1] in (RunState.STOPPED, RunState.FAILED)
    return states[-1] if ended else RunState.INTERRUPTED


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
