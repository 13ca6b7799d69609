"""Tables of other instruments: which columns are time and position, in which units, and the rows that are
usable.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.ticks import seconds
from processing.units import conversion, size
from rig.analysis.tables import Cells, Named, known_unit, moments_ns, named_unit, read_cells
from rig.analysis.tables.numbers import is_moment
from rig.analysis.tables.times import number, placed, read_times, rising

TIME_UNITS = ("ns", "us", "ms", "s", "min", "h", "d")
_SORT = "sort the rows or name the time column with --time"
_NO_COMMAS = (
    "its commas seem to be decimal commas as well as separators, which cannot be told apart: save it with "
    "semicolons or tabs between the columns, or with decimal points"
)
NOT_STATED = "unit"
"""Stands for the unit of positions where none is stated."""
ANGLES = ("rad", "mrad", "urad", "nrad", "arcsec", "arcmin", "deg")
_LARGEST_RAD = 1.1 * math.pi
"""No pendulum swings further from its middle and comes back; a tenth for where the middle is taken to be."""
_TIME_NAME = re.compile(
    r"(?:t|time|zeit|temps|tiempo|tempo|elapsed|date.*|datum.*|timestamp|clock)(?:[\W_].*)?", re.I
)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Time in integer ns from the first sample, positions in the user's unit.

    `scale_rad` is the unit in rad, None where the unit is no angle (volts, px, mm): decay and
    period can then be had, contact parameters not. `time_unit` is that of the table's times,
    `time_name` their column, `first_ns` the first of them as it stands there. `understood` says in lines what
    the file was taken for, and which rows were left out. `u_common_in_noises` is the standard uncertainty of
    an error that all amplitudes share, as a multiple of the noise of one position.
    """

    times_ns: NDArray[np.int64]
    positions: tuple[NDArray[np.float64], ...]
    names: tuple[str, ...]
    unit: str
    scale_rad: float | None
    time_unit: str = "s"
    time_name: str = ""
    understood: tuple[str, ...] = ()
    first_ns: int = 0
    u_common_in_noises: float = 0.0


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Which columns of a table hold what, in which units, and which stretch of it is used.

    `time` and `positions` are columns by name or number from 1; None and empty: the first column that is
    named like a time, else the first, and the one behind it. `rate_hz`: the table has no time, but so many
    rows a second. `begin_s` and `end_s` are in seconds since the first row. `decimal` is the decimal mark,
    where the numbers leave that open.
    """

    time: str | None = None
    positions: tuple[str, ...] = ()
    unit: str = ""
    time_unit: str = ""
    rate_hz: float | None = None
    begin_s: float | None = None
    end_s: float | None = None
    decimal: str = ""

    def read(self, path: Path) -> Trajectory:
        """The table.

        Raises
        ------
        DataError
            No such file, no numbers, times that do not increase.
        ConfigurationError
            A column that there is not, a unit that is not known, or two that contradict one another.
        """
        return _Reading(path, self).trajectory()


class _Reading:
    """One reading of one table."""

    def __init__(self, path: Path, asked: TableColumns) -> None:
        self._path, self._asked = path, asked
        self._cells: Cells = read_cells(path, asked.decimal)
        width = len(self._cells.rows[0])
        self._names = list(self._cells.names) or [f"column {k + 1}" for k in range(width)]
        self._named = [self._unit_of(k) for k in range(width)]
        self._said: list[str] = []

    def trajectory(self) -> Trajectory:
        t_column = self._time_column()
        p_columns = self._position_columns(t_column)
        rows, asked = self._cells.rows, self._asked
        table = np.array([[number(row[k]) for k in p_columns] for row in rows], dtype=np.float64)
        if t_column is None:
            assert asked.rate_hz is not None
            times_ns = np.round(np.arange(len(rows)) * (1e9 / asked.rate_hz)).astype(np.int64)
            good, time_unit, first_ns = np.ones(len(rows), bool), "s", 0
            self._said.append(f"time: {asked.rate_hz:g} rows a second, as --rate says")
        else:
            times_ns, good, time_unit, first_ns = self._times(t_column)
        unit = self._position_unit(p_columns)
        table, lines = table[good], np.asarray(self._cells.lines)[good]
        inside = self._stretch(times_ns)
        times_ns, table = times_ns[inside], table[inside]
        self._left_out(good, lines[inside], table, [f"position {k + 1}" for k in range(len(p_columns))])
        self._judge_size(unit, table)
        return Trajectory(
            times_ns=times_ns,
            positions=tuple(table.T),
            names=tuple(self._names[k] for k in p_columns),
            unit=unit,
            scale_rad=conversion(unit, "rad") if unit in ANGLES else None,
            time_unit=time_unit,
            time_name="the rate" if t_column is None else self._names[t_column],
            understood=(self._how_written(), *self._said),
            first_ns=first_ns,
        )

    def columns(self) -> Trajectory:
        """Time and any number of columns, whatever their units; all but the time where none is named."""
        t_column = self._time_column()
        assert t_column is not None
        chosen = [self._column(name) for name in self._asked.positions] or [
            k for k in range(len(self._names)) if k != t_column
        ]
        times_ns, good, time_unit, first_ns = self._times(t_column)
        table = np.array([[number(row[k]) for k in chosen] for row in self._cells.rows], dtype=np.float64)
        table = table[good]
        empty: NDArray[np.bool_] = np.all(np.isnan(table), axis=0)
        if self._asked.positions and empty.any():
            name = self._names[chosen[int(np.argmax(empty))]]
            raise DataError(f"{self._path}: column {name!r} has no numbers; name another one")
        if empty.all():
            raise DataError(f"{self._path}: no column beside {self._names[t_column]!r} has numbers")
        names = [self._names[k] for k in chosen]
        kept = [name for name, none in zip(names, empty.tolist(), strict=True) if not none]
        self._said.append(f"columns: {', '.join(kept)}")
        if empty.any():
            without = ", ".join(name for name in names if name not in kept)
            self._said.append(f"left out: columns without numbers: {without}")
        table = table[:, ~empty]
        self._left_out(good, np.asarray(self._cells.lines)[good], table, kept)
        return Trajectory(
            times_ns=times_ns,
            positions=tuple(table.T),
            names=tuple(kept),
            unit=NOT_STATED,
            scale_rad=None,
            time_unit=time_unit,
            time_name=self._names[t_column],
            understood=(self._how_written(), *self._said),
            first_ns=first_ns,
        )

    def _unit_of(self, column: int) -> Named:
        named = named_unit(self._names[column]) if self._cells.names else Named(self._names[column], "")
        beside = self._cells.units[column]
        if not beside:
            return named
        unit = known_unit(beside)
        return Named(named.name, unit or named.unit, "" if unit or named.unit else beside)

    def _time_column(self) -> int | None:
        asked, width = self._asked, len(self._names)
        if asked.rate_hz is not None:
            if asked.time is not None or asked.time_unit:
                raise ConfigurationError(
                    "--rate is for a table without times; leave --time and --time-unit out"
                )
            return None
        if asked.time is not None:
            return self._column(asked.time)
        if width < 2:
            raise DataError(
                f"{self._path}: has one column; time and position are needed, or the rate of its rows: "
                "--rate HZ"
            )
        like_time = [
            k
            for k, named in enumerate(self._named)
            if (self._cells.names and (_TIME_NAME.fullmatch(named.name) or _is_time(named.unit)))
            or all(is_moment(row[k]) for row in self._cells.rows[:50])
        ]
        return like_time[0] if like_time else 0

    def _position_columns(self, t_column: int | None) -> list[int]:
        asked, width = self._asked, len(self._names)
        if len(asked.positions) > 2:
            raise ConfigurationError(
                f"--position was given {len(asked.positions)} times; one or two columns are used"
            )
        if asked.positions:
            return [self._column(name) for name in asked.positions]
        if t_column is None and width > 1:
            raise ConfigurationError(f"{self._path}: has {width} columns; name the position with --position")
        behind = 0 if t_column is None else t_column + 1
        return [behind if behind < width else 0]

    def _column(self, name: str) -> int:
        for among in (self._names if self._cells.names else [], [named.name for named in self._named]):
            if name in among:
                return list(among).index(name)
        width = len(self._names)
        if name.isdecimal() and 1 <= int(name) <= width:
            return int(name) - 1
        known = (
            ", ".join(self._names) if self._cells.names else f"1 to {width} (the table has no header line)"
        )
        raise ConfigurationError(f"{self._path}: has no column {name!r}; columns: {known}")

    def _times(self, column: int) -> tuple[NDArray[np.int64], NDArray[np.bool_], str, int]:
        cells = [row[column] for row in self._cells.rows]
        if sum(map(is_moment, cells[:50])) > 0.5 * len(cells[:50]):
            found = moments_ns(cells)
            good = np.array([one is not None for one in found])
            kept = [one for one in found if one is not None]
            times_ns = np.array([one - kept[0] for one in kept], dtype=np.int64)
            rising(self._path, times_ns, [cell for cell, yes in zip(cells, good, strict=True) if yes], _SORT)
            self._said.append(f"time: {self._names[column]}, moments")
            return times_ns, good, "s", kept[0]
        unit, source = self._time_unit(column)
        remedy = _SORT if not self._split_at_decimal_commas() else _NO_COMMAS
        times_ns, good, first_ns = read_times(self._path, cells, unit, remedy)
        self._said.append(f"time: {self._names[column]}, in {unit} ({source})")
        return times_ns, good, unit, first_ns

    def _time_unit(self, column: int) -> tuple[str, str]:
        """The unit of time, and who says so."""
        named, stated = self._named[column], self._asked.time_unit
        if stated and not _is_time(known_unit(stated)):
            raise ConfigurationError(
                f"--time-unit {stated!r} is no unit of time; take one of {', '.join(TIME_UNITS)}"
            )
        if named.unit and not _is_time(named.unit):
            raise ConfigurationError(
                f"{self._path}: {self._names[column]!r} is in {named.unit}, which is no unit of time; name "
                "the time column with --time, or state --rate"
            )
        stated = known_unit(stated)
        if stated and named.unit and stated != named.unit:
            raise ConfigurationError(
                f"{self._path}: {self._names[column]!r} says {named.unit}, --time-unit says {stated}; "
                "leave the option out, or correct the header"
            )
        if stated:
            return stated, "--time-unit"
        if named.strange:
            raise ConfigurationError(
                f"{self._path}: {named.strange!r} in {self._names[column]!r} is no unit of time that is "
                f"known here; state --time-unit, one of {', '.join(TIME_UNITS)}"
            )
        return (named.unit, "its header") if named.unit else ("s", "nothing states another")

    def _position_unit(self, columns: Sequence[int]) -> str:
        stated = known_unit(self._asked.unit) or self._asked.unit
        sources = []
        for k in columns:
            named = self._named[k]
            if named.strange and not stated:
                raise ConfigurationError(
                    f"{self._path}: {named.strange!r} in {self._names[k]!r} is no unit that is known here; "
                    f"state --unit, one of {', '.join(ANGLES)} or any word"
                )
            if named.unit and stated and not _same(named.unit, stated):
                raise ConfigurationError(
                    f"{self._path}: {self._names[k]!r} says {named.unit}, --unit says {stated}; leave the "
                    "option out, or correct the header"
                )
            sources.append(named.unit)
        if len(set(sources)) > 1:
            raise ConfigurationError(
                f"{self._path}: the positions are in {' and '.join(map(repr, sources))}; both need the "
                "same unit"
            )
        unit = stated or sources[0] or NOT_STATED
        source = "--unit" if stated else "its header" if sources[0] else "not stated"
        names = ", ".join(self._names[k] for k in columns)
        self._said.append(
            f"position: {names}" + (f", in {unit} ({source})" if unit != NOT_STATED else f" ({source})")
        )
        return unit

    def _stretch(self, times_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        asked = self._asked
        since_s = seconds(times_ns - times_ns[0])
        begin_s = since_s[0] if asked.begin_s is None else asked.begin_s
        end_s = since_s[-1] if asked.end_s is None else asked.end_s
        inside = (since_s >= begin_s) & (since_s <= end_s)
        if np.count_nonzero(inside) < 2:
            raise ConfigurationError(
                f"{self._path}: --from {begin_s:g} --to {end_s:g} leaves no rows; it goes from 0 to "
                f"{since_s[-1]:.6g} s"
            )
        steps_s = np.diff(since_s[inside])
        step_s = float(np.median(steps_s))
        even = float(steps_s.max()) < 1.5 * step_s
        self._said.append(
            f"stretch: {since_s[inside][0]:.6g} to {since_s[inside][-1]:.6g} s of 0 to {since_s[-1]:.6g} s, "
            f"{1 / step_s:.6g} rows a second" + ("" if even else ", unevenly")
        )
        return np.asarray(inside)

    def _left_out(
        self,
        good: NDArray[np.bool_],
        lines: NDArray[np.int64],
        table: NDArray[np.float64],
        names: Sequence[str],
    ) -> None:
        every = np.asarray(self._cells.lines)
        for what, which in (
            ("rows without the right number of columns", list(self._cells.left_out)),
            ("rows without a readable time", every[~good].tolist()),
        ):
            if which:
                self._said.append(f"left out: {len(which)} {what} ({placed(which)})")
        for name, values in zip(names, table.T, strict=True):
            if (missing := np.isnan(values)).any():
                self._said.append(
                    f"missing from the fit: {int(missing.sum())} values of {name} that are no "
                    f"numbers ({placed(lines[missing].tolist())})"
                )

    def _judge_size(self, unit: str, table: NDArray[np.float64]) -> None:
        """Refuse an angle that no pendulum swings by."""
        if unit not in ANGLES or not np.isfinite(table).any():
            return
        span = float(np.nanmax(table, axis=0).max() - np.nanmin(table, axis=0).min())
        each = float(np.max(np.nanmax(table, axis=0) - np.nanmin(table, axis=0)))
        if 0.5 * min(span, each) * conversion(unit, "rad") > _LARGEST_RAD:
            raise ConfigurationError(
                f"{self._path}: the position goes over {each:.4g} {unit}, more than a turn: is that its "
                "unit? State another with --unit, or use a stretch (--from, --to)"
            )

    def _how_written(self) -> str:
        cells = self._cells
        separated = (
            f"columns separated by {cells.separator}" if cells.separator else f"{len(self._names)} columns"
        )
        mark = {".": "points", ",": "commas"}[cells.writing.decimal]
        names = f"names: {', '.join(self._names)}" if cells.names else "no names"
        return f"{separated}, decimal {mark}; {names}"

    def _split_at_decimal_commas(self) -> bool:
        """Whether the table is likely one whose numbers were split at their decimal commas.

        Then it has two columns for each name, so that no header fits, and nowhere a decimal point.
        """
        rows = self._cells.rows
        return (
            self._cells.separator == "commas"
            and not self._cells.names
            and len(rows[0]) >= 4
            and not any("." in cell for row in rows[:50] for cell in row)
        )


def _is_time(unit: str) -> bool:
    return bool(unit) and dict(size(unit).powers) == dict(size("s").powers)


def _same(unit: str, other: str) -> bool:
    try:
        return size(unit) == size(other)
    except ConfigurationError:
        return unit == other


def read_trajectory(
    path: Path, time: str | None, positions: list[str], unit: str, time_unit: str = ""
) -> Trajectory:
    """Read a table; see `TableColumns`."""
    return TableColumns(time, tuple(positions), unit, time_unit).read(path)


def read_columns(path: Path, time: str | None, columns: list[str]) -> Trajectory:
    """Time and any number of columns of a table, all but the time without names; see `TableColumns`."""
    return _Reading(path, TableColumns(time, tuple(columns))).columns()
