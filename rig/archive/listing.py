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
from math import nan
from pathlib import Path
from typing import Any, Final

from acquisition import atomic_write
from processing.errors import ConfigurationError, RecordError, optional_module
from processing.estimate import Determinacy
from rig.analysis import ResultRow
from rig.archive.session_rows import (
    COLUMNS,
    IS_SIMULATED,
    NARROW_COLUMNS,
    PARAMETERS,
    SHORT_NAMES,
    WIDE_COLUMNS,
    row_columns,
)
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
"""`sessions` has a hash of names, sizes and times of each folder's files; `runs` lists copied runs once."""
_INSERT_SQL: Final = f"""
insert into every_run by name
  select unnest(row) from (select unnest(from_json(?::json, '{json.dumps([COLUMNS])}')) as row)
"""
_RUN_NUMBER: Final = "coalesce(try_cast(regexp_extract(run, '[0-9]+$') as bigint), 0)"
_BY_TIME: Final = f"""
order by max(began_utc) over (partition by folder order by {_RUN_NUMBER}, run) nulls last,
  folder, {_RUN_NUMBER}, run
"""
"""The order of measurement; runs of one session are in the order of their numbers, even if the clock was set
back."""
_READ_ONLY_SETTINGS: Final = {
    "enable_external_access": "false",
    "lock_configuration": "true",
    "autoinstall_known_extensions": "false",
    "python_enable_replacements": "false",
}
"""Settings with which a condition can read only the archive: no file, no variable of this program."""
_DUCKDB: Final = ("duckdb", "rig archive", "duckdb", "data")
_MAX_WAIT_S = 20.0
"""Longest wait for another process that writes, which takes a fraction of a second."""


@contextlib.contextmanager
def open_for_reading(archive: Path) -> Iterator[Any]:
    """A connection that reads the archive.

    Raises ConfigurationError if there is no archive, or if fetching rows finds an invalid value in a
    condition; RecordError for a file that cannot be read.
    """
    require_archive(archive)
    with _connection(archive, read_only=True) as connection:
        if _has_other_columns(connection):
            raise RecordError(f"{archive}: another version made it; rig archive update makes it again")
        yield connection


@contextlib.contextmanager
def open_for_writing(archive: Path) -> Iterator[Any]:
    """A connection in one transaction, which is committed when the block ends without an error.

    A missing archive is made, under a temporary name: DuckDB takes a file that is opened while its first
    bytes are written for a damaged one.
    """
    if not os.path.lexists(archive):
        if not os.access(archive.parent, os.W_OK):
            raise ConfigurationError(
                f"{archive}: cannot be made: {archive.parent} is no folder that may be written; make it first"
            )
        # where it exists at the end, another process has made it meanwhile
        with (
            contextlib.suppress(FileExistsError),
            atomic_write.atomic_file(archive) as temporary,
            _connection(temporary) as connection,
        ):
            connection.execute(_TABLES_SQL)
    with _connection(archive) as connection:
        connection.execute(f"begin transaction; {_TABLES_SQL}")
        if _has_other_columns(connection):
            # the list of folders stays, and all of them are read again
            connection.execute(f"drop view runs; drop table every_run; delete from sessions; {_TABLES_SQL}")
        yield connection
        connection.execute("commit")


def require_archive(archive: Path) -> None:
    """Raise ConfigurationError if the archive is missing."""
    if not archive.is_file():
        reason = "is a folder; an archive is a file" if archive.is_dir() else "no such archive"
        raise ConfigurationError(f"{archive}: {reason}; rig archive add FOLDER --archive FILE makes one")


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


def _has_other_columns(connection: Any) -> bool:
    description = connection.execute("select * from every_run limit 0").description
    return [name for name, *_ in description] != list(COLUMNS)


