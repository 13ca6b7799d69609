"""The catalogue of an archive: rows of sessions in Parquet files, and a DuckDB connection that reads them.

`sessions/` holds a file for each version of a session, `refits/` one for each result that was made again,
`merged/` the same rows again (see `Shelf`).
"""

import datetime
import functools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import zstandard

from processing.errors import ConfigurationError, MissingPackage
from rig.archive.blind import Seal, offsets, sealed
from rig.archive.columns import COLUMNS, OF_REFITS, SHORT_NAMES, Column
from rig.archive.remarks import read_remarks
from rig.archive.shelf import MANY, Shelf, as_parquet, digest_of, unreadable

REFIT_SUFFIX = ".json.zst"
_P = ParamSpec("_P")
_R = TypeVar("_R")


class Archive:
    """The archive in one folder, which is made when something is added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._sessions = Shelf(
            folder / "sessions", folder / "merged", "runs", ".parquet", _read_parquet, _with_listed
        )
        self.refits = refit_shelf(folder)

    def add(self, name: str, rows: Sequence[Mapping[str, Any]]) -> bool:
        """Write a version of a session, rows by the names of `COLUMNS`; False if it is there already."""
        return self._sessions.write(name, as_parquet(_table(rows)))

    def versions(self) -> set[str]:
        """Names of all versions of sessions."""
        return self._sessions.names()

    def known_files(self, computer: str) -> set[tuple[str, str]]:
        """Folders of a computer with what their files were like when they were last added."""
        if not self.versions():
            return set()
        query = "select distinct folder, files from latest where computer = ? and files is not null"
        return set(self.connection().execute(query, [computer]).fetchall())

    def merge(self, **how: int) -> None:
        """Rewrite the merged file where many sessions are not in it (see `Shelf.merge`)."""
        self._sessions.merge(**how)

    def merge_many(self) -> None:
        """Merge if so many sessions are not in the merged file that reading them one by one takes long."""
        self._sessions.merge(at_once=MANY)

    def connection(self, *, refits: bool = False) -> Any:
        """A DuckDB connection in which `runs` has the newest row of every run; it can read nothing else.

        With `refits` the table of that name has a row for each result that was made again.

        Raises ConfigurationError where nothing was added yet, RecordError where a file is damaged.
        """
        there = self.versions()
        if not there:
            raise ConfigurationError(
                f"{self.folder}: holds no sessions; rig archive add --archive {self.folder} DIR"
            )
        duckdb = duckdb_module()
        connection = duckdb.connect(
            config={"autoinstall_known_extensions": "false", "python_enable_replacements": "false"}
        )
        newest = self._sessions.newest()
        files: list[str] = [] if newest is None else [str(newest.path)]
        gone: list[str] = []
        merges_all = newest is not None and newest.of == digest_of(there)
        try:
            if not merges_all:
                merged: set[str] = set()
                if files:
                    found = connection.execute("select distinct version from read_parquet(?)", files)
                    merged = {name for (name,) in found.fetchall()}
                gone = sorted(merged - there)
                files += [str(self._sessions.path(name)) for name in sorted(there - merged)]
            connection.execute("set variable files = ?", [files])
            connection.execute("set variable gone = ?", [gone])
            connection.execute(_REMARKS, list(read_remarks(self.folder)))
            connection.execute(f"{_VIEWS}; create view latest as {_LATEST}")
            connection.execute(_OPEN_RUNS.format(rows=_MARKED if merges_all else _LISTED))
            if refits:
                files += self._with_refits(connection)
            _hide(connection, sealed(self.folder), refits=refits)
        except duckdb.Error as error:
            raise unreadable(self.folder, error) from None
        connection.execute("set allowed_paths = $files", {"files": files})
        connection.execute("set enable_external_access = false")
        connection.execute("set lock_configuration = true")
        return connection

    def _with_refits(self, connection: Any) -> list[str]:
        """Define the table `refits`; returns the files that it is read from."""
        self.refits.merge(at_once=MANY)
        newest = self.refits.newest()
        loose, there = self.refits.names(), sorted(self.refits.names())
        source = "select * from loose_refits"
        if newest is not None:
            merged = str(newest.path)
            found = connection.execute("select version from read_parquet(?)", [merged]).fetchall()
            loose = loose - {name for (name,) in found}
            source = f"{source} union all by name select * from read_parquet('{_quoted(newest.path)}')"
        import pyarrow as pa

        tables = [_table([], _REFIT_COLUMNS), *(self.refits.read(self.refits.path(n)) for n in sorted(loose))]
        connection.register("loose_rows", pa.concat_tables(tables))
        connection.execute("create table loose_refits as select * from loose_rows")
        connection.unregister("loose_rows")
        connection.execute("set variable refits_there = ?", [there])
        connection.execute(_REFITS.replace("SOURCE", source))
        return [] if newest is None else [str(newest.path)]


def _hide(connection: Any, seal: Seal | None, *, refits: bool) -> None:
    """The tables as they are shown: with hidden offsets where the archive is blind."""
    names = ("runs", "refits") if refits else ("runs",)
    if seal is None:
        for name in names:
            connection.execute(f"create view {name} as select * from open_{name}")
        return
    hosts = [host for (host,) in connection.execute("select distinct host from open_runs").fetchall()]
    columns = ", ".join(f'"{name}" double' for name in seal.scales)
    connection.execute(f"create table hidden (of_host varchar, {columns})")
    for row in offsets(seal, hosts):
        connection.execute(f"insert into hidden values ({', '.join('?' * len(row))})", list(row.values()))
    for name in names:
        moved = ", ".join(f"{name}.{column} + hidden.{column} as {column}" for column in seal.scales)
        connection.execute(
            f"create view {name} as select {name}.* replace ({moved}) "
            f"from open_{name} as {name} join hidden on of_host is not distinct from host"
        )


_ALIASES = ", ".join(f"{name} as {short}" for short, name in SHORT_NAMES.items())
_REMARKS = """
create table remarks as
  select
    unnest($1::varchar[]) as run_sha256, unnest($2::varchar[][]) as tags, unnest($3::varchar[][]) as notes
