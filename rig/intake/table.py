"""Tables of other instruments: time and positions with their units, from the usable rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from processing.arrays import Flags, Floats, Ints
from processing.errors import ConfigurationError, DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import is_timestamp
from rig.intake.cells import Cells, read_cells
from rig.intake.columns import HeaderColumns, RowsOfRun, separate_runs
from rig.intake.doubts import judge_clock, judge_moments, judge_size, judge_time_unit, judge_words, unwrapped
from rig.intake.times import lines_text, number, read_times
from rig.intake.trajectory import ANGLE_UNITS, UNSTATED_UNIT, Trajectory
from rig.intake.units import ASSUMED_SECONDS, unit_of_positions, unit_of_time


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Options for reading a table: columns, units, stretch and run."""

    time: str | None = None
    """The column of times, by name or number from 1; None: the first named like a time, else the first."""
    positions: tuple[str, ...] = ()
    """The columns of one or two positions; empty: the column that follows the time."""
    unit: str = ""
    """Unit of the positions; empty: the one in the header."""
    time_unit: str = ""
    """Unit of the times; empty: the one in the header, else s."""
    rate_hz: float | None = None
    """Rows a second of a table without times."""
    begin_s: float | None = None
    """Begin of the stretch that is used, in s since the first row; None: the first row."""
    end_s: float | None = None
    """End of that stretch, in s since the first row; None: the last row."""
    run: str = ""
    """Name of one of several runs in the file; empty: all."""

    def read(self, path: Path) -> Trajectory:
        """Read the table, or the chosen run of it.

        Raises DataError if the file does not exist, has no numbers, or times do not increase, and
        ConfigurationError for an unknown column, unit or run, contradicting units, or several runs.
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
        count = len(whole.rows) - sum(len(run.cells.rows) for run in all_runs)
        remarks += [f"left out: {count} rows that are of no run"] if count else []
        return _TableReader(path, self, run, remarks).trajectory()


def _list_text(runs: Sequence[RowsOfRun]) -> str:
    listed = ", ".join(f"{run.name} ({len(run.cells.rows)} rows)" for run in runs)
    return f"{len(runs)} runs, told apart by {runs[0].separator}: {listed}"


class _TableReader:
    """Reads one run of a table, and collects remarks on how it is read."""

    def __init__(
        self, path: Path, options: TableColumns, run: RowsOfRun, remarks: Sequence[str] = ()
    ) -> None:
        self._path, self._options, self._run = path, options, run.name
        self._cells: Cells = run.cells
        self._columns = HeaderColumns(path, run.cells)
        self._names = self._columns.names
        self._remarks: list[str] = [*run.cells.remarks, *remarks]
        self._time_name, self._time_unit, self._first_ns, self._time_is_assumed = "the rate", "s", 0, False

    def trajectory(self) -> Trajectory:
        """One or two positions in one unit, in the stretch of the options."""
        options = self._options
        t_column = self._columns.time(options.time, options.rate_hz, options.time_unit)
        columns = self._columns.positions(options.positions, t_column)
        names = [self._names[k] for k in columns]
        times_ns, good = self._times(t_column)
        unit = self._position_unit(columns)
        inside = self._stretch(times_ns)
        values = self._numbers(columns)[good][inside]
        lines = np.asarray(self._cells.lines)[good][inside]
        self._note_missing(good, lines, values, [f"position {k + 1}" for k in range(len(columns))])
        for k, name in zip(columns, names, strict=True):
            judge_words(self._path, name, [row[k] for row in self._cells.rows], self._cells.lines)
        if (empty := np.all(np.isnan(values), axis=0)).any():
            raise self._without_numbers(names[int(np.argmax(empty))])
        for k, name in enumerate(names):
            values[:, k], jumps = unwrapped(self._path, name, unit, values[:, k], lines)
            if jumps:
                self._remarks.append(f"position: {name} jumps by a turn {jumps} times: unwrapped")
        judge_size(self._path, unit, values)
        return self._trajectory(times_ns[inside], values, names, unit)

    def columns(self) -> Trajectory:
        """Time and any number of columns in any units; all columns but the time if none is named."""
        t_column = self._columns.time(self._options.time, None, self._options.time_unit)
        columns = [self._columns.place(name) for name in self._options.positions] or [
            k for k in range(len(self._names)) if k != t_column
        ]
        times_ns, good = self._times(t_column)
        values = self._numbers(columns)[good]
        empty: Flags = np.all(np.isnan(values), axis=0)
        if self._options.positions and empty.any():
            raise self._without_numbers(self._names[columns[int(np.argmax(empty))]])
        if empty.all():
            raise DataError(f"{self._path}: no column beside {self._time_name!r} has numbers")
        names = [self._names[k] for k, is_empty in zip(columns, empty, strict=True) if not is_empty]
        self._remarks.append(f"columns: {', '.join(names)}")
        if empty.any():
            without = ", ".join(self._names[k] for k in columns if self._names[k] not in names)
            self._remarks.append(f"left out: columns without numbers: {without}")
        values = values[:, ~empty]
        self._note_missing(good, np.asarray(self._cells.lines)[good], values, names)
        return self._trajectory(times_ns, values, names, UNSTATED_UNIT)

    def _trajectory(self, times_ns: Ints, values: Floats, names: Sequence[str], unit: str) -> Trajectory:
        return Trajectory(
            times_ns=times_ns,
            positions=tuple(values.T),
            names=tuple(names),
            unit=unit,
            scale_rad=conversion(unit, "rad") if unit in ANGLE_UNITS else None,
            time_unit=self._time_unit,
            time_name=self._time_name,
            time_is_assumed=self._time_is_assumed,
            understood=(self._cells.written, *self._remarks),
            first_ns=self._first_ns,
            run=self._run,
        )

    def _numbers(self, columns: Sequence[int]) -> Floats:
        rows = [[number(row[k]) for k in columns] for row in self._cells.rows]
        return np.array(rows, dtype=np.float64)

    def _times(self, column: int | None) -> tuple[Ints, Flags]:
        """Times in ns since the first, and the rows that have one; without a column they are by the rate."""
        options, rows = self._options, self._cells.rows
        if column is None:
            assert options.rate_hz is not None
            self._remarks.append(f"time: {options.rate_hz:g} rows a second, as --rate says")
            times_ns = np.round(np.arange(len(rows)) * (1e9 / options.rate_hz)).astype(np.int64)
            return times_ns, np.ones(len(rows), bool)
        cells, name, option = [row[column] for row in rows], self._names[column], options.time_unit
        self._time_name = name
        if sum(map(is_timestamp, cells[:50])) > 0.5 * len(cells[:50]):
            if option:
                raise ConfigurationError(
                    f"{self._path}: {name!r} has times like {cells[0]!r}, which --time-unit {option} does "
                    "not fit; leave the option out"
                )
            self._remarks.append(f"time: {name}, moments")
            times_ns, good, self._first_ns = read_times(self._path, cells, self._cells.lines, None)
            judge_moments(self._path, [cells[k] for k in np.flatnonzero(good)], times_ns)
            return times_ns, good
        unit, source = unit_of_time(self._path, name, self._columns.named[column], option)
        times_ns, good, self._first_ns = read_times(self._path, cells, self._cells.lines, unit)
        self._time_unit, self._time_is_assumed = unit, source == ASSUMED_SECONDS
        judge_clock(self._path, name, unit, self._first_ns, times_ns)
        self._remarks.append(f"time: {name}, in {unit} ({source})")
        return times_ns, good

    def _position_unit(self, columns: Sequence[int]) -> str:
        titles, named = [self._names[k] for k in columns], [self._columns.named[k] for k in columns]
        unit, source = unit_of_positions(self._path, titles, named, self._options.unit)
        in_unit = f", in {unit}" if unit != UNSTATED_UNIT else ""
        self._remarks.append(f"position: {', '.join(titles)}{in_unit} ({source})")
        return unit

    def _stretch(self, times_ns: Ints) -> Flags:
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
        step_s, longest_s = float(np.median(steps_s)), float(steps_s.max())
        uneven = "" if longest_s < 1.5 * step_s else f", unevenly, up to {longest_s:.6g} s apart"
        self._remarks.append(
            f"stretch: {since_s[inside][0]:.6g} to {since_s[inside][-1]:.6g} s of 0 to {since_s[-1]:.6g} s, "
            f"{1 / step_s:.6g} rows a second{uneven}"
        )
        return np.asarray(inside)

    def _without_numbers(self, name: str) -> DataError:
        return DataError(f"{self._path}: column {name!r} has no numbers; name another one")

    def _note_missing(self, good: Flags, lines: Ints, values: Floats, names: Sequence[str]) -> None:
        """Add remarks on rows that were left out, and on values that are no numbers."""
        for fault, faulty_lines in (
            ("rows without the right number of columns", list(self._cells.left_out)),
            ("rows without a readable time", np.asarray(self._cells.lines)[~good].tolist()),
        ):
            if faulty_lines:
                self._remarks.append(f"left out: {len(faulty_lines)} {fault} ({lines_text(faulty_lines)})")
        for name, column in zip(names, values.T, strict=True):
            if (missing := np.isnan(column)).any():
                self._remarks.append(
                    f"missing from the fit: {int(missing.sum())} values of {name} that are not "
                    f"numbers ({lines_text(lines[missing].tolist())})"
                )


def read_columns(path: Path, columns: Sequence[str]) -> Trajectory:
    """Read time and any number of columns of a table; all but the time if none is named."""
    run = RowsOfRun("", read_cells(path))
    trajectory = _TableReader(path, TableColumns(None, tuple(columns)), run).columns()
    judge_time_unit(path, trajectory)
    return trajectory