@contextlib.contextmanager
def _connection(archive: Path, *, read_only: bool = False) -> Iterator[Any]:
    """A connection; waits for another process that writes, and converts DuckDB's errors."""
    duckdb = optional_module(*_DUCKDB)
    deadline_s, connection = time.monotonic() + _MAX_WAIT_S, None
    try:
        while connection is None:
            try:
                connection = duckdb.connect(str(archive), read_only, _READ_ONLY_SETTINGS if read_only else {})
            except duckdb.IOException as error:
                if "lock" not in str(error).lower():
                    raise
                if time.monotonic() > deadline_s:
                    raise ConfigurationError(f"{archive}: another program has it open; close that") from None
                time.sleep(0.05)
        yield connection
    except (duckdb.DataError, duckdb.InvalidInputException, duckdb.OutOfMemoryException) as error:
        # for example '45 %', which is no number, or a table joined with itself
        reason = str(error).splitlines()[0].partition(": ")[2]
        if not read_only:
            raise RecordError(f"{archive}: cannot be written: {reason}") from None
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
_MIN_WIDE_CHARACTERS = 150
"""Width of a terminal that shows `WIDE_COLUMNS`; a narrower one shows `NARROW_COLUMNS`."""
_ID = "left(sha256, 8) as id"
_SAMPLE = f"case when {IS_SIMULATED} then '{_SIMULATED}' else '' end || coalesce(sample, '') as sample"


def _u_columns(names: Sequence[str]) -> list[str]:
    """The columns of uncertainties, bounds and verdicts, which are shown in the cells of their quantities."""
    return [column for name in names for column in (*row_columns(name)[1:], f"verdict_{name}")]


def list_runs(
    archive: Path, condition: str, columns: str, output: Path | None, *, json_lines: bool = False
) -> None:
    """Print the runs that meet a condition of SQL (empty: all), or write them to a new CSV file.

    `columns` are expressions of SQL; by default the run's identifier and `WIDE_COLUMNS`, with uncertainties
    and verdicts of the parameters. With `json_lines` each run is printed as a JSON object on a line.
    """
    on_screen = not json_lines and output is None
    default = NARROW_COLUMNS if on_screen and screen_width() < _MIN_WIDE_CHARACTERS else WIDE_COLUMNS
    listed = [_SAMPLE if on_screen and name == "sample" else name for name in (_ID, *default)]
    listed += [] if on_screen else ["camera"]
    listed += _u_columns([name for name in PARAMETERS if name in default])
    names, rows = query_runs(archive, columns.strip() or ", ".join(listed), condition)
    if json_lines:
        for row in rows:
            print_json_line("run", dict(zip(names, row, strict=True)))
        return
    if output is None:
        is_narrow = not columns and default is NARROW_COLUMNS
        hint = "; a wider window, --columns, --json and -o show more" if is_narrow else ""
        print_tables([_table(names, rows, hint)])
        return
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *(map(_csv_cell, row) for row in rows)])
    with translated_file_errors(output, "name"):
        atomic_write.write_new(output, text.getvalue().encode())


def show_runs(archive: Path, names: Sequence[str]) -> None:
    """Print all columns of runs."""
    columns, rows = query_runs(archive, f"*, {IS_SIMULATED} as simulated", hash_condition(archive, names))
    for values in rows:
        row = dict(zip(columns, values, strict=True))
        title = f"{_SIMULATED if row.pop('simulated') else ''}{Path(row['folder']) / row['record']}"
        texts = [
            (name, _screen_cell(name, row))
            for name, value in row.items()
            if (value not in (None, "") or row.get(f"verdict_{name}")) and name not in _ATTACHED_COLUMNS
        ]
        print_tables([Table(row["sha256"][:8], title, ("", ""), texts)])


def hash_condition(archive: Path, names: Sequence[str]) -> str:
    """SQL condition for runs named by the first characters of their, or their session's, SHA-256.

    It is that for all runs without names. Raises ConfigurationError for a name that fits none or several.
    """
    hashes = list[str]()
    for name in names:
        if not re.fullmatch("[0-9a-f]{4,64}", name):
            raise ConfigurationError(
                f"{name}: names no run; take 4 or more characters of list's first column"
            )
        where = f"starts_with(sha256, '{name}') or starts_with(session, '{name}')"
        _, runs = query_runs(archive, "sha256, session", where)
        if not runs:
            raise ConfigurationError(f"{name}: no run of the archive begins so; rig archive list names all")
        is_one_session = len({session for _, session in runs}) == 1 and runs[0][1].startswith(name)
        if len(runs) > 1 and not is_one_session:
            raise ConfigurationError(f"{name}: {len(runs)} runs begin so; give more characters")
        hashes += [f"'{sha256}'" for sha256, _ in runs]
    return f"sha256 in ({', '.join(hashes)})" if names else "true"


