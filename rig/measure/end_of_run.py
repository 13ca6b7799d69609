"""Decides when a run ends: at a limit, on request, or after an error."""

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.record.events import EventKind
from processing.errors import RigError, in_one_line
from processing.estimate import Estimate
from processing.swing import HalfCycle
from rig.analysis import (
    Limit,
    RunResults,
    read_results,
    results_path,
    whole_result,
)
from rig.devices import FrameStream
from rig.measure.session_file import RunState, SessionState, read_session
from rig.settings import StopCondition

_log = logging.getLogger(__name__)
BELOW_IN_A_ROW = 3  # one disturbed half-cycle, or two, do not end a long measurement
HELD_FITS = 4
"""Fits in a row, each of 4 % more half-cycles, in which conditions must hold: a value and a drive that are
estimated anew each time dip below a limit by luck, and a run that ended there would not hold it."""


@dataclass(frozen=True, slots=True)
class EndLimits:
    """A run ends below an amplitude (in the unit of the deflections; 0: no limit) and after a time.

    It ends, too, when all of `known_enough` have held for a while.
    """

    final_amplitude: float
    max_duration_s: float
    known_enough: tuple[StopCondition, ...] = ()


class EndOfRun:
    """Checks the limits of one run.

    The amplitude must stay below its limit for three consecutive half-cycles, so that one disturbed
    half-cycle does not end a long measurement; and what is known enough must be so in `HELD_FITS` fits in a
    row.
    """

    def __init__(self, limits: EndLimits) -> None:
        self._limits = limits
        self._below = 0
        self._held = 0
        self._judged: Mapping[str, Estimate] | None = None

    def reason(
        self, swings: Sequence[HalfCycle], elapsed_s: float, estimates: Mapping[str, Estimate] | None = None
    ) -> str | None:
        """Why the run must end, as text for the record; None while it continues.

        `estimates` are the parameters as the half-cycles so far tell them, an object of its own for each fit.
        """
        for swing in swings:
            self._below = self._below + 1 if swing.amplitude < self._limits.final_amplitude else 0
            if self._below >= BELOW_IN_A_ROW:
                return "final amplitude reached"
        if elapsed_s >= self._limits.max_duration_s:
            return f"time limit of {self._limits.max_duration_s:g} s reached"
        known, enough = estimates, self._limits.known_enough
        if enough and known and known is not self._judged:
            self._judged = known
            holds = all(condition.relative(known) < condition.limit for condition in enough)
            self._held = self._held + 1 if holds else 0
        if enough and known and self._held >= HELD_FITS:
            return f"known well enough: {', '.join(condition.text(known) for condition in enough)}"
        return None


class StopRequest:
    """Whether the run is to end, and why; the first reason given is recorded.

    `failure` is the first error, if an error ended the run; `early` is STOPPED or FAILED where it was ended
    before its end. With `skip_waiting` (after Ctrl-C) frames
    that a source on demand has still to deliver are not processed. May be used from any thread.
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

    def because(self, reason: str, early: EventKind | None = None) -> bool:
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
            _log.error("%s", in_one_line(error), exc_info=error)
        self.because(in_one_line(error), EventKind.FAILED)

    def close_stream(self) -> None:
        """Close the camera's stream; an error of the camera is kept if there was no other."""
        self._asked.set()
        self._stream.close()
        if self._stream.failure is not None:
            self.failure = self.failure or self._stream.failure
            self.reason = self.reason or self._stream.ended


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
        return ["measure the missing runs: Runs, Resume"]
    return ["see why it failed, then start again"] if ended is RunState.FAILED else []


def _others(run: RunResults) -> list[tuple[str, str]]:
    return [(row.shown.label, row.text) for row in run.contact]
