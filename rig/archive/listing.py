"""The archive's file, and queries of its runs: listed, shown, or found by words."""

import contextlib
import csv
import datetime
import io
import json
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any, Final

from acquisition import atomic_write
from processing.errors import ConfigurationError, RecordError, optional_module
from processing.estimate import Determinacy
from rig.analysis import ResultRow
from rig.archive.session_rows import COLUMNS, IMPORTANT, IS_SIMULATED, SHORT_NAMES, SHOWN, row_columns
from rig.terminal import (
    NOT_KNOWN,
    Table,
    harmless_text,
    plain,
    print_json_line,
    print_tables,
    screen_width,
    translated_file_errors,
    with_uncertainty,
)

_TABLES_SQL: Final = f"""
create table if not exists folders (folder varchar primary key);
create table if not exists sessions (folder varchar, files varchar);
create table if not exists every_run ({", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())});
create or replace view runs as
  select *, {", ".join(f"{name} as {short}" for short, name in SHORT_NAMES.items())}
  from every_run
  qualify row_number() over (partition by sha256 order by added_utc desc, folder) = 1;
"""
"""`sessions` holds a hash of names, sizes and times of the files of each folder as it was read; `runs` lists
a run that lies in several folders once."""
_INSERT_SQL: Final = f"""
insert into every_run by name
  select unnest(row) from (select unnest(from_json(?::json, '{json.dumps([COLUMNS])}')) as row)
"""
_NUMBER: Final = "coalesce(try_cast(regexp_extract(run, '[0-9]+$') as bigint), 0)"
_BY_TIME: Final = f"""
order by max(began_utc) over (partition by folder order by {_NUMBER}, run) nulls last, folder, {_NUMBER}, run
"""
"""Runs as they were measured; those of one session by number, even if the clock was set back."""
_READ_ONLY_SETTINGS: Final = {
    "enable_external_access": "false",
    "lock_configuration": "true",
    "autoinstall_known_extensions": "false",
    "python_enable_replacements": "false",
}
"""Settings with which a condition can read only the archive: no file, no variable of this program."""
_DUCKDB: Final = ("duckdb", "rig archive", "duckdb", "data")
_MAX_WAIT_S = 20.0
"""Longest wait for another process that writes; a transaction takes a fraction of a second."""


@contextlib.contextmanager
def reading(archive: Path) -> Iterator[Any]:
    """A connection that reads the archive.

    Raises ConfigurationError if there is no archive, or for a condition with an invalid value, found when
    rows are fetched; RecordError for a file that cannot be read.
    """
    check_is_there(archive)
    with _connection(archive, read_only=True) as connection:
        if _is_of_another_version(connection):
            raise RecordError(f"{archive}: another version made it; rig archive update makes it again")
        yield connection


@contextlib.contextmanager
def writing(archive: Path) -> Iterator[Any]:
    """A connection in one transaction, which is committed when the block ends without an error.

    The archive is made where it is missing: under another name first, since one that is opened while DuckDB
    writes its first bytes counts as damaged.
    """
    if not os.path.lexists(archive):
        if not os.access(archive.parent, os.W_OK):
            raise ConfigurationError(
                f"{archive}: cannot be made: {archive.parent} is no folder that may be written; make it first"
            )
        # where it exists at the end, another process has made it meanwhile
        with (
            contextlib.suppress(FileExistsError),
            atomic_write.being_written(archive) as temporary,
            _connection(temporary) as connection,
        ):
            connection.execute(_TABLES_SQL)
    with _connection(archive) as connection:
        connection.execute(f"begin transaction; {_TABLES_SQL}")
        if _is_of_another_version(connection):
            # the list of folders stays, and all of them are read again
            connection.execute(f"drop view runs; drop table every_run; delete from sessions; {_TABLES_SQL}")
        yield connection
        connection.execute("commit")


def check_is_there(archive: Path) -> None:
    """Raise ConfigurationError if the archive is missing."""
    if not archive.is_file():
        what = "is a folder; an archive is a file" if archive.is_dir() else "no such archive"
        raise ConfigurationError(f"{archive}: {what}; rig archive add FOLDER --archive FILE makes one")


