"""Results on the terminal: the tables of every run's fits, and what is said about them."""

import logging
from collections.abc import Sequence
from pathlib import Path

from processing.fit import FitMethod
from rig.analysis.compared_laws import law_table, waveform_table
from rig.analysis.decay_values import decay_lines
from rig.analysis.fit_remarks import brief_remarks, remarks
from rig.analysis.fit_tables import combined_table, parameter_table, quality_table
from rig.analysis.results import RunResults, SessionResults
from rig.analysis.results_file import encoded
from rig.presentation import answer, print_line, print_tables

logger = logging.getLogger(__name__)


def print_results(results: SessionResults, paths: Sequence[tuple[str, Path]]) -> None:
    """The runs, then the `paths` that were written, by what they hold.

    Of several fitted runs one combined table, and of each run only what was not as it should be. Of one the
    exact fit with the whole budget, what limits it and what to do. Where this logger is enabled for INFO
    (``rig -v``) of every run both fits with the swings' own uncertainties, their quality, all remarks.
    """
    answer(results=encoded(results), written=[path for _, path in paths])
    combined = combined_table(results)
    short = combined is not None and not logger.isEnabledFor(logging.INFO)
    for number, run in zip(results.numbers, results.runs, strict=True):
        origin = "SIMULATED run" if run.simulated else "run"
        head = (
            f"{origin} {number}: {run.half_cycles_text(run.amplitude_unit or '')}, {run.frames} frames, "
            f"{run.dropped_frames} dropped"
        )
        lines = [] if run.ended is None else [f"ended: {run.ended}"]
        # where a law is fitted, its tables say more
        lines += [] if run.fits or run.instrument is not None else decay_lines(run)
        print_run(run, head, lines, short=short)
    if combined is not None:
        print_tables([combined])
    if not logger.isEnabledFor(logging.INFO) and any(run.fits for run in results.runs):
        print_line("  -v, and the report, show both fits of every run, their quality, and more remarks")
    if results.series is not None and results.series.instrument is not None:
        for line in results.series.instrument.text:
            print_line(line)
    for name, path in paths:
        print(f"{name:<12} {path}")


def print_run(run: RunResults, head: str, lines: Sequence[str] = (), *, short: bool = False) -> None:
    """One run: its head, `lines` of its own, tables of the fits, remarks, conditions and warnings.

    `short` leaves out tables of the fits and remarks.
    """
    full = logger.isEnabledFor(logging.INFO)
    print_line(head)
    for line in lines:
        print_line(f"  {line}")
    if run.problem:
        print_line(f"  contact laws not fitted: {run.problem}")
    if run.fits and not short:
        parameters = parameter_table(run, full=full)
        print_tables([parameters, quality_table(run.fits)] if full else [parameters])
    if run.laws is not None:
        print_tables([law_table(run.laws), waveform_table(run.laws)])
        print_line(f"  {run.laws.verdict}")
    said = [] if short else remarks(run) if full else brief_remarks(run)
    for line in (*(run.instrument.text if run.instrument else ()), *said):
        print_line(f"  {line}")
    for condition in run.conditions:
        if not condition.ok or condition.remedy:
            line = f"  {condition.name.upper()}: {condition.measured} (limit {condition.limit}); "
            line += f"{condition.reason}; {condition.remedy}"
            print_line(line)
    # what only the asymptotic fit is warned of concerns no number that is shown
    of_other = run.fits[FitMethod.ASYMPTOTIC].warnings if FitMethod.ASYMPTOTIC in run.fits else ()
    hidden = () if full or short else [f"{FitMethod.ASYMPTOTIC} fit: {warning}" for warning in of_other]
    for warning in (one for one in run.warnings if one not in hidden):
        print_line(f"  note: {warning}")
