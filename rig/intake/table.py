"""Tables of other instruments: time and positions in their units, and the rows that are usable."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import is_moment, moments_ns
from rig.intake.cells import Cells, read_cells
from rig.intake.columns import HeaderColumns, RowsOfRun, runs_of
from rig.intake.doubts import (
    SPREADSHEET_ZERO_NS,
    is_spreadsheet_time,
    judge_begin,
    judge_clock_digits,
    judge_size,
    judge_time_unit,
    judge_words,
    judge_zones,
    unwrapped,
)
from rig.intake.times import M_SS, SORT, clock_form, number, placed, read_times, rising
from rig.intake.trajectory import ANGLES, NOT_STATED, Trajectory
from rig.intake.units import NOT_STATED_TIME, unit_of_positions, unit_of_time

_NO_COMMAS: Final = (
    "its commas seem to be decimal commas as well as separators, which cannot be told apart: save it with "
    "semicolons or tabs between the columns, or with decimal points"
)


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Which columns of a table hold what, in which units, and which stretch of it is used.

    `time` and `positions` are columns by name or number from 1; None and empty: the first column that is
    named like a time, else the first, and the one behind it. `rate_hz`: the table has no time, but so many
    rows a second. `begin_s` and `end_s` are in seconds since the first row. `decimal` is the decimal mark,
    where the numbers leave that open. `run` is one of several runs in the file; empty: all.
    """

    time: str | None = None
    positions: tuple[str, ...] = ()
    unit: str = ""
    time_unit: str = ""
    rate_hz: float | None = None
    begin_s: float | None = None
    end_s: float | None = None
    decimal: str = ""
    run: str = ""

    def read(self, path: Path) -> Trajectory:
        """The table, or the one run that is asked for.

        Raises
        ------
        DataError
            No such file, no numbers, times that do not increase.
        ConfigurationError
            A column that there is not, a unit that is not known, or two that contradict one another; several
            runs of which none is chosen.
        """
        cells, chosen, every = self._runs(path)
        if len(chosen) > 1:
            raise ConfigurationError(f"{path}: {_listed(every)}; choose one with --run")
        return self._trajectory(path, cells, chosen[0], every)

    def read_runs(self, path: Path) -> list[Trajectory]:
        """Each run of the table, of which `run` may choose one; raises as `read` does."""
        cells, chosen, every = self._runs(path)
        return [self._trajectory(path, cells, run, every) for run in chosen]

    def _runs(self, path: Path) -> tuple[Cells, list[RowsOfRun], list[RowsOfRun]]:
        """The whole table, the runs that are asked for, and all of them."""
        cells = read_cells(path, self.decimal)
        columns = HeaderColumns(path, cells)
        every = runs_of(cells, columns, columns.time(self.time, self.rate_hz, self.time_unit))
        chosen = [run for run in every if self.run in ("", run.name)]
        if not chosen:
            known = _listed(every) if len(every) > 1 else "holds one run; leave the option out"
            raise ConfigurationError(f"{path}: --run {self.run}: is not there; {known}")
        return cells, chosen, every

    def _trajectory(self, path: Path, whole: Cells, run: RowsOfRun, every: list[RowsOfRun]) -> Trajectory:
        said = [f"{_listed(every)}; this is {run.name}"] if len(every) > 1 else []
        without = len(whole.rows) - sum(len(one.cells.rows) for one in every)
        said += [f"left out: {without} rows that are of no run"] if without else []
        return _Reading(path, self, run, said).trajectory()


def _listed(runs: Sequence[RowsOfRun]) -> str:
    named = ", ".join(f"{run.name} ({len(run.cells.rows)} rows)" for run in runs)
    return f"{len(runs)} runs, told apart by {runs[0].told_by}: {named}"


