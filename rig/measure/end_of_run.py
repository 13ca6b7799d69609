"""Decides when a run ends: at a limit, on request, or after an error."""

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from acquisition.record.events import EventKind
from processing.errors import RigError, one_line_text
from processing.estimate import Estimate
from processing.swing import HalfCycle
from rig.analysis import (
    Limit,
    read_results,
    results_path,
    whole_result,
)
from rig.devices import FrameStream
from rig.measure.session_file import RunState, SessionState, read_session
from rig.settings import StopCondition

_log = logging.getLogger(__name__)
CONSECUTIVE_BELOW = 3
"""Half-cycles in a row below the final amplitude that end a run: one disturbed one, or two, do not."""
CONSECUTIVE_FITS = 4
"""Number of fits in a row, each of 4 % more half-cycles, in which the stop conditions must hold. An estimated
uncertainty dips below a limit by chance; after a run that ended there it would be above it again."""


class EndOfRun:
    """Decides whether one run has reached one of its limits.

    The amplitude must stay below `final_amplitude`, in the unit of the deflections (0: no limit), for three
    consecutive half-cycles, so that one disturbed half-cycle does not end a long measurement. The conditions
    `known_enough` on parameters must all hold in `CONSECUTIVE_FITS` fits in a row.
    """

    def __init__(
        self, final_amplitude: float, max_duration_s: float, known_enough: Sequence[StopCondition] = ()
    ) -> None:
        self._final_amplitude, self._max_duration_s = final_amplitude, max_duration_s
        self._known_enough = known_enough
        self._below = 0
        self._fits_in_a_row = 0
        self._last_estimates: Mapping[str, Estimate] | None = None

    def reason(
        self, swings: Sequence[HalfCycle], elapsed_s: float, estimates: Mapping[str, Estimate] | None = None
    ) -> str | None:
        """Why the run must end, as text for the record; None while it continues.

        `estimates` are the parameters fitted to the half-cycles so far; each fit brings a new object.
        """
        for swing in swings:
            self._below = self._below + 1 if swing.amplitude < self._final_amplitude else 0
            if self._below >= CONSECUTIVE_BELOW:
                return "final amplitude reached"
        if elapsed_s >= self._max_duration_s:
            return f"time limit of {self._max_duration_s:g} s reached"
        known, enough = estimates, self._known_enough
        if enough and known and known is not self._last_estimates:
            self._last_estimates = known
            holds = all(condition.relative(known) < condition.limit for condition in enough)
            self._fits_in_a_row = self._fits_in_a_row + 1 if holds else 0
        if enough and known and self._fits_in_a_row >= CONSECUTIVE_FITS:
            return f"known well enough: {', '.join(condition.text(known) for condition in enough)}"
        return None


class StopRequest:
    """The request to end a run, with its reason; the first reason given is recorded.

    `failure` is the first error, if an error ended the run; `early` is ENDED_EARLY or FAILED if the run was
    ended before its limits. With `skip_waiting` (after Ctrl-C) frames that a source on demand has still to
    deliver are not processed. May be used from any thread.
    """

    def __init__(self, stream: FrameStream) -> None:
        self._stream = stream
        self._asked = threading.Event()
        self.reason = ""
        self.failure: Exception | None = None
        self.early: EventKind | None = None
        self.skip_waiting = False

    def __bool__(self) -> bool:
        return self._asked.is_set()

    def request(self, reason: str, early: EventKind | None = None) -> bool:
        """End the run soon; returns whether this reason is the first."""
        if self._asked.is_set():
            return False
        self.reason, self.early = reason, early
        self._asked.set()
        self._stream.request_stop()
        return True

    def failed(self, error: Exception) -> None:
        """End the run because of an error; unexpected errors (not RigError) are logged with traceback."""
        if self.failure is None:
            self.failure = error
        if not isinstance(error, RigError):
            _log.error("%s", one_line_text(error), exc_info=error)
        self.request(one_line_text(error), EventKind.FAILED)

    def close_stream(self) -> None:
        """Close the camera's stream; an error of the camera is kept if there was no other."""
        self._asked.set()
        self._stream.close()
        if self._stream.failure is not None:
            self.failure = self.failure or self._stream.failure
            self.reason = self.reason or self._stream.ended


