"""Tables of parameters and of the quality of fits for terminal, report and Rerun; results on the terminal."""

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields
from functools import partial
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Final

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import Estimate
from processing.fit import FitMethod, FitQuality
from processing.instruments import Check
from processing.quantity import InstrumentQuantities, quantities_of
from processing.swing import HalfCycleFlag, turning_points
from processing.units import seconds
from rig.analysis.decay_values import INSTRUMENT, InstrumentSeries
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow, plain_row
from rig.analysis.results import ComparedLaws, RunResults, Series, SessionResults
from rig.analysis.results_file import encoded
from rig.analysis.run_remarks import RemarkLevel, decay_lines, limits_of, main_sources, remark_rows
from rig.analysis.run_values import TableDecay
from rig.terminal import Table, answer, decimals, plain, print_line, print_tables, quantity

logger = logging.getLogger(__name__)

if TYPE_CHECKING:
    from rig.analysis.series import AnalysedRun
    from rig.analysis.table_fit import AnalysedTable


def parameter_table(run: RunResults, *, full: bool = True) -> Table:
    """The table of results of one run; if `full`, also with the other fits and the half-cycles' own u."""
    asymptotic = {row.quantity: row for row in run.table if row.fit == FitMethod.ASYMPTOTIC}
    main_names = (*DEFAULT_LAW.names(drag=True), SURFACE_ENERGY)
    lines = []
    for row in run.contact:
        if not full and row.quantity not in main_names:
            continue
        texts = [row.shown.symbol, row.text, row.shown.unit]
        if full:
            u_half_cycles, other = row.u * row.shown.factor, asymptotic.get(row.quantity)
            texts.append(plain(u_half_cycles, 2) if u_half_cycles > 0 else "")
            texts.append("" if other is None or isnan(other.value) else other.text)
        lines.append([*texts, main_sources(row, run.budget)])
    head = [
        "",
        "value",
        "unit",
        *(["u of the swings", FitMethod.ASYMPTOTIC.heading] if full else []),
        _SOURCES,
    ]
    if not any(line[-1] for line in lines):
        head, lines = head[:-1], [line[:-1] for line in lines]
    title = "Parameters of the contact, exact fit"
    return Table("parameters", title, tuple(head), lines, _uncertainty_note(run))


_SOURCES = "main sources of its variance"
_PERIOD = "mean_period_s"
_PERIOD_NOTE = (
    "The uncertainty of the mean period contains that of the clock, and the change of the period with the "
    "amplitude."
)


def _uncertainty_note(run: RunResults) -> str:
    has_apparatus = any(map(limits_of, run.budget.values()))
    alone = "the swings alone, since none is stated of the apparatus"
    sources = "swings and apparatus together" if has_apparatus else alone
    return f"Value ± standard uncertainty of {sources}; 95 % where an interval or a bound."


def combined_table(results: SessionResults) -> Table | None:
    """The rows of several runs side by side with those of the series; None for fewer than two fitted runs."""
    runs = [(number, run) for number, run in zip(results.numbers, results.runs, strict=True) if run.contact]
    series = results.series
    if len(runs) < 2 or series is None or not series.table:
        return None
    lines = []
    for mean in series.table:
        rows = [run.rows.get(mean.quantity) for _, run in runs] + [mean]
        texts = ["" if row is None else row.text for row in rows]
        lines.append([mean.shown.symbol, *texts, mean.shown.unit])
    head = ("", *(f"run {number}" for number, _ in runs), "together", "unit")
    note = f"{_uncertainty_note(runs[0][1])} Together, also of what scatters between the runs."
    return Table("combined", "Parameters of the contact, exact fits", head, lines, note)


def quality_table(run: RunResults) -> Table:
    """The quantities of `FitQuality` and the outliers, a column for each fit, below the run's mean period.

    The period is that of the table of results, whose uncertainty contains the clock's and the change of the
    period; it is the same for every fit.
    """
    fits, methods = run.fits, [method for method in FitMethod if method in run.fits]
    lines = []
    if (period := run.rows.get(_PERIOD)) is not None:
        lines.append([period.shown.name, *[period.text] * len(methods), period.shown.unit])
    for key in quantities_of(FitQuality):
        form = quantity(key)
        if key == _PERIOD or not form.symbol:
            continue
        values = [getattr(fits[method], key) for method in methods]
        numbers = [str(v) if isinstance(v, int) else plain(v * form.factor, 3) for v in values]
        lines.append([form.name, *numbers, form.unit])
    lines.append(["outlying half-cycles", *(_list_text(fits[method].outliers) for method in methods), ""])
    head = ("", *(method.heading for method in methods), "unit")
    note = "" if period is None else _PERIOD_NOTE
    return Table("quality", "Quality of the fits", head, lines, note)


