"""Several runs in one table: by a column of their numbers, or in blocks whose times begin again."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple

from rig.analysis.tables.cells import Cells
from rig.analysis.tables.columns import Columns
from rig.analysis.tables.moments import moments_ns
from rig.analysis.tables.numbers import is_moment
from rig.analysis.tables.times import number

_FEWEST_ROWS: Final = 8
"""Of a run; shorter blocks are part of the one before. A column that numbers each row numbers no runs."""
_MISSING: Final = ("", "nan")


class Run(NamedTuple):
    """One run: its name, its rows, and what tells the runs apart."""

    name: str
    cells: Cells
    told_by: str = ""


def runs_of(cells: Cells, columns: Columns, t_column: int | None) -> list[Run]:
    """The runs of a table; one without a name where there is only one."""
    numbered = columns.run()
    if numbered is not None and numbered != t_column:
        labels = [_label(row[numbered]) for row in cells.rows]
        counts = Counter(label for label in labels if label.lower() not in _MISSING)
        if len(counts) > 1 and len(labels) >= _FEWEST_ROWS * len(counts):
            told_by = f"the column {columns.names[numbered]}"
            return [Run(name, _part(cells, labels, name), told_by) for name in counts]
    blocks = _blocks(cells, t_column)
    if len(set(blocks)) > 1:
        told_by = "blank lines between them" if t_column is None else "times that begin again"
        return [Run(name, _part(cells, blocks, name), told_by) for name in dict.fromkeys(blocks)]
    return [Run("", cells)]


def _label(cell: str) -> str:
    value = number(cell)
    return str(int(value)) if value.is_integer() else cell.strip()


def _blocks(cells: Cells, t_column: int | None) -> list[str]:
    """For each row the number of its run: by lines without rows behind which the times begin again."""
    between = cells.blocks if t_column is None else [line - k for k, line in enumerate(cells.lines)]
    borders = [k for k, (a, b) in enumerate(pairwise(between), 1) if a != b]
    starts = [0]
    for border in borders:
        if border - starts[-1] < _FEWEST_ROWS or len(cells.rows) - border < _FEWEST_ROWS:
            continue
        if t_column is None or _begins_again(cells.rows, t_column, starts[-1], border):
            starts.append(border)
    if t_column is None and len(starts) <= len(borders):
        # blank lines elsewhere, too: they part nothing
        return ["1"] * len(cells.rows)
    marks = set(starts)
    run, found = 0, []
    for row in range(len(cells.rows)):
        run += row in marks
        found.append(str(run))
    return found


def _begins_again(rows: Sequence[Sequence[str]], t_column: int, start: int, border: int) -> bool:
    """Whether the first time behind a border is not later than the last one before it."""
    before = _first_time(row[t_column] for row in reversed(rows[start:border]))
    after = _first_time(row[t_column] for row in rows[border:])
    return before is not None and after is not None and after <= before


def _first_time(cells: Iterable[str]) -> float | None:
    return next((time for cell in cells if (time := _time(cell)) is not None), None)


def _time(cell: str) -> float | None:
    if is_moment(cell):
        return moments_ns([cell])[0]
    value = number(cell)
    return value if value == value else None


def _part(cells: Cells, labels: Sequence[str], name: str) -> Cells:
    """The rows of one run, and the lines left out that follow one of them."""
    kept = [k for k, label in enumerate(labels) if label == name]
    of_line = dict(zip(cells.lines, labels, strict=True))
    left_out, at, label = [], 0, labels[0]
    for line in cells.left_out:
        while at < len(cells.lines) and cells.lines[at] < line:
            label = of_line[cells.lines[at]]
            at += 1
        if label == name:
            left_out.append(line)
    return replace(
        cells,
        rows=[cells.rows[k] for k in kept],
        lines=[cells.lines[k] for k in kept],
        blocks=[cells.blocks[k] for k in kept],
        left_out=left_out,
    )
