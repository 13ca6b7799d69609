"""Which columns of a table hold time, positions, and the number of the run."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from processing.errors import ConfigurationError, DataError
from rig.analysis.tables.cells import Cells
from rig.analysis.tables.header_units import TIME_NAME, Named, is_time, known_unit, named_unit
from rig.analysis.tables.numbers import counts_rows, is_moment
from rig.analysis.tables.times import number

_RUN_NAME: Final = re.compile(
    r"(?:run|trial|lauf|versuch|messung|messreihe|serie|series|experiment|essai|repeat|repetition|"
    r"wiederholung|sweep)(?:[\W_]*(?:no|nr|num|number|nummer|id|index))?\W*",
    re.I,
)
_LOOKED_AT: Final = 50
_OTHER_DIRECTION: Final = re.compile(r"(?<![^\W_])[xyXY](?![^\W_])")
_DIRECTIONS: Final = {"x": "y", "y": "x", "X": "Y", "Y": "X"}
_MOST_ROWS: Final = 0.95
"""Of a second direction, that have to be numbers."""


class Columns:
    """The columns of a table, as its header names them or by number, and the unit that each states."""

    def __init__(self, path: Path, cells: Cells) -> None:
        self._path, self._cells = path, cells
        self.width: Final = len(cells.rows[0])
        names = cells.names or [""] * self.width
        self.names: Final = [name or f"column {k}" for k, name in enumerate(names, 1)]
        self.named: Final = [self._unit_of(k) for k in range(self.width)]

    def time(self, asked: str | None, rate_hz: float | None, time_unit: str = "") -> int | None:
        """The column of times; None where a rate stands for them."""
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
            or all(is_moment(row[k]) for row in self._cells.rows[:_LOOKED_AT])
        ]
        # a date alone is the same in all rows
        first = self._cells.rows[:_LOOKED_AT]
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
            # neither numbers of the rows nor other times are a position
            left = [k for k in others if not is_time(self.named[k].unit)]
            others = [k for k in left if not counts_rows([row[k] for row in self._cells.rows])] or others
        behind = [k for k in others if t_column is None or k > t_column]
        first = [*behind, *others, 0][0]
        second = self._beside(first, others)
        return [first] if second is None else [first, second]

    def _beside(self, column: int, others: Sequence[int]) -> int | None:
        """The column of the other direction, named and measured as this one is: y beside x; None: there is
        none, or it has few numbers.
        """
        if not self._cells.names:
            return None
        here = self.named[column]
        other = _OTHER_DIRECTION.sub(lambda found: _DIRECTIONS[found[0]], here.name)
        for k in others:
            if k == column or self.named[k] != here._replace(name=other) or other == here.name:
                continue
            cells = [row[k] for row in self._cells.rows]
            if sum(math.isfinite(number(cell)) for cell in cells) >= _MOST_ROWS * len(cells):
                return k
        return None

    def run(self) -> int | None:
        """The column that says which run a row is of, where one is named so."""
        found = [k for k, named in enumerate(self.named) if _RUN_NAME.fullmatch(named.name.strip())]
        return found[0] if self._cells.names and found else None

    def place(self, name: str) -> int:
        """The column of a name or number. Raises ConfigurationError where there is none."""
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

    def _unit_of(self, column: int) -> Named:
        named = named_unit(self.names[column]) if self._cells.names else Named(self.names[column], "")
        beside = self._cells.units[column]
        if not beside:
            return named
        unit = known_unit(beside)
        return Named(named.name, unit or named.unit, "" if unit or named.unit else beside)
