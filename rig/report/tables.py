"""Tables of a run: its fits and what follows from them. Every number comes from results.json."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from processing.contact.laws import PAPER
from processing.fit import FitMethod
from rig.analysis import Curves, RunData
from rig.presentation import Cell, Table, determined_text, number, plain, quantity, with_uncertainty
from rig.report.tables_uncertainty import budget_table, identifiability_table, monte_carlo_table


def run_tables(run: RunData, curves: Curves | None) -> list[Table]:
    """All tables of one run; a table without content is left out."""
    results = run.results
    tables = [instrument_table(results), half_cycle_table(run, curves)]
    if results.get("fits"):
        tables = [
            parameter_table(results),
            quality_table(results),
            hertz_table(results),
            work_table(results),
            drag_table(results),
            identifiability_table(results),
            budget_table(results.get("budget") or {}),
            monte_carlo_table(results),
            correlation_table(results),
            *tables,
        ]
    return [table for table in tables if table.rows]


def instrument_table(results: Mapping[str, Any]) -> Table:
    """What is reported of another kind of pendulum: every number with its name of results.json."""
    rows: list[list[Cell]] = []
    shown = []
    for name, value, u in _numbers(results.get("instrument") or {}):
        rows.append([name, value, u])
        text = value if isinstance(value, str) else with_uncertainty(value, u)
        shown.append([name.replace("_", " ").replace(".", ": "), text])
    return Table(
        "instrument", "What this kind of pendulum reports",
        ("quantity", "value", "standard_uncertainty"), rows, ("", ""), shown,
    )  # fmt: skip


def _numbers(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, float | str, float]]:
    for key, value in tree.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping) and "value" in value:
            yield name, number(value, "value"), number(value, "standard_uncertainty")
        elif isinstance(value, Mapping):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, list) and len(value) <= _SHORT_LIST:
            yield from _numbers({str(place): item for place, item in enumerate(value, start=1)}, f"{name}.")
        elif isinstance(value, bool | str):
            yield name, str(value), math.nan
        elif isinstance(value, int | float):
            yield name, float(value), math.nan


_SHORT_LIST = 12
"""Longer lists (a value for every half-cycle) stay in results.json."""


def parameter_table(results: Mapping[str, Any]) -> Table:
    """Parameters and surface energies of both fits; what is not determined as interval or bound."""
    fits, energy = results["fits"], results.get("surface_energy_j_per_m2") or {}
    verdicts = {item["name"]: item for item in results.get("identifiability") or []}
    rows: list[list[Cell]] = []
    shown = []
    entries: list[tuple[str, list[Mapping[str, Any]]]] = [
        (name, [fits[method].get(name) or {} for method in FitMethod])
        for name in PAPER.names(drag=True)
        if name in fits[FitMethod.EXACT]
    ]
    if energy:
        for key in ("table2", "eq2"):
            entries.append(
                (f"surface_energy_{key}_j_per_m2", [energy[FitMethod.ASYMPTOTIC][key], energy[key]])
            )
    for name, estimates in entries:
        shown_as = quantity(name)
        pairs = [(number(fit, "value"), number(fit, "standard_uncertainty")) for fit in estimates]
        rows.append([name, *pairs[0], *pairs[1]])
        text = determined_text(name, *pairs[1], verdicts)
        shown.append([shown_as.symbol, shown_as.text(*pairs[0]), text, shown_as.unit])
    return Table(
        "parameters",
        "Parameters of the contact",
        ("parameter", *(column for method in FitMethod for column in (method, f"u_{method}"))),
        rows,
        ("", *(method.heading for method in FitMethod), "unit"),
        shown,
        "Value ± standard uncertainty of the swings alone; the budget adds the apparatus. Eqs. 5 and 6 are "
        "asymptotic and biased by some per cent; the exact map is not.",
    )


def quality_table(results: Mapping[str, Any]) -> Table:
    """chi2/dof, ARAE of Eqs. 8 and 9, outliers of both fits."""
    fits = results["fits"]
    keys = {
        "chi2_per_dof": "χ² per degree of freedom",
        "degrees_of_freedom": "degrees of freedom",
        "arae_decay": "ARAE of the amplitudes, Eq. 8",
        "arae_period": "ARAE of the periods, Eq. 9",
    }
    rows: list[list[Cell]] = [[key, *(number(fits[method], key) for method in FitMethod)] for key in keys]
    shown = [[keys[str(row[0])], *(plain(float(v), 3) for v in row[1:])] for row in rows]
    lists = [fits[method].get("outliers") or [] for method in FitMethod]
    rows.append(["outlying_half_cycles", *(" ".join(map(str, found)) for found in lists)])
    shown.append(["outlying half-cycles", *(_listed(found) for found in lists)])
    return Table(
        "quality", "Quality of the fits", ("quantity", *FitMethod), rows,
        ("", *(method.heading for method in FitMethod)), shown,
    )  # fmt: skip


def _listed(items: Sequence[int]) -> str:
    text = ", ".join(str(item) for item in items[:8])
    return f"{len(items)}: {text}{', …' if len(items) > 8 else ''}" if items else "none"


def hertz_table(results: Mapping[str, Any]) -> Table:
    """Contact after Hertz (Table 1 of the paper)."""
    rows: list[list[Cell]] = []
    shown = []
    for key, name in (
        ("radius_m", "contact_radius_m"), ("depth_m", "contact_depth_m"), ("angle_rad", "contact_angle_rad"),
    ):  # fmt: skip
        item = (results.get("hertz") or {}).get(key)
        if item is None:
            continue
        value, u = number(item, "value"), number(item, "standard_uncertainty")
        rows.append([name, value, u])
        shown.append([quantity(name).symbol, quantity(name).text(value, u), quantity(name).unit])
    return Table(
        "hertz", "Contact after Hertz", ("quantity", "value", "standard_uncertainty"), rows,
        ("", "value", "unit"), shown,
    )  # fmt: skip


def work_table(results: Mapping[str, Any]) -> Table:
    """4A and 4A_t at the amplitude of Table 4 and at the start of the run."""
    rows: list[list[Cell]] = []
    shown = []
    for item in results.get("work_per_cycle") or []:
        both = [item["dissipated_4a_j"], item["adhesive_4at_j"]]
        pairs = [(number(tree, "value"), number(tree, "standard_uncertainty")) for tree in both]
        rows.append([item["amplitude_arcsec"], *pairs[0], *pairs[1]])
        share = pairs[1][0] / pairs[0][0] if pairs[0][0] else math.nan
        texts = [with_uncertainty(value * 1e15, u * 1e15) for value, u in pairs]
        shown.append([plain(item["amplitude_arcsec"], 4), *texts, f"{100 * share:.1f} %"])
    return Table(
        "work", "Work over one cycle",
        ("amplitude_arcsec", "4A_j", "u_4A_j", "4A_t_j", "u_4A_t_j"), rows,
        ("α / arcsec", "4A / fJ", "4Aₜ / fJ", "share of adhesion"), shown,
    )  # fmt: skip


def drag_table(results: Mapping[str, Any]) -> Table:
    """The comparison of the exact fit with and without a linear drag."""
    drag = results.get("drag") or {}
    if not drag:
        return Table("drag", "", (), ())
    value, u = number(drag["drag_s"], "value"), number(drag["drag_s"], "standard_uncertainty")
    keys = ("f_statistic", "p_value", "aic_difference", "relative_shift_b", "relative_shift_c")
    rows: list[list[Cell]] = [["drag_s", value], ["u_drag_s", u]]
    rows += [[key, number(drag, key)] for key in keys]
    rows.append(["significant", str(bool(drag["significant"]))])
    numbers = [number(drag, key) for key in keys]
    shown = [
        ["linear drag", f"{quantity('drag_s').text(value, u)} s"],
        ["F-test", f"F = {plain(numbers[0], 3)}, chance without drag {plain(numbers[1], 2)}"],
        ["AIC with − without", plain(numbers[2], 3)],
        ["b moves by", f"{100 * numbers[3]:+.2f} %".replace("-", "−")],
        ["c moves by", f"{100 * numbers[4]:+.2f} %".replace("-", "−")],
        ["verdict", "a linear drag is in the data" if drag["significant"] else drag["text"].split(":")[0]],
    ]
    return Table("drag", "Is there a linear drag?", ("quantity", "value"), rows, ("", ""), shown)


def correlation_table(results: Mapping[str, Any]) -> Table:
    """The correlation matrix of the exact fit, for the file; the report draws it."""
    tree = results["fits"][FitMethod.EXACT]["correlation"]
    rows: list[list[Cell]] = [
        [name, *(math.nan if v is None else v for v in row)]
        for name, row in zip(tree["names"], tree["matrix"], strict=True)
    ]
    return Table("correlation", "Correlation matrix", ("", *tree["names"]), rows)


def half_cycle_table(run: RunData, curves: Curves | None) -> Table:
    """Every half-cycle that was fitted, with the models beside it, for the file."""
    points, unit = run.points, run.motion.unit
    columns = ["index", "time_s", "u_time_s", f"amplitude_{unit}", f"u_amplitude_{unit}"]
    arrays = [
        points.index, points.time_s, points.u_time_s,
        points.amplitude / run.unit_rad, points.u_amplitude / run.unit_rad,
    ]  # fmt: skip
    if curves is not None:
        columns += [f"asymptotic_{unit}", f"exact_{unit}", "exact_time_s"]
        arrays += [curves.asymptotic_rad / run.unit_rad, curves.exact_rad / run.unit_rad, curves.exact_time_s]
    rows = list(zip(*(array.tolist() for array in arrays), strict=True))
    return Table("half-cycles", "Half-cycles", columns, rows)
