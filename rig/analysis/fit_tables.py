"""Tables of the fitted parameters and of the quality of the fits, for terminal, report and Rerun."""

from collections.abc import Mapping, Sequence
from math import isnan, nan

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import FitMethod, FitQuality
from processing.quantity import quantities_of
from rig.analysis.contact_results import Fit
from rig.analysis.headline import dominant_text, has_apparatus
from rig.analysis.result_rows import SURFACE_ENERGY
from rig.analysis.results import RunResults, SessionResults
from rig.presentation import Cell, Table, plain, quantity, signed_percent

_LARGEST_BIAS = 0.3
"""Of a parameter, as a fraction of it."""


def parameter_table(run: RunResults, *, full: bool = True) -> Table:
    """The table of results of one run; `full` also what the other fits give, and the swings' own uncertainty.

    What is not determined has no value by any method.
    """
    others = [method for method in _in_order(run.fits) if method != FitMethod.EXACT] if full else []
    rows: list[list[Cell]] = []
    shown = []
    named = (*DEFAULT_LAW.names(drag=True), SURFACE_ENERGY)
    for row in (row for row in run.table if full or row.quantity in named):
        found = [
            run.fits[method].estimate(row.quantity) if row.determined else NOT_DETERMINED for method in others
        ]
        numbers = [row.value, row.u, row.u_total, row.lower, row.upper]
        rows.append(
            [row.quantity, *numbers, str(row.verdict), row.unit, *(each for one in found for each in one)]
        )
        item = run.budget.get(row.quantity)
        texts = [row.text, row.shown.unit]
        if full:
            alone = row.u * row.shown.factor
            texts.append(plain(alone, 2) if alone > 0 else "")
            texts += ["" if isnan(one.value) else row.shown.text(*one) for one in found]
        texts.append(
            dominant_text(item) if item is not None and row.determined and has_apparatus(item) else ""
        )
        shown.append([row.shown.symbol, *texts])
    head = ["", "value", "unit", *(["u of the swings", *map(_heading, others)] if full else []), _SOURCES]
    if not any(row[-1] for row in shown):
        head, shown = head[:-1], [row[:-1] for row in shown]
    return Table(
        "parameters", "Parameters of the contact, exact fit",
        (*_COLUMNS, *(column for method in others for column in (method, f"u_{method}"))), rows,
        tuple(head), shown, _of_whole(run) + (f" {_of_bias(run.fits)}" if others else ""),
    )  # fmt: skip


_SOURCES = "main sources of its variance"
_COLUMNS = ("parameter", "value", "u", "u_total", "lower_95", "upper_95", "verdict", "unit")


def _of_whole(run: RunResults) -> str:
    whole = any(has_apparatus(item) for item in run.budget.values())
    of = (
        "swings and apparatus together"
        if whole
        else "the swings alone, since none is stated of the apparatus"
    )
    return f"Value ± standard uncertainty of {of}; 95 % where an interval or a bound."


def combined_table(results: SessionResults) -> Table | None:
    """The rows of several runs beside each other, and of the series; None where fewer are fitted."""
    runs = [(number, run) for number, run in zip(results.numbers, results.runs, strict=True) if run.table]
    series = results.series
    if len(runs) < 2 or series is None or not series.table:
        return None
    rows: list[list[Cell]] = []
    shown = []
    for whole in series.table:
        found = [run.rows.get(whole.quantity) for _, run in runs] + [whole]
        rows.append([whole.quantity, *(number for row in found for number in (row or (nan, nan)))])
        texts = ["" if row is None else row.text for row in found]
        shown.append([whole.shown.symbol, *texts, whole.shown.unit])
    heads = [f"run {number}" for number, _ in runs]
    return Table(
        "combined", "Parameters of the contact, exact fits",
        ("parameter", *(column for head in (*heads, "together") for column in (head, f"u_total_{head}"))),
        rows,
        ("", *heads, "together", "unit"), shown,
        f"{_of_whole(runs[0][1])} Together, also of what scatters between the runs.",
    )  # fmt: skip


def _of_bias(fits: Mapping[str, Fit]) -> str:
    asymptotic, exact = fits.get(FitMethod.ASYMPTOTIC), fits.get(FitMethod.EXACT)
    if asymptotic is None or exact is None or not asymptotic.bias:
        return "Eqs. 5 and 6 are asymptotic and biased by some per cent; the exact map is not."
    # of a parameter that the data hardly determine, a bias in per cent says nothing
    listed = ", ".join(
        f"{quantity(name).symbol} {signed_percent(moved / exact.parameters[name].value)}"
        for name, moved in asymptotic.bias.items()
        if abs(moved) < _LARGEST_BIAS * abs(exact.parameters[name].value)
    )
    return f"Eqs. 5 and 6 are asymptotic; their bias here: {listed}."


def quality_table(fits: Mapping[str, Fit]) -> Table:
    """What is declared of a fit's quality, and the outliers, a column for each fit."""
    methods = _in_order(fits)
    rows: list[list[Cell]] = []
    shown = []
    for key in quantities_of(FitQuality):
        form = quantity(key)
        if not form.symbol:
            continue
        values = [getattr(fits[method], key) for method in methods]
        if isinstance(values[0], Estimate):
            rows += [
                [key, *(one.value for one in values)],
                [f"u_{key}", *(one.standard_uncertainty for one in values)],
            ]
            texts = [form.text(*one) for one in values]
        else:
            rows.append([key, *values])
            texts = [str(v) if isinstance(v, int) else plain(v * form.factor, 3) for v in values]
        shown.append([form.name, *texts, form.unit])
    outliers = [fits[method].outliers for method in methods]
    rows.append(["outlying_half_cycles", *(" ".join(map(str, found)) for found in outliers)])
    shown.append(["outlying half-cycles", *map(_listed, outliers), ""])
    return Table(
        "quality", "Quality of the fits", ("quantity", *methods), rows,
        ("", *map(_heading, methods), "unit"), shown,
    )  # fmt: skip


def _in_order(fits: Mapping[str, Fit]) -> list[str]:
    known = [method.value for method in FitMethod if method in fits]
    return [*known, *(name for name in fits if name not in known)]


def _heading(method: str) -> str:
    """A file may hold fits of a method that is not known here."""
    return {known.value: known.heading for known in FitMethod}.get(method, method)


def _listed(items: Sequence[int]) -> str:
    text = ", ".join(str(item) for item in items[:8])
    return f"{len(items)}: {text}{', …' if len(items) > 8 else ''}" if items else "none"
