"""Results of records, tables and films on the terminal."""

import logging
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from processing.swing import HalfCycleFlag, turning_points
from processing.units import seconds
from rig.analysis.fit_tables import (
    combined_table,
    instrument_series_table,
    instrument_table,
    law_table,
    parameter_table,
    quality_table,
)
from rig.analysis.results import RunResults, Series, SessionResults
from rig.analysis.results_file import encoded
from rig.analysis.run_remarks import RemarkLevel, decay_lines, remark_rows
from rig.analysis.run_values import TableDecay
from rig.analysis.series import AnalysedRun
from rig.analysis.table_fit import AnalysedTable
from rig.terminal import answer, print_line, print_tables

logger = logging.getLogger(__name__)


def print_results(results: SessionResults, paths: Sequence[tuple[str, Path]]) -> None:
    """Print the runs, then the written `paths` with names of their contents.

    Several fitted runs have one combined table, and each run only its problems. A single run has its exact
    fit, with the whole budget and advice on what would reduce the uncertainty. With INFO enabled for this
    logger (``rig -v``), every run has both fits, with the half-cycles' own uncertainties, their quality, and
    all remarks.
    """
    answer(results=partial(encoded, results), written=[path for _, path in paths])
    combined = combined_table(results)
    short = combined is not None and not logger.isEnabledFor(logging.INFO)
    for number, run in zip(results.numbers, results.runs, strict=True):
        origin = "SIMULATED run" if run.simulated else "run"
        heading = (
            f"{origin} {number}: {run.half_cycles_text()}, {run.frames} frames, {run.dropped_frames} dropped"
        )
        lines = [] if run.ended is None else [f"ended: {run.ended}"]
        # tables of a fit say the same and more
        lines += [] if run.fits or run.instrument is not None else decay_lines(run)
        print_run(run, heading, lines, short=short)
    if combined is not None:
        print_tables([combined])
    if not logger.isEnabledFor(logging.INFO) and any(run.fits for run in results.runs):
        print_line("  -v, and the report, show both fits of every run, their quality, and more remarks")
    print_series(results.series)
    for name, path in paths:
        # without the wrapping of print_line, which would cut a path
        print(f"{name:<12} {path}")


def print_run(run: RunResults, heading: str, lines: Sequence[str] = (), *, short: bool = False) -> None:
    """Print one run: heading, `lines` of its own, tables of the fits, remarks, conditions and warnings.

    `short` leaves out tables of the fits and remarks.
    """
    full = logger.isEnabledFor(logging.INFO)
    print_line(heading)
    for line in lines:
        print_line(f"  {line}")
    if run.problem:
        print_line(f"  contact laws not fitted: {run.problem}")
    if run.fits and not short:
        parameters = parameter_table(run, full=full)
        print_tables([parameters, quality_table(run)] if full else [parameters])
    if run.instrument is not None:
        print_tables([instrument_table(run)])
    if run.laws is not None:
        print_tables([law_table(run.laws)])
        print_line(f"  {run.laws.verdict}")
    levels = [RemarkLevel.RESULT, RemarkLevel.DETAIL if full else RemarkLevel.ADVICE] if not short else []
    remark_lines = [*(run.instrument.text if run.instrument else ())]
    remark_lines += [row.line for row in remark_rows(run, *levels, RemarkLevel.CONDITION)]
    warning_levels = [RemarkLevel.WARNING, *([RemarkLevel.OTHER_FIT] if full else [])]
    remark_lines += [f"note: {row.text}" for row in remark_rows(run, *warning_levels)]
    for line in remark_lines:
        print_line(f"  {line}")


_FLAG_TEXTS = {
    HalfCycleFlag.GAP: "with too few samples around it",
    HalfCycleFlag.VIBRATION: "disturbed",
    HalfCycleFlag.LOW_AMPLITUDE: "too small",
    HalfCycleFlag.START: "of a release or kick",
    HalfCycleFlag.INFERRED: "outside the sensor",
    HalfCycleFlag.REST_MOVED: "beyond a knock that moved the rest position",
}


def print_table(path: Path, table: AnalysedTable) -> None:
    """Print how a table was read, and the results of its decays and of their series."""
    trajectory = table.positions
    print_line(
        f"{path}: {len(trajectory.times_ns)} samples, {', '.join(trajectory.names)} in {trajectory.unit}, "
        f"{'' if trajectory.time_unit == 's' else f'time in {trajectory.time_unit}, '}"
        f"{len(table.runs)} {'decay' if len(table.runs) == 1 else 'decays'}"
    )
    for line in trajectory.understood:
        print_line(f"  {line}")
    print_line(
        f"  noise of a sample {table.noise:.3g} {trajectory.unit}, from the scatter about a smooth curve"
    )
    for half_cycles in table.short_decays:
        print_line(
            f"  from {seconds(half_cycles[0].turn_time_ns):.4g} s on: {len(turning_points(half_cycles))} "
            f"usable half-cycles of {len(half_cycles)}, too few for a decay"
        )
    for number, run in enumerate(table.runs, start=1):
        _print_decay(number, run, run.decay or TableDecay())
    print_series(table.series)


def print_series(series: Series | None) -> None:
    """Print the comparison of places on a sample, by another kind of pendulum; else nothing."""
    if series is not None and series.instrument is not None:
        print_tables([instrument_series_table(series.instrument)])
        for line in series.instrument.lines:
            print_line(line)


def _print_decay(number: int, run: AnalysedRun, decay: TableDecay) -> None:
    usable, (first, last) = len(turning_points(run.detected_half_cycles)), run.amplitudes
    counts = Counter(
        text for h in run.detected_half_cycles for flag, text in _FLAG_TEXTS.items() if h.flags & flag
    )
    reasons = ", ".join(f"{count} {text}" for text, count in counts.most_common())
    heading = (
        f"decay {number}, {decay.began_s:.4g} to {decay.ended_s:.4g} s: {usable} half-cycles "
        f"({len(run.detected_half_cycles) - usable} more flagged and left out{reasons and f': {reasons}'}), "
        f"amplitude {first:.4g} to {last:.4g} {run.amplitude_unit}"
    )
    print_run(run, heading, decay_lines(run))