def ordered_runs(archive: Path, condition: str) -> list[tuple[Any, ...]]:
    """SHA-256, name, sample, folder and results file of runs with results, in the order of measurement.

    The runs are those that meet a condition of SQL; raises ConfigurationError if there are none.
    """
    query = f"select sha256, run, sample, folder, results from chosen where results is not null {_BY_TIME}"
    _, rows = query_runs(archive, "*", condition, query)
    if not rows:
        raise ConfigurationError(
            f"condition {condition!r}: no run with results meets it; rig archive list shows all"
        )
    return rows


_FOUND_COLUMNS = (
    f"{_ID}, began_utc, folder, run, {_SAMPLE}, operator, state, "
    f"b, p, c, {', '.join(_u_columns(('b', 'p', 'c')))}"
)
_SEARCHED_TEXT = (
    "lower(concat_ws(' ', strftime(began_utc, '%Y-%m-%d %H:%M:%S'), folder, run, sample, operator, state, "
    "contact_history, noted))"
)


def find_runs(archive: Path, words: str, limit: int) -> Table:
    """The newest runs with all these words in their texts, the newest first."""
    quoted = (word.replace("'", "''") for word in words.lower().split())
    contain = " and ".join(f"contains({_SEARCHED_TEXT}, '{word}')" for word in quoted) or "true"
    order = f"order by began_utc desc nulls last, sha256 limit {limit:d}"
    return _table(*query_runs(archive, _FOUND_COLUMNS, f"{contain} {order}"))


def query_runs(
    archive: Path, columns: str, condition: str, outer_query: str = ""
) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Column names and rows of a query of the runs, or of an `outer_query` of its result, `chosen`.

    Raises ConfigurationError for an invalid condition.
    """
    duckdb = optional_module(*_DUCKDB)
    starts_with_clause = re.match(r"\s*(order\s+by|limit|group\s+by|$)", condition, re.IGNORECASE)
    runs = f"(select * from runs {_BY_TIME}) as runs"
    query = f"select {columns} from {runs} {'' if starts_with_clause else 'where '}{condition}"
    with open_for_reading(archive) as connection:
        try:
            if len(duckdb.extract_statements(query)) != 1:
                raise ConfigurationError(f"condition {condition!r}: holds a semicolon; leave it out")
            chosen = connection.sql(query)
        except duckdb.Error as error:
            reason = str(error).splitlines()[0].removeprefix("Binder Error: ")
            culprit = f"condition {condition!r}"
            try:
                connection.sql(f"select {columns} from runs limit 0")
            except duckdb.Error:
                culprit = f"columns {columns!r}"
            raise ConfigurationError(
                f"{culprit}: {reason}; docs/reference/archive.md lists the columns"
            ) from None
        result = chosen.query("chosen", outer_query) if outer_query else chosen
        return list(result.columns), result.fetchall()


def _table(names: Sequence[str], rows: Sequence[Sequence[Any]], hint: str = "") -> Table:
    """Table of runs, with a value and its total u, or its bound, in one cell; the note ends in a hint."""
    attached = {name for name in _ATTACHED_COLUMNS if _PREFIX.sub("", name, count=1) in names}
    head = [name for name in names if name not in attached]
    by_name = (dict(zip(names, row, strict=True)) for row in rows)
    cells = [[_screen_cell(name, row) for name in head] for row in by_name]
    return Table("runs", "", head, cells, f"{len(rows)} run{'s' if len(rows) != 1 else ''}{hint}")


_PREFIX = re.compile("(u_total|u|lower|upper|verdict)_")
_ATTACHED_COLUMNS = [name for name in COLUMNS if _PREFIX.match(name)]
"""Columns that are shown in the cell of their quantity."""


def _screen_cell(name: str, row: Mapping[str, Any]) -> str:
    value = row[name]
    if value is None:
        verdict, ends = row.get(f"verdict_{name}"), [row.get(f"{end}_{name}") for end in ("lower", "upper")]
        if not verdict or ends == [None, None]:
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


def _csv_cell(value: Any) -> Any:
    """A value in a CSV file; an unknown value is an empty cell."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    return harmless_text(value) if isinstance(value, str) else value
