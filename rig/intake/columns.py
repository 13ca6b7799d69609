"""The columns of a table that hold time, positions and run number, and the rows of each run."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from processing.errors import ConfigurationError, DataError
from rig.intake.cell_text import counts_rows, is_timestamp, timestamps_ns
from rig.intake.cells import Cells
from rig.intake.times import number
from rig.intake.units import TIME_NAME, ColumnName, is_time, known_unit, split_name

_RUN_NAME: Final = re.compile(
    r"(?:run|trial|lauf|versuch|messung|messreihe|serie|series|experiment|essai|repeat|repetition|"
    r"wiederholung|sweep)(?:[\W_]*(?:no|nr|num|number|nummer|id|index))?\W*",
    re.I,
)
_MAX_SAMPLED_ROWS: Final = 50
_OTHER_DIRECTION: Final = re.compile(r"(?<![^\W_])[xyXY](?![^\W_])")
_DIRECTIONS: Final = {"x": "y", "y": "x", "X": "Y", "Y": "X"}
_MIN_NUMBER_FRACTION: Final = 0.95
"""Fraction of the cells of a second direction that must be numbers."""


class HeaderColumns:
    """The columns of a table by name or number, and the unit that each name states."""

    def __init__(self, path: Path, cells: Cells) -> None:
        self._path, self._cells = path, cells
        self.width: Final = len(cells.rows[0])
        names = cells.names or [""] * self.width
        self.names: Final = [name or f"column {k}" for k, name in enumerate(names, 1)]
        self.named: Final = [self._unit_of(k) for k in range(self.width)]

    def time(self, asked: str | None, rate_hz: float | None, time_unit: str = "") -> int | None:
        """The column of times; None if a rate replaces it."""
        if rate_hz is not None:
            if asked is not None or time_unit:
                raise ConfigurationError(
                    "--rate is for a table without times; leave --time and --time-unit out"
                )
            return None
        if asked is not None:
            return self.place(asked)
        if self.width < 2:
            raise DataError(
                f"{self._path}: has one column; time and position are needed, or the rate of its rows: "
                "--rate HZ"
            )
        like_time = [
            k
            for k, named in enumerate(self.named)
            if (self._cells.names and (TIME_NAME.fullmatch(named.name) or is_time(named.unit)))
            or all(is_timestamp(row[k]) for row in self._cells.rows[:_MAX_SAMPLED_ROWS])
        ]
        # leave out a date, which is the same in all rows
        first = self._cells.rows[:_MAX_SAMPLED_ROWS]
        like_time = [k for k in like_time if len({row[k] for row in first}) > 1] or like_time
        return like_time[0] if like_time else 1 if self.run() == 0 else 0

    def positions(self, asked: Sequence[str], t_column: int | None) -> list[int]:
        """The one or two columns of positions."""
        if len(asked) > 2:
            raise ConfigurationError(f"--position was given {len(asked)} times; one or two columns are used")
        if asked:
            return [self.place(name) for name in asked]
        others = [k for k in range(self.width) if k not in (t_column, self.run())]
        if t_column is None and len(others) > 1:
            raise ConfigurationError(
                f"{self._path}: has {self.width} columns; name the position with --position"
            )
        if len(others) > 1:
            # neither row numbers nor other times are positions
            left = [k for k in others if not is_time(self.named[k].unit)]
            others = [k for k in left if not counts_rows([row[k] for row in self._cells.rows])] or others
        following = [k for k in others if t_column is None or k > t_column]
        first = [*following, *others, 0][0]
        second = self._other_direction(first, others)
        return [first] if second is None else [first, second]

    def _other_direction(self, column: int, others: Sequence[int]) -> int | None:
        """The column of the other direction with a like name and unit, as y for x; None without one."""
        if not self._cells.names:
            return None
        here = self.named[column]
        other = _OTHER_DIRECTION.sub(lambda found: _DIRECTIONS[found[0]], here.name)
        for k in others:
            if k == column or self.named[k] != here._replace(name=other) or other == here.name:
                continue
            cells = [row[k] for row in self._cells.rows]
            if sum(math.isfinite(number(cell)) for cell in cells) >= _MIN_NUMBER_FRACTION * len(cells):
                return k
        return None

    def run(self) -> int | None:
        """The column with the run of each row, by its name; None without one."""
        found = [k for k, named in enumerate(self.named) if _RUN_NAME.fullmatch(named.name.strip())]
        return found[0] if self._cells.names and found else None

    def place(self, name: str) -> int:
        """The column of a name or number; raises ConfigurationError if there is none."""
        for among in (self.names if self._cells.names else [], [named.name for named in self.named]):
            if name in among:
                return list(among).index(name)
        if name.isdecimal() and 1 <= int(name) <= self.width:
            return int(name) - 1
        known = (
            ", ".join(self.names)
            if self._cells.names
            else f"1 to {self.width} (the table has no header line)"
        )
        raise ConfigurationError(f"{self._path}: has no column {name!r}; columns: {known}")

    def _unit_of(self, column: int) -> ColumnName:
        named = split_name(self.names[column]) if self._cells.names else ColumnName(self.names[column], "")
        beside = self._cells.units[column]
        if not beside:
            return named
        unit = known_unit(beside)
        return ColumnName(named.name, unit or named.unit, "" if unit or named.unit else beside)


_MIN_ROWS_OF_RUN: Final = 8
"""Fewest rows of a run: shorter blocks belong to the previous one; a column of row numbers counts no runs."""
_MISSING: Final = ("", "nan")


class RowsOfRun(NamedTuple):
    """One run: its name, its rows, and the feature that separates the runs of the table, in words."""

    name: str
    cells: Cells
    separator: str = ""


def separate_runs(cells: Cells, columns: HeaderColumns, t_column: int | None) -> list[RowsOfRun]:
    """The runs of a table; a single one has no name."""
    numbered = columns.run()
    if numbered is not None and numbered != t_column:
        labels = [_label(row[numbered]) for row in cells.rows]
        counts = Counter(label for label in labels if label.lower() not in _MISSING)
        if len(counts) > 1 and len(labels) >= _MIN_ROWS_OF_RUN * len(counts):
            separator = f"the column {columns.names[numbered]}"
            return [RowsOfRun(name, _rows(cells, labels, name), separator) for name in counts]
    blocks = _blocks(cells, t_column)
    if len(set(blocks)) > 1:
        separator = "blank lines between them" if t_column is None else "times that begin again"
        return [RowsOfRun(name, _rows(cells, blocks, name), separator) for name in dict.fromkeys(blocks)]
    return [RowsOfRun("", cells)]


def _label(cell: str) -> str:
    value = number(cell)
    return str(int(value)) if value.is_integer() else cell.strip()


def _blocks(cells: Cells, t_column: int | None) -> list[str]:
    """The number of the run for each row: a run begins after lines without rows, where times begin again."""
    between = cells.blocks if t_column is None else [line - k for k, line in enumerate(cells.lines)]
    borders = [k for k, (a, b) in enumerate(pairwise(between), 1) if a != b]
    starts = [0]
    for border in borders:
        if border - starts[-1] < _MIN_ROWS_OF_RUN or len(cells.rows) - border < _MIN_ROWS_OF_RUN:
            continue
        if t_column is not None:
            before = _first_time(row[t_column] for row in reversed(cells.rows[starts[-1] : border]))
            after = _first_time(row[t_column] for row in cells.rows[border:])
            if before is None or after is None or after > before:
                continue
        starts.append(border)
    if t_column is None and len(starts) <= len(borders):
        # blank lines also occur elsewhere, so they do not separate runs
        return ["1"] * len(cells.rows)
    marks = set(starts)
    run, found = 0, []
    for row in range(len(cells.rows)):
        run += row in marks
        found.append(str(run))
    return found


def _first_time(cells: Iterable[str]) -> float | None:
    """The first time in some cells; None without any."""
    times = (timestamps_ns([cell])[0] if is_timestamp(cell) else number(cell) for cell in cells)
    return next((time for time in times if time is not None and not math.isnan(time)), None)


def _rows(cells: Cells, labels: Sequence[str], name: str) -> Cells:
    """The cells of one run, with the left-out lines that follow its rows."""
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
