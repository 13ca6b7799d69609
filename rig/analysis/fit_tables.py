"""Tables of the fitted parameters and of the quality of the fits, for terminal, report and Rerun."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from math import isnan
from typing import Final

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import Estimate
from processing.fit import FitMethod, FitQuality
from processing.instruments import Check
from processing.quantity import InstrumentQuantities, quantities_of
from rig.analysis.decay_values import INSTRUMENT, InstrumentSeries
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow, plain_row
from rig.analysis.results import ComparedLaws, RunResults, SessionResults
from rig.analysis.run_remarks import limits_of, main_sources
from rig.terminal import Table, decimals, plain, quantity


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
