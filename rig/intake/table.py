"""Tables of other instruments: time and positions with their units, from the usable rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import is_timestamp
from rig.intake.cells import Cells, read_cells
from rig.intake.columns import HeaderColumns, RowsOfRun, separate_runs
from rig.intake.doubts import (
    judge_clock,
    judge_moments,
    judge_size,
    judge_time_unit,
    judge_words,
    unwrapped,
)
from rig.intake.times import lines_text, number, read_times
from rig.intake.trajectory import ANGLES, NOT_STATED, Trajectory
from rig.intake.units import NOT_STATED_TIME, unit_of_positions, unit_of_time


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Options for reading a table: columns, units, stretch and run.

    `time` and `positions` are columns by name or number from 1; by default time is the first column with a
    name like a time, else the first column, and the position follows it. `rate_hz` is the number of rows a
    second of a table without times. `begin_s` and `end_s` are in seconds since the first row. `run` is one of
    several runs in the file; empty: all.
    """

    time: str | None = None
    positions: tuple[str, ...] = ()
    unit: str = ""
    time_unit: str = ""
    rate_hz: float | None = None
    begin_s: float | None = None
    end_s: float | None = None
    run: str = ""

    def read(self, path: Path) -> Trajectory:
        """Read the table, or the chosen run of it.

        Raises
        ------
        DataError
            The file does not exist, has no numbers, or times do not increase.
        ConfigurationError
            A column does not exist, a unit is unknown, two units contradict, or none of several runs is
            chosen.
        """
        cells, chosen, all_runs = self._runs(path)
        if len(chosen) > 1:
            raise ConfigurationError(f"{path}: {_list_text(all_runs)}; choose one with --run")
        return self._trajectory(path, cells, chosen[0], all_runs)

    def read_runs(self, path: Path) -> list[Trajectory]:
        """Read each run of the table, or only `run`; raises like `read`."""
        cells, chosen, all_runs = self._runs(path)
        return [self._trajectory(path, cells, run, all_runs) for run in chosen]

    def _runs(self, path: Path) -> tuple[Cells, list[RowsOfRun], list[RowsOfRun]]:
        """The whole table, the chosen runs, and all runs."""
        cells = read_cells(path)
        columns = HeaderColumns(path, cells)
        all_runs = separate_runs(cells, columns, columns.time(self.time, self.rate_hz, self.time_unit))
        chosen = [run for run in all_runs if self.run in ("", run.name)]
        if not chosen:
            known = _list_text(all_runs) if len(all_runs) > 1 else "holds one run; leave the option out"
            raise ConfigurationError(f"{path}: --run {self.run}: is not there; {known}")
        return cells, chosen, all_runs

    def _trajectory(self, path: Path, whole: Cells, run: RowsOfRun, all_runs: list[RowsOfRun]) -> Trajectory:
        remarks = [f"{_list_text(all_runs)}; this is {run.name}"] if len(all_runs) > 1 else []
        without = len(whole.rows) - sum(len(one.cells.rows) for one in all_runs)
        remarks += [f"left out: {without} rows that are of no run"] if without else []
        return _TableReader(path, self, run, remarks).trajectory()


def _list_text(runs: Sequence[RowsOfRun]) -> str:
    named = ", ".join(f"{run.name} ({len(run.cells.rows)} rows)" for run in runs)
    return f"{len(runs)} runs, told apart by {runs[0].separator}: {named}"