def write_sessions(connection: Any, sessions: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Replace the rows of sessions; `sessions` maps folders to the hashes of their files."""
    forget_sessions(connection, list(sessions))
    connection.execute(
        "insert into sessions select unnest(?::varchar[]), unnest(?::varchar[])",
        [list(sessions), list(sessions.values())],
    )
    connection.execute(_INSERT_SQL, [json.dumps(rows, allow_nan=False, default=str)])


def forget_sessions(connection: Any, folders: Sequence[str]) -> None:
    """Remove the rows of sessions."""
    for table in ("sessions", "every_run"):
        connection.execute(f"delete from {table} where folder in (select unnest(?::varchar[]))", [folders])


def _is_of_another_version(connection: Any) -> bool:
    found = connection.execute("select * from every_run limit 0").description
    return [item[0] for item in found] != list(COLUMNS)


@contextlib.contextmanager
def _connection(archive: Path, *, read_only: bool = False) -> Iterator[Any]:
    """A connection; waits for another process that writes, and converts DuckDB's errors."""
    duckdb = optional_module(*_DUCKDB)
    given_up_s, connection = time.monotonic() + _MAX_WAIT_S, None
    try:
        while connection is None:
            try:
                connection = duckdb.connect(str(archive), read_only, _READ_ONLY_SETTINGS if read_only else {})
            except duckdb.IOException as error:
                if "lock" not in str(error).lower():
                    raise
                if time.monotonic() > given_up_s:
                    raise ConfigurationError(f"{archive}: another program has it open; close that") from None
                time.sleep(0.05)
        yield connection
    except (duckdb.DataError, duckdb.InvalidInputException, duckdb.OutOfMemoryException) as error:
        # for example '45 %', which is no number, or a table joined with itself
        reason = str(error).splitlines()[0].partition(": ")[2]
        raise ConfigurationError(
            f"condition or columns: {reason}; docs/reference/archive.md lists the columns and their units"
        ) from None
    except duckdb.Error as error:
        raise RecordError(
            f"{archive}: cannot be used: {str(error).splitlines()[0]}; a damaged one may be deleted: "
            "rig archive add FOLDER makes it again"
        ) from None
    finally:
        if connection is not None:
            # without a commit nothing has changed
            connection.close()


_SIMULATED = "SIMULATED: "
_MIN_WIDTH_OF_ALL = 150
"""Width of a terminal, in characters, that shows all columns of `SHOWN`; a narrower one shows `IMPORTANT`."""
_ID = "left(sha256, 8) as id"
_PARAMETERS = ("b", "p", "c", "n")
_SAMPLE = f"case when {IS_SIMULATED} then '{_SIMULATED}' else '' end || coalesce(sample, '') as sample"


def _u_columns(names: Sequence[str]) -> list[str]:
    """The columns of uncertainties and verdicts, shown in the cells of their quantities."""
    return [column for name in names for column in (*row_columns(name)[1:], f"verdict_{name}")]


def list_runs(
    archive: Path, condition: str, columns: str, output: Path | None, *, json_lines: bool = False
) -> None:
    """Print the runs that meet a condition of SQL (empty: all), or write them to a new CSV file.

    `columns` are expressions of SQL; by default those of `SHOWN` after the run's identifier, with
    uncertainties and verdicts of the parameters. With `json_lines` each run is printed as a JSON object on a
    line.

    Raises ConfigurationError for an invalid condition.
    """
    on_screen = not json_lines and output is None
    shown = IMPORTANT if on_screen and screen_width() < _MIN_WIDTH_OF_ALL else SHOWN
    default = f"{_ID}, {', '.join(shown)}" + ("" if on_screen else ", camera")
    default += "".join(f", {name}" for name in _u_columns([each for each in _PARAMETERS if each in shown]))
    if on_screen:
        default = default.replace(" sample,", f" {_SAMPLE},")
    names, rows = selected(archive, columns if columns.strip() else default, condition)
    if json_lines:
        for row in rows:
            print_json_line("run", dict(zip(names, row, strict=True)))
        return
    if output is None:
        table = _table(names, rows)
        more = "" if columns or shown is SHOWN else "; a wider window, --columns, --json and -o show more"
        print_tables([replace(table, note=f"{table.note}{more}")])
        return
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *(map(_cell, row) for row in rows)])
    with translated_file_errors(output, "name"):
        atomic_write.write_new(output, text.getvalue().encode())


def show_runs(archive: Path, names: Sequence[str]) -> None:
    """Print all columns of runs."""
    columns, rows = selected(archive, f"*, {IS_SIMULATED} as simulated", named_runs(archive, names))
    for values in rows:
        row = dict(zip(columns, values, strict=True))
        title = f"{_SIMULATED if row.pop('simulated') else ''}{Path(row['folder']) / row['record']}"
        texts = [
            (name, _cell_text(name, row))
            for name, value in row.items()
            if (value not in (None, "") or row.get(f"verdict_{name}")) and name not in _NUMBERS
        ]
        print_tables([Table(row["sha256"][:8], title, ("", ""), texts)])


def named_runs(archive: Path, names: Sequence[str]) -> str:
    """SQL condition for runs named by the first characters of their SHA-256; all runs without a name."""
    runs = (f"'{run}'" for name in names for run in _hashes_of(archive, name))
    return f"sha256 in ({', '.join(runs)})" if names else "true"


def ordered_runs(archive: Path, condition: str) -> list[tuple[Any, ...]]:
    """SHA-256, name, sample, folder and results file of the runs with results that meet a condition of SQL,
    in the order of their beginnings.

    Raises ConfigurationError if there are none.
    """
    wanted = f"select sha256, run, sample, folder, results from chosen where results is not null {_BY_TIME}"
    _, found = selected(archive, "*", condition, wanted)
    if not found:
        raise ConfigurationError(
            f"condition {condition!r}: no run with results meets it; rig archive list shows all"
        )
    return found


