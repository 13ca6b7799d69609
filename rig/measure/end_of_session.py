"""What a session that has ended hands over: how it went, the result, what limits it, what to do next."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from processing.errors import RigError
from rig.analysis import (
    Limit,
    RunResults,
    read_results,
    results_path,
    whole_result,
)
from rig.measure.session_file import RunState, SessionState, read_session


@dataclass(frozen=True, slots=True)
class HandOver:
    """Of one session. `ended` is None while no run was made; `went` says in words how it stands.

    `headline` is the result with its uncertainty, `of` whether that is the whole budget or the swings alone;
    `limits` what makes the most of it, `next_steps` what to do. Empty where there are no results.
    """

    folder: Path
    ended: RunState | None
    went: str
    headline: str = ""
    of: str = ""
    limits: Sequence[Limit] = ()
    next_steps: Sequence[str] = ()
    others: Sequence[tuple[str, str]] = ()
    report: Path | None = None
    remarks: Sequence[str] = field(default_factory=tuple)


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


def hand_over(folder: Path) -> HandOver:
    """What a session's folder holds; reads results, takes a moment.

    Raises RigError if there is no session in it.
    """
    session = read_session(folder)
    ended = state_of(session)
    reports = sorted(folder.glob("report*.html"), key=lambda path: path.stat().st_mtime)
    report = reports[-1] if reports else None
    went, steps = _went(session, ended), _steps_of_end(ended)
    if not results_path(folder).exists():
        if session.entries and report is None:
            steps = [*steps, "fit it again: there are no results yet (rig fit)"]
        return HandOver(folder, ended, went, next_steps=steps, report=report)
    try:
        results = read_results(folder)
    except RigError as error:
        return HandOver(folder, ended, went, next_steps=[*steps, str(error)], report=report)
    run = results.runs[-1]
    found = whole_result(run, results.series)
    headline, of = found.text, found.of
    against = [f"{one.name}: {one.said}" for one in run.conditions if not one.ok or one.remedy]
    remarks = [*run.warnings, *against]
    if run.problem:
        headline, of = "", ""
        remarks.insert(0, f"no fit: {run.problem}")
    return HandOver(
        folder,
        ended,
        went,
        headline,
        of,
        found.limits,
        [*steps, *found.next_steps],
        _others(run),
        report,
        remarks,
    )


def _went(session: SessionState, ended: RunState | None) -> str:
    made = f"{len(session.complete)} of {session.runs_wanted} runs complete"
    reason = next((entry.reason for entry in reversed(session.entries) if entry.reason), "")
    return f"{made}; {reason}" if reason and ended is not None else made


def _steps_of_end(ended: RunState | None) -> list[str]:
    if ended is RunState.INTERRUPTED:
        return ["make the missing runs: Sessions, Resume"]
    return ["see why it failed, then start again"] if ended is RunState.FAILED else []


def _others(run: RunResults) -> list[tuple[str, str]]:
    return [(row.shown.label, row.text) for row in run.contact]