class _TableReader:
    """Reads one run of a table."""

    def __init__(
        self, path: Path, options: TableColumns, run: RowsOfRun, remarks: Sequence[str] = ()
    ) -> None:
        self._path, self._options, self._run = path, options, run.name
        self._cells: Cells = run.cells
        self._columns = HeaderColumns(path, run.cells)
        self._names = self._columns.names
        self._remarks: list[str] = [*run.cells.remarks, *remarks]
        self._time_is_assumed = False

    def trajectory(self) -> Trajectory:
        rows, options = self._cells.rows, self._options
        t_column = self._columns.time(options.time, options.rate_hz, options.time_unit)
        p_columns = self._columns.positions(options.positions, t_column)
        table = np.array([[number(row[k]) for k in p_columns] for row in rows], dtype=np.float64)
        if t_column is None:
            assert options.rate_hz is not None
            times_ns = np.round(np.arange(len(rows)) * (1e9 / options.rate_hz)).astype(np.int64)
            good, time_unit, first_ns = np.ones(len(rows), bool), "s", 0
            self._remarks.append(f"time: {options.rate_hz:g} rows a second, as --rate says")
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
                self._remarks.append(f"position: {self._names[k]} jumps by a turn {turns} times: unwrapped")
        judge_size(self._path, unit, table)
        names = [self._names[k] for k in p_columns]
        return self._trajectory_of_columns(t_column, times_ns, time_unit, first_ns, table, names, unit)

    def columns(self) -> Trajectory:
        """Time and any number of columns in any units; all columns but the time if none is named."""
        t_column = self._columns.time(self._options.time, None, self._options.time_unit)
        assert t_column is not None
        chosen = [self._columns.place(name) for name in self._options.positions] or [
            k for k in range(len(self._names)) if k != t_column
        ]
        times_ns, good, time_unit, first_ns = self._times(t_column)
        table = np.array([[number(row[k]) for k in chosen] for row in self._cells.rows], dtype=np.float64)
        table = table[good]
        empty: NDArray[np.bool_] = np.all(np.isnan(table), axis=0)
        if self._options.positions and empty.any():
            raise self._without_numbers(chosen[int(np.argmax(empty))])
        if empty.all():
            raise DataError(f"{self._path}: no column beside {self._names[t_column]!r} has numbers")
        names = [self._names[k] for k in chosen]
        kept = [name for name, none in zip(names, empty.tolist(), strict=True) if not none]
        self._remarks.append(f"columns: {', '.join(kept)}")
        if empty.any():
            without = ", ".join(name for name in names if name not in kept)
            self._remarks.append(f"left out: columns without numbers: {without}")
        table = table[:, ~empty]
        self._left_out(good, np.asarray(self._cells.lines)[good], table, kept)
        return self._trajectory_of_columns(t_column, times_ns, time_unit, first_ns, table, kept, NOT_STATED)

    def _trajectory_of_columns(
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
            understood=(self._cells.written, *self._remarks),
            first_ns=first_ns,
            run=self._run,
        )

    def _times(self, column: int) -> tuple[NDArray[np.int64], NDArray[np.bool_], str, int]:
        cells = [row[column] for row in self._cells.rows]
        name, option = self._names[column], self._options.time_unit
        if sum(map(is_timestamp, cells[:50])) > 0.5 * len(cells[:50]):
            if option:
                raise ConfigurationError(
                    f"{self._path}: {name!r} has times like {cells[0]!r}, which --time-unit {option} does "
                    "not fit; leave the option out"
                )
            self._remarks.append(f"time: {name}, moments")
            times_ns, good, first_ns = read_times(self._path, cells, None)
            judge_moments(
                self._path, [cell for cell, kept in zip(cells, good, strict=True) if kept], times_ns
            )
            return times_ns, good, "s", first_ns
        unit, source = unit_of_time(self._path, name, self._columns.named[column], option)
        times_ns, good, first_ns = read_times(self._path, cells, unit)
        self._time_is_assumed = source == NOT_STATED_TIME
        judge_clock(self._path, name, unit, first_ns, times_ns)
        self._remarks.append(f"time: {name}, in {unit} ({source})")
        return times_ns, good, unit, first_ns

    def _position_unit(self, columns: Sequence[int]) -> str:
        titles, named = [self._names[k] for k in columns], [self._columns.named[k] for k in columns]
        unit, source = unit_of_positions(self._path, titles, named, self._options.unit)
        self._remarks.append(
            f"position: {', '.join(titles)}"
            + (f", in {unit} ({source})" if unit != NOT_STATED else f" ({source})")
        )
        return unit

    def _stretch(self, times_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        options = self._options
        since_s = seconds(times_ns - times_ns[0])
        begin_s = since_s[0] if options.begin_s is None else options.begin_s
        end_s = since_s[-1] if options.end_s is None else options.end_s
        inside = (since_s >= begin_s) & (since_s <= end_s)
        if np.count_nonzero(inside) < 2:
            raise ConfigurationError(
                f"{self._path}: --from {begin_s:g} --to {end_s:g} leaves no rows; it goes from 0 to "
                f"{since_s[-1]:.6g} s"
            )
        steps_s = np.diff(since_s[inside])
        step_s = float(np.median(steps_s))
        even = float(steps_s.max()) < 1.5 * step_s
        self._remarks.append(
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
        all_runs = np.asarray(self._cells.lines)
        for what, which in (
            ("rows without the right number of columns", list(self._cells.left_out)),
            ("rows without a readable time", all_runs[~good].tolist()),
        ):
            if which:
                self._remarks.append(f"left out: {len(which)} {what} ({lines_text(which)})")
        for name, values in zip(names, table.T, strict=True):
            if (missing := np.isnan(values)).any():
                self._remarks.append(
                    f"missing from the fit: {int(missing.sum())} values of {name} that are not "
                    f"numbers ({lines_text(lines[missing].tolist())})"
                )


def read_columns(path: Path, columns: Sequence[str]) -> Trajectory:
    """Read time and any number of columns of a table; all but the time if none is named."""
    found = _TableReader(path, TableColumns(None, tuple(columns)), RowsOfRun("", read_cells(path))).columns()
    judge_time_unit(path, found)
    return found
