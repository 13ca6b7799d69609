"""`rig archive compare`: one parameter as several rigs or laboratories measured it."""

from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError, DataError
from processing.estimate import Determinacy, Estimate
from processing.fit import KeyComparison, combine, compare_laboratories
from rig.archive.blind import sealed
from rig.archive.columns import COLUMNS, SHORT_NAMES
from rig.archive.listing import selected, write_output
from rig.archive.store import Archive, reads_archive
from rig.presentation import Cell, Table, palette, plain, print_tables, with_uncertainty
from rig.report import ReportFigure, canvas, png, styled, svg

_DIFFERENT = 0.05


@reads_archive
def compare_groups(
    archive: Path, column: str, by: str, where: str, output: Path | None, *, refits: bool = False
) -> None:
    """Print what each group of runs says of a column, the reference value, and who lies how far from it.

    Runs with the same value of the column `by` are one laboratory. Its value is the mean of its runs; what
    its budget holds beyond the fit's own uncertainty is shared by its runs and does not shrink with their
    number. `output` is an SVG or PNG to draw.

    Raises ConfigurationError for a column without uncertainties, or fewer than two groups.
    """
    by = SHORT_NAMES.get(by, by)
    if f"u_{column}" not in COLUMNS:
        raise ConfigurationError(
            f"{column}: has no uncertainty to compare with; docs/reference/archive.md lists the columns"
        )
    if by not in COLUMNS:
        raise ConfigurationError(f"--by {by}: is not a column; docs/reference/archive.md lists them")
    if output is not None and output.suffix not in (".svg", ".png"):
        raise ConfigurationError(f"{output}: is neither .svg nor .png")
    total = f"u_total_{column}" if f"u_total_{column}" in COLUMNS else "null"
    connection = Archive(archive).connection(refits=refits)
    table = "refits" if refits else "runs"
    verdict = f"verdict_{column}" if f"verdict_{column}" in COLUMNS else "null"
    rows = selected(connection, f"{by}, {column}, u_{column}, {total}, {verdict}", where, table).fetchall()
    groups: dict[str, list[Any]] = {}
    doubtful = 0
    for label, *numbers, said in rows:
        if label is not None and numbers[0] is not None and (numbers[1] or 0.0) > 0:
            groups.setdefault(str(label), []).append(numbers)
            doubtful += said not in (None, Determinacy.DETERMINED)
    if len(groups) < 2:
        raise ConfigurationError(
            f"--by {by}: {len(groups)} of its groups has {column} with its uncertainty, in {len(rows)} runs; "
            "a comparison needs two: take another column"
        )
    values = {label: _of_group(column, groups[label]) for label in sorted(groups)}
    try:
        found = compare_laboratories(column, list(values.values()))
    except DataError as error:
        raise ConfigurationError(str(error)) from None
    blind = "BLIND: a hidden offset is on the values; rig archive unblind. " if sealed(archive) else ""
    used = sum(map(len, groups.values()))
    note = f"Distance from the reference with U = 2 u; {_counted(len(rows) - used)} no {column}"
    if doubtful:
        note += (
            f", and {doubtful} of the {used} that are used do not determine it alone: they count with their "
            f"large uncertainty, --where \"verdict_{column} = 'determined'\" leaves them out"
        )
    print_tables(
        [_degrees_table(column, by, groups, values, found, f"{note}."), _means_table(column, found, blind)]
    )
    if output is not None:
        write_output(output, _drawn(column, values, found, output.suffix, blind))


def _counted(runs: int) -> str:
    return "1 run has" if runs == 1 else f"{runs} runs have"


def _of_group(column: str, rows: Sequence[Any]) -> Estimate:
    runs = [Estimate(value, u) for value, u, _ in rows]
    own = runs[0] if len(runs) == 1 else combine(column, runs).estimate
    shared = [u_total**2 - u**2 for _, u, u_total in rows if u_total is not None and u_total > u]
    more = sum(shared) / len(shared) if shared else 0.0
    return Estimate(own.value, sqrt(own.standard_uncertainty**2 + more))


def _degrees_table(
    column: str,
    by: str,
    groups: dict[str, list[Any]],
    values: dict[str, Estimate],
    found: KeyComparison,
    note: str,
) -> Table:
    rows: list[list[Cell]] = []
    shown = []
    for (label, value), degree in zip(values.items(), found.degrees, strict=True):
        rows.append([label, len(groups[label]), *value, degree.distance, degree.expanded])
        shown.append(
            [
                label,
                str(len(groups[label])),
                with_uncertainty(*value),
                plain(degree.distance, 3),
                plain(degree.expanded, 3),
                "differs" if degree.differs else "",
            ]
        )
    head = (by, "runs", column, "distance", "U", "")
    return Table(
        "degrees", f"{column} by {by}", (by, "runs", column, f"u_{column}", "d", "U"), rows, head, shown, note
    )


def _means_table(column: str, found: KeyComparison, blind: str) -> Table:
    means = [
        ("stated uncertainties alone", found.weighted, 0.0),
        ("DerSimonian-Laird", found.mean_dl, found.between_dl),
        ("Mandel-Paule (reference)", found.reference, found.between_mp),
    ]
    rows: list[list[Cell]] = [[name, *value, between] for name, value, between in means]
    shown = [[name, with_uncertainty(*value), plain(between, 3)] for name, value, between in means]
    scatter = "scatter more than they state" if found.p_homogeneous < _DIFFERENT else "agree"
    note = f"{blind}They {scatter} (p = {found.p_homogeneous:.2g})."
    columns = ("mean", column, f"u_{column}", "between")
    return Table("means", f"Mean of {column}", columns, rows, ("", column, "between"), shown, note)


def _drawn(column: str, values: dict[str, Estimate], found: KeyComparison, suffix: str, blind: str) -> bytes:
    with styled():
        figure = canvas(3.2)
        axes = figure.subplots()
        figure.subplots_adjust(left=0.14, bottom=0.28, top=0.96, right=0.98)
        reference, u = found.reference
        axes.axhspan(reference - 2 * u, reference + 2 * u, color=palette.SEQUENCE[1], alpha=0.25, lw=0)
        axes.axhline(reference, color=palette.SEQUENCE[1])
        for place, value in enumerate(values.values()):
            u_both = sqrt(value.standard_uncertainty**2 + found.between_mp**2)
            for half, width in ((2 * u_both, 0.6), (2 * value.standard_uncertainty, 1.6)):
                axes.errorbar(
                    place, value.value, half, fmt="o", color=palette.SEQUENCE[0], ms=4, elinewidth=width
                )
        axes.set_xticks(range(len(values)), list(values), rotation=30, ha="right")
        axes.set_ylabel(f"{column} (blind)" if blind else column)
        text = "Bars: twice the stated uncertainty; thin: with the scatter between groups. Band: reference."
        drawing = ReportFigure("comparison", f"{column} compared", text, figure)
        return svg(drawing) if suffix == ".svg" else png(drawing)