"""
_TYPES = {
    "text": "varchar",
    "number": "double",
    "count": "bigint",
    "yes or no": "boolean",
    "time": "timestamp",
}
_VIEWS = f"""
create table no_rows (
  {", ".join(f"{name} {_TYPES[column.kind]}" for name, column in COLUMNS.items())}, listed boolean
);
create view all_rows as
  select * from no_rows union all by name
  select * from read_parquet(getvariable('files'), union_by_name = true);
create view versions as
  select * exclude listed from all_rows where not list_contains(getvariable('gone'), version)
"""
_LATEST = """
select * from versions
where version in (select arg_max(version, (added_utc, version)) from versions group by computer, folder)
"""
"""Of each folder the rows of its newest version."""
_LISTED = """
select * from latest
qualify row_number() over (partition by sha256 order by added_utc desc, version desc) = 1
"""
"""The rows that are listed: of a folder those of its newest version, and of a run the newest one."""
_MARKED = "select * exclude listed from all_rows where listed"
"""The same where one merged file holds all rows and says which are listed."""
_OPEN_RUNS = f"""
create view open_runs as
  select
    shown.*, coalesce(tags, []::varchar[]) as tags, coalesce(notes, []::varchar[]) as notes, {_ALIASES}
  from ({{rows}}) as shown left join remarks on run_sha256 = sha256;