class _Reading:
    """One reading of one run of a table."""

    def __init__(self, path: Path, asked: TableColumns, run: RowsOfRun, said: Sequence[str] = ()) -> None:
        self._path, self._asked, self._run = path, asked, run.name
        self._cells: Cells = run.cells
        self._columns = HeaderColumns(path, run.cells)
        self._names = self._columns.names
        self._said: list[str] = [*run.cells.said, *said]
        self._time_is_assumed = False

    def trajectory(self) -> Trajectory:
        rows, asked = self._cells.rows, self._asked
        t_column = self._columns.time(asked.time, asked.rate_hz, asked.time_unit)
        p_columns = self._columns.positions(asked.positions, t_column)
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
        for k in p_columns:
            judge_words(self._path, self._names[k], [row[k] for row in rows], self._cells.lines)
        if (empty := np.all(np.isnan(table), axis=0)).any():
            raise self._without_numbers(p_columns[int(np.argmax(empty))])
        for place, k in enumerate(p_columns):
            table[:, place], turns = unwrapped(
                self._path, self._names[k], unit, table[:, place], lines[inside]
            )
            if turns:
                self._said.append(f"position: {self._names[k]} jumps by a turn {turns} times: unwrapped")
        judge_size(self._path, unit, table)
        names = [self._names[k] for k in p_columns]
        return self._made(t_column, times_ns, time_unit, first_ns, table, names, unit)

    def columns(self) -> Trajectory:
        """Time and any number of columns, whatever their units; all but the time where none is named."""
        t_column = self._columns.time(self._asked.time, None, self._asked.time_unit)
        assert t_column is not None
        chosen = [self._columns.place(name) for name in self._asked.positions] or [
            k for k in range(len(self._names)) if k != t_column
        ]
        times_ns, good, time_unit, first_ns = self._times(t_column)
        table = np.array([[number(row[k]) for k in chosen] for row in self._cells.rows], dtype=np.float64)
        table = table[good]
        empty: NDArray[np.bool_] = np.all(np.isnan(table), axis=0)
        if self._asked.positions and empty.any():
            raise self._without_numbers(chosen[int(np.argmax(empty))])
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
        return self._made(t_column, times_ns, time_unit, first_ns, table, kept, NOT_STATED)

    def _made(
        self,
        t_column: int | None,
        times_ns: NDArray[np.int64],
        time_unit: str,
        first_ns: int,
        table: NDArray[np.float64],
        names: Sequence[str],
        unit: str,
    ) -> Trajectory:
        return Trajectory(
            times_ns=times_ns,
            positions=tuple(table.T),
            names=tuple(names),
            unit=unit,
            scale_rad=conversion(unit, "rad") if unit in ANGLES else None,
            time_unit=time_unit,
            time_name="the rate" if t_column is None else self._names[t_column],
            time_is_assumed=self._time_is_assumed,
            understood=(self._how_written(), *self._said),
            first_ns=first_ns,
            run=self._run,
        )

    def _times(self, column: int) -> tuple[NDArray[np.int64], NDArray[np.bool_], str, int]:
        cells = [row[column] for row in self._cells.rows]
        if sum(map(is_moment, cells[:50])) > 0.5 * len(cells[:50]):
            form, source = clock_form(
                self._path, self._names[column], self._columns.named[column], self._asked.time_unit, cells
            )
            found = moments_ns(cells, minutes_first=form == M_SS)
            good = np.array([one is not None for one in found])
            kept = [one for one in found if one is not None]
            times_ns = np.array([one - kept[0] for one in kept], dtype=np.int64)
            read = [cell for cell, yes in zip(cells, good, strict=True) if yes]
            rising(self._path, times_ns, read, SORT)
            judge_zones(self._path, read, times_ns)
            self._said.append(
                f"time: {self._names[column]}, " + (f"as {form} ({source})" if form else "moments")
            )
            return times_ns, good, "s", kept[0]
        named = self._columns.named[column]
        unit, source = unit_of_time(self._path, self._names[column], named, self._asked.time_unit)
        remedy = SORT if not self._split_at_decimal_commas() else _NO_COMMAS
        times_ns, good, first_ns = read_times(self._path, cells, unit, remedy)
        self._time_is_assumed = source == NOT_STATED_TIME
        judge_begin(self._path, self._names[column], unit, source, first_ns, times_ns)
        if unit == "s":
            judge_clock_digits(self._path, self._names[column], seconds(times_ns + first_ns))
        self._said.append(f"time: {self._names[column]}, in {unit} ({source})")
        if unit == "d" and is_spreadsheet_time(first_ns):
            first_ns -= SPREADSHEET_ZERO_NS
            self._said.append("time: days since 1899-12-30, as spreadsheets count")
        return times_ns, good, unit, first_ns

    def _position_unit(self, columns: Sequence[int]) -> str:
        titles, named = [self._names[k] for k in columns], [self._columns.named[k] for k in columns]
        unit, source = unit_of_positions(self._path, titles, named, self._asked.unit)
        self._said.append(
            f"position: {', '.join(titles)}"
            + (f", in {unit} ({source})" if unit != NOT_STATED else f" ({source})")
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
            f"{1 / step_s:.6g} rows a second"
            + ("" if even else f", unevenly, up to {steps_s.max():.6g} s apart")
        )
        return np.asarray(inside)

    def _without_numbers(self, column: int) -> DataError:
        name = self._names[column]
        return DataError(f"{self._path}: column {name!r} has no numbers; name another one")

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
                    f"missing from the fit: {int(missing.sum())} values of {name} that are not "
                    f"numbers ({placed(lines[missing].tolist())})"
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


def read_columns(path: Path, columns: Sequence[str], time_unit: str = "") -> Trajectory:
    """Time and any number of columns of a table, all but the time without names; see `TableColumns`."""
    asked = TableColumns(None, tuple(columns), time_unit=time_unit)
    found = _Reading(path, asked, RowsOfRun("", read_cells(path))).columns()
    judge_time_unit(path, found)
    return found
