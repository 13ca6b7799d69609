"""The archive's file: a DuckDB database with the folders that were added and a row for each of their runs.

It is a cache of what lies in those folders, so nothing in it needs protection beyond DuckDB's transactions.
"""

import contextlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from processing.errors import ConfigurationError, RecordError
from rig.archive.session_rows import COLUMNS, SHORT_NAMES

_TABLES: Final = f"""
create table if not exists folders (folder varchar primary key);
create table if not exists sessions (folder varchar, files varchar);
create table if not exists every_run ({", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())});
create or replace view runs as
  select *, {", ".join(f"{name} as {short}" for short, name in SHORT_NAMES.items())}
  from every_run
  qualify row_number() over (partition by sha256 order by added_utc desc, folder) = 1;
"""
"""`sessions` says by a hash of names, sizes and times in which state a folder was read; `runs` has a run that
lies in several folders once.
"""
_INSERT: Final = f"""
insert into every_run by name
  select unnest(row) from (select unnest(from_json(?::json, '{json.dumps([COLUMNS])}')) as row)
"""
_READS_ONLY: Final = {
    "enable_external_access": "false",
    "lock_configuration": "true",
    "autoinstall_known_extensions": "false",
    "python_enable_replacements": "false",
}
"""A condition reads the archive and nothing else: no file, no variable of this program."""
_WAIT_S = 20.0
"""So long another process is waited for that writes; a transaction takes a part of a second."""


def duckdb_module() -> Any:
    """DuckDB. Raises ConfigurationError where it is not installed."""
    try:
        import duckdb
    except ImportError:
        remedy = "pip install 'optical-pendulum-rig[data]'"
        raise ConfigurationError(f"rig archive needs duckdb: {remedy}") from None
    return duckdb


@contextlib.contextmanager
def reading(archive: Path) -> Iterator[Any]:
    """A connection that reads the archive.

    Raises ConfigurationError where there is none, or for a condition that no row can meet, which is found
    when rows are fetched; RecordError for a file that cannot be read.
    """
    check_is_there(archive)
    with _connected(archive, read_only=True, config=_READS_ONLY) as connection:
        if _is_of_another_version(connection):
            raise RecordError(f"{archive}: another version made it; rig archive update makes it again")
        yield connection


@contextlib.contextmanager
def writing(archive: Path) -> Iterator[Any]:
    """A connection in one transaction, of which all is written when the block ends, or nothing."""
    with _connected(archive) as connection:
        connection.execute(f"begin transaction; {_TABLES}")
        if _is_of_another_version(connection):
            # the folders are kept, and all of them are read again
            connection.execute(f"drop view runs; drop table every_run; delete from sessions; {_TABLES}")
        yield connection
        connection.execute("commit")


def check_is_there(archive: Path) -> None:
    """Raise ConfigurationError where there is no archive."""
    if not archive.is_file():
        what = "is a folder; an archive is a file" if archive.is_dir() else "no such archive"
        raise ConfigurationError(f"{archive}: {what}; rig archive add FOLDER --archive FILE makes one")


def write_sessions(connection: Any, sessions: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Put the rows of sessions, each with the hash of its files, in place of those that are there."""
    forget_sessions(connection, list(sessions))
    connection.execute(
        "insert into sessions select unnest(?::varchar[]), unnest(?::varchar[])",
        [list(sessions), list(sessions.values())],
    )
    connection.execute(_INSERT, [json.dumps(rows, allow_nan=False, default=str)])


def forget_sessions(connection: Any, folders: Sequence[str]) -> None:
    """Take away the rows of sessions."""
    for table in ("sessions", "every_run"):
        connection.execute(f"delete from {table} where folder in (select unnest(?::varchar[]))", [folders])


def _is_of_another_version(connection: Any) -> bool:
    found = connection.execute("select * from every_run limit 0").description
    return [item[0] for item in found] != list(COLUMNS)


@contextlib.contextmanager
def _connected(
    archive: Path, *, read_only: bool = False, config: Mapping[str, str] | None = None
) -> Iterator[Any]:
    """A connection; waits for another process that writes, and says in a line what DuckDB raises."""
    duckdb, given_up_s, connection = duckdb_module(), time.monotonic() + _WAIT_S, None
    try:
        while connection is None:
            try:
                connection = duckdb.connect(str(archive), read_only=read_only, config=dict(config or {}))
            except duckdb.IOException as error:
                if "lock" not in str(error).lower():
                    raise
                if time.monotonic() > given_up_s:
                    raise ConfigurationError(f"{archive}: another program has it open; close that") from None
                time.sleep(0.05)
        yield connection
    except (duckdb.DataError, duckdb.InvalidInputException, duckdb.OutOfMemoryException) as error:
        # as '45 %' is no number, or a table joined with itself
        said = str(error).splitlines()[0].partition(": ")[2]
        raise ConfigurationError(
            f"condition or columns: {said}; docs/reference/archive.md lists the columns and their units"
        ) from None
    except duckdb.Error as error:
        raise RecordError(
            f"{archive}: cannot be used: {str(error).splitlines()[0]}; a damaged one may be deleted: "
            "rig archive add FOLDER makes it again"
        ) from None
    finally:
        if connection is not None:
            # without a commit all is as it was
            connection.close()
