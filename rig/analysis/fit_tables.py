"""Tables of the fitted parameters and of the quality of the fits, for terminal, report and Rerun."""

from collections.abc import Mapping, Sequence

from processing.contact.laws import DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import Determination, FitMethod, FitQuality
from processing.quantity import quantities_of
from rig.analysis.contact_results import Fit, SurfaceEnergies
from rig.analysis.determined import determined_text, series_verdicts
from rig.analysis.headline import SURFACE_ENERGY, budget_of, dominant_text
from rig.analysis.results import RunResults, SessionResults
from rig.presentation import Cell, Table, plain, quantity, signed_percent

_LARGEST_BIAS = 0.3
"""Of a parameter, as a fraction of it."""


def parameter_table(
    fits: Mapping[str, Fit], energy: SurfaceEnergies | None, verdicts: Mapping[str, Determination]
) -> Table:
    """Parameters and surface energies, a column for each fit.

    `verdicts` are those on the default fit's parameters: in its column one that the data do not determine is
    shown as an interval or a bound.
    """
    methods = _in_order(fits)
    entries: list[tuple[str, list[Estimate | None]]] = [
        (name, [fits[method].parameters.get(name) for method in methods])
        for name in DEFAULT_LAW.names(drag=True)
    ]
    if energy is not None:
        of_fits = [energy.of(method) for method in methods]
        entries += [
            (
                "surface_energy_table2_j_per_m2",
                [None if found is None else found.table2 for found in of_fits],
            ),
            ("surface_energy_eq2_j_per_m2", [None if found is None else found.eq2 for found in of_fits]),
        ]
    rows: list[list[Cell]] = []
    shown = []
    for name, estimates in entries:
        if not any(estimates):
            continue
        rows.append([name, *(number for found in estimates for number in found or NOT_DETERMINED)])
        texts = [
            "" if found is None
            else determined_text(name, found, verdicts if method == FitMethod.EXACT else {})
            for method, found in zip(methods, estimates, strict=True)
        ]  # fmt: skip
        shown.append([quantity(name).symbol, *texts, quantity(name).unit])
    return Table(
        "parameters",
        "Parameters of the contact",
        ("parameter", *(column for method in methods for column in (method, f"u_{method}"))),
        rows,
        ("", *map(_heading, methods), "unit"),
        shown,
        "Value ± standard uncertainty of the swings alone; the budget adds the apparatus. " + _of_bias(fits),
    )


def whole_table(run: RunResults) -> Table:
    """The exact fit with the uncertainty of swings and apparatus together, and what makes most of it.

    Without content where no apparatus is stated that could add to the swings'.
    """
    exact, verdicts, energy = run.fits.get(FitMethod.EXACT), run.verdicts(), run.surface_energy_j_per_m2
    found = {} if exact is None else dict(exact.parameters)
    if energy is not None:
        found[SURFACE_ENERGY] = energy.table2
    order = [*DEFAULT_LAW.names(drag=True), SURFACE_ENERGY]
    rows: list[list[Cell]] = []
    shown = []
    for name in (each for each in order if each in found):
        whole = budget_of(name, run.budget, verdicts)
        estimate = found[name] if whole is None else Estimate(whole.value, whole.standard_uncertainty)
        rows.append([name, *estimate])
        cause = "" if whole is None else dominant_text(whole)
        shown.append(
            [quantity(name).symbol, determined_text(name, estimate, verdicts), quantity(name).unit, cause]
        )
    return Table(
        "whole",
        "Parameters of the contact, exact fit",
        ("parameter", "value", "standard_uncertainty"),
        rows if any(row[-1] for row in shown) else (),
        ("", "value", "unit", "main sources of its variance"),
        shown,
        "Value ± standard uncertainty of swings and apparatus together.",
    )


def combined_table(results: SessionResults) -> Table | None:
    """The exact fits of several runs beside each other, and of the series; None where fewer are fitted."""
    numbered = zip(results.numbers, results.runs, strict=True)
    fits = [(number, run) for number, run in numbered if FitMethod.EXACT in run.fits]
    series = {} if results.series is None else results.series.fits.get(FitMethod.EXACT, {})
    if len(fits) < 2 or not series:
        return None
    verdicts = series_verdicts(series)
    energies = [run.surface_energy_j_per_m2 for _, run in fits]
    together = results.series.surface_energy_j_per_m2 if results.series is not None else None
    rows: list[list[Cell]] = []
    shown = []
    for name in DEFAULT_LAW.names():
        estimates = [run.fits[FitMethod.EXACT].parameters.get(name) for _, run in fits]
        item = series.get(name)
        if item is None or not any(estimates):
            continue
        whole = Estimate(item.value, item.standard_uncertainty)
        rows.append([name, *(number for found in (*estimates, whole) for number in found or NOT_DETERMINED)])
        texts = [
            "" if found is None else determined_text(name, found, run.verdicts())
            for found, (_, run) in zip(estimates, fits, strict=True)
        ]
        shown.append(
            [quantity(name).symbol, *texts, determined_text(name, whole, verdicts), quantity(name).unit]
        )
    if together is not None and all(energies):
        name = "surface_energy_table2_j_per_m2"
        found = [*(energy.table2 for energy in energies if energy is not None), together.table2]
        rows.append([name, *(number for estimate in found for number in estimate)])
        known = [*(run.verdicts() for _, run in fits), verdicts]
        texts = [determined_text(name, one, judged) for one, judged in zip(found, known, strict=True)]
        shown.append([quantity(name).symbol, *texts, quantity(name).unit])
    heads = [f"run {number}" for number, _ in fits]
    return Table(
        "combined", "Parameters of the contact, exact fits",
        ("parameter", *(column for head in (*heads, "together") for column in (head, f"u_{head}"))), rows,
        ("", *heads, "together", "unit"), shown,
        "Value ± standard uncertainty of the swings; together, also of what scatters between the runs.",
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