_FOUND_COLUMNS = (
    f"{_ID}, began_utc, folder, run, {_SAMPLE}, operator, state, "
    f"b, p, c, {', '.join(_u_columns(('b', 'p', 'c')))}"
)
_SEARCHED_TEXT = (
    "lower(concat_ws(' ', strftime(began_utc, '%Y-%m-%d %H:%M:%S'), folder, run, sample, operator, state, "
    "contact_history, noted))"
)


def find_runs(archive: Path, words: str, most: int) -> Table:
    """The newest runs with all these words in their texts, the newest first."""
    quoted = (word.replace("'", "''") for word in words.lower().split())
    where = " and ".join(f"contains({_SEARCHED_TEXT}, '{word}')" for word in quoted) or "true"
    order = f"order by began_utc desc nulls last, sha256 limit {most:d}"
    return _table(*selected(archive, _FOUND_COLUMNS, f"{where} {order}"))


def selected(
    archive: Path, wanted: str, condition: str, then: str = ""
) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Column names and rows of a query of the runs, or of the query `then` of its result `chosen`.

    Raises ConfigurationError for an invalid condition.
    """
    duckdb = optional_module(*_DUCKDB)
    no_condition = re.match(r"\s*(order\s+by|limit|group\s+by|$)", condition, re.IGNORECASE)
    runs = f"(select * from runs {_BY_TIME}) as runs"
    query = f"select {wanted} from {runs} {'' if no_condition else 'where '}{condition}"
    with reading(archive) as connection:
        try:
            if len(duckdb.extract_statements(query)) != 1:
                raise ConfigurationError(f"condition {condition!r}: holds a semicolon; leave it out")
            chosen = connection.sql(query)
        except duckdb.Error as error:
            reason = str(error).splitlines()[0].removeprefix("Binder Error: ")
            at_fault = f"condition {condition!r}"
            try:
                connection.sql(f"select {wanted} from runs limit 0")
            except duckdb.Error:
                at_fault = f"columns {wanted!r}"
            raise ConfigurationError(
                f"{at_fault}: {reason}; docs/reference/archive.md lists the columns"
            ) from None
        found = chosen.query("chosen", then) if then else chosen
        return list(found.columns), found.fetchall()


def _hashes_of(archive: Path, name: str) -> list[str]:
    """The SHA-256 of the run, or of the runs of the session, whose hash begins with a name.

    Raises ConfigurationError if it fits none or several.
    """
    if not re.fullmatch("[0-9a-f]{4,64}", name):
        raise ConfigurationError(f"{name}: names no run; take 4 or more characters of list's first column")
    where = f"starts_with(sha256, '{name}') or starts_with(session, '{name}')"
    _, found = selected(archive, "sha256, session", where)
    if not found:
        raise ConfigurationError(f"{name}: no run of the archive begins so; rig archive list names all")
    is_one_session = len({session for _, session in found}) == 1 and found[0][1].startswith(name)
    if len(found) > 1 and not is_one_session:
        raise ConfigurationError(f"{name}: {len(found)} runs begin so; give more characters")
    return [run for run, _ in found]


def _table(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    """Table of runs, with a value and its total u, or its bound, in one cell."""
    found = [dict(zip(names, row, strict=True)) for row in rows]
    head = [name for name in names if name not in _NUMBERS or _PREFIX.sub("", name, count=1) not in names]
    shown = [[_cell_text(name, row) for name in head] for row in found]
    return Table("runs", "", head, shown, f"{len(rows)} run{'s' if len(rows) != 1 else ''}")


_PREFIX = re.compile("(u_total|u|lower|upper|verdict)_")
_NUMBERS = [name for name in COLUMNS if _PREFIX.match(name)]
"""Columns that are shown in the cell of their quantity."""


def _cell_text(name: str, row: Mapping[str, Any]) -> str:
    value = row[name]
    if value is None:
        verdict, ends = row.get(f"verdict_{name}"), [row.get(f"{end}_{name}") for end in ("lower", "upper")]
        if not verdict or not any(ends):
            return NOT_KNOWN
        lower, upper = (nan if end is None else end for end in ends)
        bound = ResultRow(quantity=name, verdict=Determinacy(verdict), lower=lower, upper=upper)
        return bound.scaled_text(1.0)
    if isinstance(value, datetime.datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    if not isinstance(value, float):
        return str(value)
    u = row.get(f"u_total_{name}", row.get(f"u_{name}"))
    return plain(value, 5) if u is None else with_uncertainty(value, u)


def _cell(value: Any) -> Any:
    """A value of a CSV file; what is not known is an empty cell."""
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat()
    return harmless_text(str(value)) if isinstance(value, str) else value