def _list_text(items: Sequence[int]) -> str:
    text = ", ".join(str(item) for item in items[:8])
    return f"{len(items)}: {text}{', …' if len(items) > 8 else ''}" if items else "none"


def law_table(compared: ComparedLaws) -> Table:
    """The laws, with the distance of each from the best one and the drive of the ground that it needs."""
    lines = []
    for name, law in compared.laws.items():
        if law.problem:
            lines.append([name, law.title, *[""] * 2, law.problem.partition(";")[0]])
            continue
        texts = [decimals(law.bic_above_best, 1), plain(law.ground_rad_per_s2_rthz, 2)]
        residuals = "as noise" if law.residuals_are_noise else "more than noise"
        verdict = f"{residuals}; {'excluded' if law.excluded else 'remains'}"
        lines.append([name, law.title, *texts, verdict])
    return Table(
        "laws",
        "Laws of the contact",
        ("law", "", "BIC", "drive", "residuals; verdict"),
        lines,
        "BIC: distance from the best law; above 10 it excludes a law. Drive of the ground that the law "
        "needs, in rad/s²/√Hz; what a law fails to describe appears as a stronger drive. Residuals: whether "
        "they exceed the noise.",
    )


_ORDER: Final = [field.name for field in fields(InstrumentQuantities)]
_HIDDEN: Final = ("damping_start_deg", "damping_end_deg")


def instrument_rows(results: RunResults) -> list[tuple[str, ResultRow]]:
    """Rows of another kind of pendulum in the order of their declaration, each with its name in words."""
    rows = [row for row in results.table if row.fit.startswith(INSTRUMENT) and row.quantity not in _HIDDEN]
    rows.sort(key=lambda row: _ORDER.index(row.quantity))
    return [(f"{row.shown.name}{row.fit.removeprefix(INSTRUMENT)}", row) for row in rows]


_INSTRUMENT_HEAD: Final = ("", "value ± u", "unit", "standard")


def instrument_table(results: RunResults) -> Table:
    """Table of every number with its unit, and of the standard's limits for environment and apparatus."""
    checks = () if results.instrument is None else results.instrument.checks
    lines = [[name, row.text, row.shown.unit, ""] for name, row in instrument_rows(results)]
    lines += map(_check_line, checks)
    width = 4 if checks else 3
    title = "What this kind of pendulum reports"
    return Table("instrument", title, _INSTRUMENT_HEAD[:width], [line[:width] for line in lines])


def _check_line(check: Check) -> list[str]:
    limits = f"{check.lowest:g} to {check.highest:g} wanted: {check.verdict}"
    return [check.name, f"{check.value:.5g}", check.unit, limits]


def instrument_series_rows(series: InstrumentSeries, *, with_places: bool) -> Iterator[tuple[str, ResultRow]]:
    """Ratios to a reference, and the means over places, each with its name in words."""
    for name, ratio in (("damping times", series.ratio), ("swings", series.ratio_of_swings)):
        if ratio is not None:
            yield f"ratio of {name}, sample to reference", plain_row("damping_swings", ratio, "")
    for key, mean in (("damping_time_s", series.time_s), ("damping_swings", series.swings)):
        if mean is not None and with_places:
            row = plain_row(key, Estimate(mean.value, mean.standard_uncertainty), "")
            places = f"{mean.places} place{'' if mean.places == 1 else f's, spread {mean.spread:.3g}'}"
            yield f"{row.shown.name}, mean of {places}", row


def instrument_series_table(series: InstrumentSeries) -> Table:
    """Table of means over the places of a sample, their ratio to a reference, and the apparatus on glass."""
    rows = [*instrument_series_rows(series, with_places=True)]
    if series.reference_time_s is not None:
        row = plain_row("damping_time_s", series.reference_time_s, "")
        rows.append(("damping time of the reference", row))
    lines = [[name, row.text, row.shown.unit, ""] for name, row in rows]
    lines += map(_check_line, series.acceptance or ())
    return Table("series", "The series", _INSTRUMENT_HEAD, lines)


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


def print_table(path: Path, table: "AnalysedTable") -> None:
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


def _print_decay(number: int, run: "AnalysedRun", decay: TableDecay) -> None:
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
