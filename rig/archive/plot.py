"""`rig archive plot`: one column of the catalogue against another, with bars."""

from collections.abc import Sequence
from itertools import cycle
from math import nan
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError
from rig.archive.columns import COLUMNS, OF_REFITS, SHORT_NAMES
from rig.archive.listing import selected, write_output
from rig.archive.store import Archive, reads_archive
from rig.presentation import palette

_MOST_GROUPS = 12


@reads_archive
def plot_runs(
    archive: Path, x: str, y: str, by: str, condition: str, output: Path, *, refits: bool = False
) -> str:
    """Draw y against x of the runs that meet a condition into a new SVG or PNG; says how many they are.

    `x` and `y` are columns; bars are their standard uncertainties, where the catalogue has them. Runs with
    the same value of the column `by` share a colour; empty: all do. Runs that lack x or y are left out.

    Raises ConfigurationError for a column or a kind of file that does not exist, or no run to draw.
    """
    if output.suffix not in (".svg", ".png"):
        raise ConfigurationError(f"{output}: is neither .svg nor .png")
    x, y, by = (SHORT_NAMES.get(name, name) for name in (x, y, by))
    columns = {**COLUMNS, **(OF_REFITS if refits else {})}
    for name in filter(None, (x, y, by)):
        if name not in columns:
            raise ConfigurationError(f"{name}: is not a column; docs/reference/archive.md lists them")
    if columns[y].kind not in ("number", "count"):
        raise ConfigurationError(f"{y}: holds no numbers; only x and --by may be texts")
    bars = [f"u_{name}" if f"u_{name}" in COLUMNS else "null" for name in (x, y)]
    wanted = ", ".join([x, y, *bars, by or "''"])
    connection = Archive(archive).connection(refits=refits)
    found = selected(connection, wanted, condition, "refits" if refits else "runs").fetchall()
    groups: dict[str, list[Sequence[Any]]] = {}
    for row in found:
        if row[0] is not None and row[1] is not None:
            groups.setdefault(str(row[4]), []).append(row)
    if not groups:
        raise ConfigurationError(f"none of {len(found)} runs has both {x} and {y}")
    if len(groups) > _MOST_GROUPS:
        raise ConfigurationError(f"{by}: has {len(groups)} values; {_MOST_GROUPS} can be told apart")
    write_output(output, _drawn(x, y, groups, output.suffix))
    drawn = sum(map(len, groups.values()))
    return f"{output}: {drawn} of {len(found)} run{'s' if len(found) != 1 else ''}"


def _drawn(x: str, y: str, groups: dict[str, list[Sequence[Any]]], suffix: str) -> bytes:
    # takes a second to import, which `list` must not wait for
    from rig.report import ReportFigure, canvas, png, styled, svg

    with styled():
        figure = canvas(3.6)
        axes = figure.subplots()
        for (name, rows), colour in zip(sorted(groups.items()), cycle(palette.SEQUENCE), strict=False):
            at, values, u_at, u_values = ([row[place] for row in rows] for place in range(4))
            measured = {**COLUMNS, **OF_REFITS}[x].kind in ("number", "count")
            axes.errorbar(
                at,
                values,
                yerr=[nan if u is None else u for u in u_values],
                xerr=[nan if u is None else u for u in u_at] if measured else None,
                fmt="o",
                color=colour,
                ms=3,
                capsize=2,
                elinewidth=0.7,
                label=name or None,
            )
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        if any(groups):
            axes.legend()
        if {**COLUMNS, **OF_REFITS}[x].kind in ("time", "text"):
            figure.autofmt_xdate()
        drawing = ReportFigure("archive", f"{y} against {x}", "Bars are standard uncertainties.", figure)
        return svg(drawing) if suffix == ".svg" else png(drawing)