"""


_FROM_RESULTS = [*list(COLUMNS)[list(COLUMNS).index("configuration_sha256") :], "version"]
"""Columns that results decide; the others are the run's."""
_REFIT_COLUMNS = {
    **{name: COLUMNS[name] for name in ("sha256", *_FROM_RESULTS)},
    **{name: column for name, column in OF_REFITS.items() if name != "newest"},
}
_REFITS = f"""
create view open_refits as
  with made as (SOURCE)
  select
    runs.* replace ({", ".join(f"made.{name} as {name}" for name in _FROM_RESULTS)}),
    level, laws, settings, code, made_utc,
    row_number() over (partition by made.sha256 order by made_utc desc, made.version desc) = 1 as newest
  from made join open_runs as runs on runs.sha256 = made.sha256
  where list_contains(getvariable('refits_there'), made.version)
"""


def duckdb_module() -> Any:
    """DuckDB. Raises ConfigurationError where it is not installed."""
    try:
        import duckdb
    except ImportError:
        raise MissingPackage("rig archive", "duckdb", "pyarrow") from None
    return duckdb


def reads_archive(function: Callable[Concatenate[Path, _P], _R]) -> Callable[Concatenate[Path, _P], _R]:
    """A function of an archive's folder that raises RecordError where DuckDB finds a damaged file.

    A query's rows are read when they are fetched, after the query itself was found sound.
    """

    @functools.wraps(function)
    def reading(archive: Path, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        duckdb = duckdb_module()
        try:
            return function(archive, *args, **kwargs)
        except (duckdb.ConversionException, duckdb.OutOfRangeException) as error:
            # as '45 %' is no number: found when the rows are read
            said = str(error).splitlines()[0].partition(": ")[2]
            raise ConfigurationError(
                f"condition or columns: {said}; docs/archive.md names the columns and their units"
            ) from None
        except duckdb.Error as error:
            raise unreadable(archive, error) from None

    return reading


def refit_shelf(archive: Path) -> Shelf:
    """Where results that were made again lie."""
    return Shelf(archive / "refits", archive / "merged", "refits", REFIT_SUFFIX, _read_refit_row)


def _table(rows: Iterable[Mapping[str, Any]], columns: Mapping[str, Column] = COLUMNS) -> Any:
    import pyarrow as pa

    kinds = {
        "text": pa.string(),
        "number": pa.float64(),
        "count": pa.int64(),
        "yes or no": pa.bool_(),
        "time": pa.timestamp("us"),
    }
    schema = pa.schema([(name, kinds[column.kind]) for name, column in columns.items()])
    return pa.Table.from_pylist([dict(row) for row in rows], schema=schema)


def _with_listed(table: Any) -> Any:
    """The rows of all sessions with a further column: whether a row is listed."""
    import numpy as np
    import pyarrow as pa

    kept = table.drop_columns("listed") if "listed" in table.column_names else table
    with duckdb_module().connect() as connection:
        connection.register("versions", kept.append_column("place", pa.array(np.arange(len(kept)))))
        connection.execute(f"create view latest as {_LATEST}")
        found = connection.execute(f"select place from ({_LISTED})").fetchnumpy()["place"]
    listed = np.zeros(len(kept), dtype=np.bool_)
    listed[found] = True
    return kept.append_column("listed", pa.array(listed))


def _read_parquet(path: Path) -> Any:
    from pyarrow import parquet

    # several times faster for a small file than `read_table`, which starts threads
    return parquet.ParquetFile(path).read(use_threads=False)


def _read_refit_row(path: Path) -> Any:
    try:
        tree = json.loads(zstandard.ZstdDecompressor().decompress(path.read_bytes()))
        row = {
            **tree["row"],
            "level": tree["level"],
            "laws": ", ".join(tree["laws"]),
            "settings": "; ".join(tree["settings"]),
            "code": tree["code"],
            "made_utc": datetime.datetime.fromisoformat(tree["made_utc"]),
        }
    except (OSError, ValueError, KeyError, TypeError, zstandard.ZstdError) as error:
        raise unreadable(path, error, "refit") from None
    return _table([row], _REFIT_COLUMNS)


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")
