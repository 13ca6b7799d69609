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

    Several fitted runs have one combined table, and each run only its faults. A single run has the exact fit
    with the whole budget, its limits and the steps against them. With INFO enabled for this logger
    (``rig -v``), every run has both fits with the half-cycles' own uncertainties, their quality, all remarks.
    """
    answer(results=partial(encoded, results), written=[path for _, path in paths])
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
    print_series(results.series)
    for name, path in paths:
        print(f"{name:<12} {path}")


def print_run(run: RunResults, head: str, lines: Sequence[str] = (), *, short: bool = False) -> None:
    """Print one run: its head, `lines` of its own, tables of the fits, remarks, conditions and warnings.

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
        print_tables([parameters, quality_table(run)] if full else [parameters])
    if run.instrument is not None:
        print_tables([instrument_table(run)])
    if run.laws is not None:
        print_tables([law_table(run.laws)])
        print_line(f"  {run.laws.verdict}")
    wanted = [RemarkLevel.RESULT, RemarkLevel.DETAIL if full else RemarkLevel.ADVICE] if not short else []
    lines = [*(run.instrument.text if run.instrument else ())]
    lines += [row.line for row in remark_rows(run, *wanted, RemarkLevel.CONDITION)]
    others = [RemarkLevel.WARNING, *([RemarkLevel.OF_OTHER_FIT] if full else [])]
    for line in (*lines, *(f"note: {row.text}" for row in remark_rows(run, *others))):
        print_line(f"  {line}")


_FLAGS = {
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
    for part in table.passed_over:
        print_line(
            f"  from {seconds(part[0].turn_time_ns):.4g} s on: {len(turning_points(part))} usable "
            f"half-cycles of {len(part)}, too few for a decay"
        )
    for number, decay in enumerate(table.runs, start=1):
        _print_decay(number, decay)
    print_series(table.series)


def print_series(series: Series | None) -> None:
    """Print the comparison of the places on a sample, of another instrument."""
    if series is not None and series.instrument is not None:
        print_tables([instrument_series_table(series.instrument)])
        for line in series.instrument.lines:
            print_line(line)


def _print_decay(number: int, decay: AnalysedRun) -> None:
    usable = len(turning_points(decay.swings))
    place, (first, last) = decay.decay or TableDecay(), decay.amplitudes
    head = (
        f"decay {number}, {place.began_s:.4g} to {place.ended_s:.4g} s: {usable} half-cycles "
        f"({len(decay.swings) - usable} more flagged and left out{_reasons(decay)}), "
        f"amplitude {first:.4g} to {last:.4g} {decay.amplitude_unit}"
    )
    print_run(decay, head, decay_lines(decay))


def _reasons(decay: AnalysedRun) -> str:
    """Flags of the half-cycles that are left out, with their numbers, the most frequent first."""
    counts = Counter(name for swing in decay.swings for flag, name in _FLAGS.items() if swing.flags & flag)
    return "".join(f"{', ' if k else ': '}{n} {name}" for k, (name, n) in enumerate(counts.most_common()))
