"""The columns of a table that hold time, positions and run number, and the rows of each run."""

import math
import re
from bisect import bisect_left
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
_DIRECTION: Final = re.compile(r"(?<![^\W_])[xyXY](?![^\W_])")
_OTHER_DIRECTION: Final = {"x": "y", "y": "x", "X": "Y", "Y": "X"}
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

    def time(self, name: str | None, rate_hz: float | None, time_unit: str = "") -> int | None:
        """The column of times, that of a `name` if stated; None if a rate replaces it."""
        if rate_hz is not None:
            if name is not None or time_unit:
                raise ConfigurationError(
                    "--rate is for a table without times; leave --time and --time-unit out"
                )
            return None
        if name is not None:
            return self.place(name)
        if self.width < 2:
            raise DataError(
                f"{self._path}: has one column; time and position are needed, or the rate of its rows: "
                "--rate HZ"
            )
        sample = self._cells.rows[:_MAX_SAMPLED_ROWS]
        like_time = [
            k
            for k, column in enumerate(self.named)
            if (self._cells.names and (TIME_NAME.fullmatch(column.name) or is_time(column.unit)))
            or all(is_timestamp(row[k]) for row in sample)
        ]
        # leave out a date, which is the same in all rows
        like_time = [k for k in like_time if len({row[k] for row in sample}) > 1] or like_time
        return like_time[0] if like_time else 1 if self.run() == 0 else 0

    def positions(self, names: Sequence[str], t_column: int | None) -> list[int]:
        """The one or two columns of positions, those of `names` if stated."""
        if len(names) > 2:
            raise ConfigurationError(f"--position was given {len(names)} times; one or two columns are used")
        if names:
            return [self.place(name) for name in names]
        others = [k for k in range(self.width) if k not in (t_column, self.run())]
        if t_column is None and len(others) > 1:
            raise ConfigurationError(
                f"{self._path}: has {self.width} columns; name the position with --position"
            )
        if len(others) > 1:
            # neither row numbers nor other times are positions
            no_times = [k for k in others if not is_time(self.named[k].unit)]
            others = [k for k in no_times if not counts_rows([row[k] for row in self._cells.rows])] or others
        after_time = [k for k in others if t_column is None or k > t_column]
        first = [*after_time, *others, 0][0]
        second = self._other_direction(first, others)
        return [first] if second is None else [first, second]

    def _other_direction(self, column: int, others: Sequence[int]) -> int | None:
        """The column of the other direction with a like name and unit, as y for x; None without one."""
        if not self._cells.names:
            return None
        first = self.named[column]
        second = first._replace(name=_DIRECTION.sub(lambda match: _OTHER_DIRECTION[match[0]], first.name))
        for k in others:
            if self.named[k] != second or second == first:
                continue
            cells = [row[k] for row in self._cells.rows]
            if sum(math.isfinite(number(cell)) for cell in cells) >= _MIN_NUMBER_FRACTION * len(cells):
                return k
        return None

    def run(self) -> int | None:
        """The column with the run of each row, by its name; None without one."""
        named = (k for k, column in enumerate(self.named) if _RUN_NAME.fullmatch(column.name.strip()))
        return next(named, None) if self._cells.names else None

    def place(self, name: str) -> int:
        """The column of a name or number; raises ConfigurationError if there is none."""
        for names in (self.names if self._cells.names else [], [column.name for column in self.named]):
            if name in names:
                return names.index(name)
        if name.isdecimal() and 1 <= int(name) <= self.width:
            return int(name) - 1
        known = (
            ", ".join(self.names)
            if self._cells.names
            else f"1 to {self.width} (the table has no header line)"
        )
        raise ConfigurationError(f"{self._path}: has no column {name!r}; columns: {known}")

    def _unit_of(self, column: int) -> ColumnName:
        in_name = split_name(self.names[column]) if self._cells.names else ColumnName(self.names[column], "")
        text = self._cells.units[column]
        if not text:
            return in_name
        unit = known_unit(text) or in_name.unit
        return ColumnName(in_name.name, unit, "" if unit else text)


_MIN_ROWS_OF_RUN: Final = 8
"""Fewest rows of a run: shorter blocks belong to the previous one; a column of row numbers counts no runs."""
_MISSING: Final = ("", "nan")


class RowsOfRun(NamedTuple):
    """One run of a table."""

    name: str
    cells: Cells
    separator: str = ""
    """What separates the runs of the table, in words; empty for a single run."""


def separate_runs(cells: Cells, columns: HeaderColumns, t_column: int | None) -> list[RowsOfRun]:
    """The runs of a table; a single one has no name."""
    run_column = columns.run()
    if run_column is not None and run_column != t_column:
        labels = [_label(row[run_column]) for row in cells.rows]
        counts = Counter(label for label in labels if label.lower() not in _MISSING)
        if len(counts) > 1 and len(labels) >= _MIN_ROWS_OF_RUN * len(counts):
            separator = f"the column {columns.names[run_column]}"
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
    blocks = cells.blocks if t_column is None else [line - k for k, line in enumerate(cells.lines)]
    borders = [k for k, (a, b) in enumerate(pairwise(blocks), 1) if a != b]
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
    ends = [*starts[1:], len(cells.rows)]
    return [str(run) for run, (a, b) in enumerate(zip(starts, ends, strict=True), 1) for _ in range(a, b)]


def _first_time(cells: Iterable[str]) -> float | None:
    """The first time in some cells; None without any."""
    times = (timestamps_ns([cell])[0] if is_timestamp(cell) else number(cell) for cell in cells)
    return next((time for time in times if time is not None and not math.isnan(time)), None)


def _rows(cells: Cells, labels: Sequence[str], name: str) -> Cells:
    """The cells of one run, with the left-out lines that follow its rows."""
    rows = [k for k, label in enumerate(labels) if label == name]
    return replace(
        cells,
        rows=[cells.rows[k] for k in rows],
        lines=[cells.lines[k] for k in rows],
        blocks=[cells.blocks[k] for k in rows],
        left_out=[
            line for line in cells.left_out if labels[max(bisect_left(cells.lines, line) - 1, 0)] == name
        ],
    )