@dataclass(frozen=True, slots=True)
class SessionSummary:
    """Summary of an ended session for the person who takes it over.

    Texts on results are empty if there are none.
    """

    folder: Path
    ended: RunState | None
    """State of the session; None while no run was made."""
    progress_text: str
    """Number of complete runs, and why the last run ended, in words."""
    headline: str = ""
    """The result with its uncertainty."""
    of: str = ""
    """What that uncertainty covers: the whole budget, or the half-cycles alone."""
    limits: Sequence[Limit] = ()
    """The largest parts of the uncertainty."""
    next_steps: Sequence[str] = ()
    """What to do next."""
    others: Sequence[tuple[str, str]] = ()
    """Further results of the series, else of the last fitted run, as (label, text)."""
    report: Path | None = None
    """The newest HTML report."""
    remarks: Sequence[str] = field(default_factory=tuple)
    """Warnings, and conditions that were not met."""


def state_of(session: SessionState) -> RunState | None:
    """State in which a session has ended: complete, stopped, failed or interrupted; None without a run.

    A session that was killed is interrupted: a run is still noted as being recorded, or the next run did not
    begin.
    """
    if len(session.complete) >= session.runs_wanted:
        return RunState.COMPLETE
    if not session.entries:
        return None
    states = [entry.state for entry in session.entries]
    ended = RunState.RECORDING not in states and states[-1] in (RunState.STOPPED, RunState.FAILED)
    return states[-1] if ended else RunState.INTERRUPTED


def session_summary(folder: Path) -> SessionSummary:
    """The summary of the session in a folder; it reads the results, which takes a moment.

    Raises RigError if the folder holds no session.
    """
    session = read_session(folder)
    ended = state_of(session)
    reports = sorted(folder.glob("report*.html"), key=lambda path: path.stat().st_mtime)
    report = reports[-1] if reports else None
    steps = []
    if ended is RunState.INTERRUPTED:
        steps.append("measure the missing runs: Runs, Resume")
    elif ended is RunState.FAILED:
        steps.append("see why it failed, then start again")
    if not results_path(folder).exists() and session.entries and report is None:
        steps.append("fit it again: there are no results yet (rig fit)")
    summary = SessionSummary(folder, ended, _progress_text(session, ended), next_steps=steps, report=report)
    if not results_path(folder).exists():
        return summary
    try:
        results = read_results(folder)
    except RigError as error:
        return replace(summary, next_steps=[*steps, str(error)])
    # a run that was stopped too early hides no result of one before it
    run = next((one for one in reversed(results.runs) if not one.problem), results.runs[-1])
    whole = whole_result(run, results.series)
    rows = results.contact if results.series is not None and results.series.table else run.contact
    unmet = [f"{one.name}: {one.judgement_text}" for one in run.conditions if not one.ok or one.remedy]
    no_fit = [f"no fit of {one.record}: {one.problem}" for one in results.runs if one.problem]
    return replace(
        summary,
        headline="" if run.problem else whole.text,
        of="" if run.problem else whole.of,
        limits=whole.limits,
        next_steps=[*steps, *whole.next_steps],
        others=[(row.shown.label, row.text) for row in rows],
        remarks=[*no_fit, *run.warnings, *unmet],
    )


def _progress_text(session: SessionState, ended: RunState | None) -> str:
    made = f"{len(session.complete)} of {session.runs_wanted} runs complete"
    reason = next((entry.reason for entry in reversed(session.entries) if entry.reason), "")
    return f"{made}; {reason}" if reason and ended is not None else made
