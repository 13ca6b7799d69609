"""Decides when a run ends: at a limit, on request, or after an error."""

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.record.events import EventKind
from processing.errors import RigError, one_line_text
from processing.estimate import Estimate
from processing.swing import HalfCycle
from rig.analysis import Limit, main_result, read_results, results_path
from rig.devices import FrameStream
from rig.measure.session_file import RunState, SessionState, read_session
from rig.settings import StopCondition

_log = logging.getLogger(__name__)
CONSECUTIVE_BELOW = 3
"""Half-cycles in a row below the final amplitude that end a run: one or two that are disturbed do not."""
CONSECUTIVE_FITS = 4
"""Number of fits in a row, each of 4 % more half-cycles, in which the stop conditions must hold. An estimated
uncertainty dips below a limit by chance; after a run that ended there it would be above it again."""


class EndOfRun:
    """Decides whether one run has reached one of its limits.

    The amplitude must stay below `final_amplitude`, in the unit of the deflections (0: no limit), for
    `CONSECUTIVE_BELOW` half-cycles. The `stop_when` conditions on parameters must all hold in
    `CONSECUTIVE_FITS` fits in a row.
    """

    def __init__(
        self, final_amplitude: float, max_duration_s: float, stop_when: Sequence[StopCondition] = ()
    ) -> None:
        self._final_amplitude, self._max_duration_s = final_amplitude, max_duration_s
        self._stop_when = stop_when
        self._half_cycles_below = self._fits_in_a_row = 0
        self._last_estimates: Mapping[str, Estimate] | None = None

    def reason(
        self,
        half_cycles: Sequence[HalfCycle],
        elapsed_s: float,
        estimates: Mapping[str, Estimate] | None = None,
    ) -> str | None:
        """Why the run must end, as text for the record; None while it continues.

        `estimates` are the parameters fitted to the half-cycles so far; each fit brings a new object.
        """
        for half_cycle in half_cycles:
            is_below = half_cycle.amplitude < self._final_amplitude
            self._half_cycles_below = self._half_cycles_below + 1 if is_below else 0
            if self._half_cycles_below >= CONSECUTIVE_BELOW:
                return "final amplitude reached"
        if elapsed_s >= self._max_duration_s:
            return f"time limit of {self._max_duration_s:g} s reached"
        if not self._stop_when or not estimates:
            return None
        if estimates is not self._last_estimates:
            self._last_estimates = estimates
            holds = all(condition.relative(estimates) < condition.limit for condition in self._stop_when)
            self._fits_in_a_row = self._fits_in_a_row + 1 if holds else 0
        if self._fits_in_a_row >= CONSECUTIVE_FITS:
            return f"known well enough: {', '.join(when.text(estimates) for when in self._stop_when)}"
        return None


class StopRequest:
    """The request to end a run, with its reason; the first reason given is recorded.

    May be used from any thread.
    """

    def __init__(self, stream: FrameStream) -> None:
        self._stream = stream
        self._requested = threading.Event()
        self.reason = ""
        self.failure: Exception | None = None
        """The first error, if an error ended the run."""
        self.early: EventKind | None = None
        """ENDED_EARLY or FAILED if the run was ended before its limits."""
        self.skip_waiting = False
        """Whether frames that a source on demand has still to deliver are skipped, as after Ctrl-C."""

    def __bool__(self) -> bool:
        return self._requested.is_set()

    def request(self, reason: str, early: EventKind | None = None) -> bool:
        """End the run soon; returns whether this reason is the first."""
        if self._requested.is_set():
            return False
        self.reason, self.early = reason, early
        self._requested.set()
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
        """Close the camera's stream; an error of the camera is the failure if there was no other."""
        self._requested.set()
        self._stream.close()
        if self._stream.failure is not None:
            self.failure = self.failure or self._stream.failure
            self.reason = self.reason or self._stream.end_reason


@dataclass(frozen=True, slots=True)
class SessionSummary:
    """Summary of an ended session for the operator; texts on results are empty if there are none."""

    folder: Path
    ended: RunState | None
    """State of the session; None while no run was made."""
    progress_text: str
    """Number of complete runs, and why the last run ended, in words."""
    headline: str = ""
    """The result with its uncertainty."""
    u_covers: str = ""
    """What that uncertainty covers: the whole budget, or the half-cycles alone."""
    limits: Sequence[Limit] = ()
    """The largest parts of the uncertainty."""
    next_steps: Sequence[str] = ()
    """What to do next."""
    other_results: Sequence[tuple[str, str]] = ()
    """Further results of the series, else of the last fitted run, as (label, text)."""
    report: Path | None = None
    """The newest HTML report."""
    remarks: Sequence[str] = ()
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
    report = max(folder.glob("report*.html"), key=lambda path: path.stat().st_mtime, default=None)
    steps = []
    if ended is RunState.INTERRUPTED:
        steps.append("measure the missing runs: Runs, Resume")
    elif ended is RunState.FAILED:
        steps.append("see why it failed, then start again")
    has_results = results_path(folder).exists()
    if not has_results and session.entries and report is None:
        steps.append("fit it again: there are no results yet (rig fit)")
    progress = f"{len(session.complete)} of {session.runs_wanted} runs complete"
    if reason := next((entry.reason for entry in reversed(session.entries) if entry.reason), ""):
        progress = f"{progress}; {reason}"
    summary = SessionSummary(folder, ended, progress, next_steps=steps, report=report)
    if not has_results:
        return summary
    try:
        results = read_results(folder)
    except RigError as error:
        return replace(summary, next_steps=[*steps, str(error)])
    # a run that was stopped too early hides no result of an earlier one
    run = next((run for run in reversed(results.runs) if not run.problem), results.runs[-1])
    whole = main_result(run, results.series)
    rows = results.contact if results.series is not None and results.series.table else run.contact
    unmet = [
        f"{verdict.name}: {verdict.judgement_text}"
        for verdict in run.conditions
        if not verdict.ok or verdict.remedy
    ]
    no_fit = [f"no fit of {run.record}: {run.problem}" for run in results.runs if run.problem]
    return replace(
        summary,
        headline="" if run.problem else whole.text,
        u_covers="" if run.problem else whole.uncertainty,
        limits=whole.limits,
        next_steps=[*steps, *whole.next_steps],
        other_results=[(row.shown.label, row.text) for row in rows],
        remarks=[*no_fit, *run.warnings, *unmet],
    )
