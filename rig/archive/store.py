"""The files of an archive: one Parquet file a session, and one in which many of them are read at once.

`sessions/` holds a file for each version of a session, written once, whole or not at all, never changed.
`merged/` holds the same rows again, in one file for speed: deleted, it is made anew. Nobody waits for a
lock: two processes that write at once write different files, or the same one.
"""

import contextlib
import functools
import io
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.archive.columns import COLUMNS, SHORT_NAMES
from rig.archive.remarks import read_remarks

_P = ParamSpec("_P")
_R = TypeVar("_R")
_MANY = 256
"""Files of sessions beside the merged one from which on they are merged."""
_FEW = 24
_KEPT = 2
"""Merged files that are kept: somebody may be reading the one before."""


class Archive:
    """The archive in one folder, which is made when something is added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._sessions = folder / "sessions"
        self._merged = folder / "merged"

    def add(self, name: str, rows: Sequence[Mapping[str, Any]]) -> bool:
        """Write a version of a session, rows by the names of `COLUMNS`; False if it is there already."""
        try:
            self._sessions.mkdir(parents=True, exist_ok=True)
            whole_file.write_new(self._sessions / f"{name}.parquet", _parquet(_table(rows)))
        except FileExistsError:
            return False
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be written: {error.strerror or error}") from None
        return True

    def versions(self) -> set[str]:
        """Names of all versions of sessions."""
        try:
            return {
                entry.name.removesuffix(".parquet")
                for entry in os.scandir(self._sessions)
                if entry.name.endswith(".parquet") and not entry.name.startswith(".")
            }
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be read: {error.strerror or error}") from None

    def merge(self, *, at_once: int = _FEW) -> None:
        """Write the merged file anew where at least so many sessions are not in it."""
        import pyarrow as pa
        from pyarrow import parquet

        newest, number = self._newest()
        there = self.versions()
        tables = []
        if newest is not None:
            with contextlib.suppress(pa.ArrowInvalid, OSError):
                old = parquet.read_table(newest)
                tables.append(old.filter(pa.array([name in there for name in old["version"].to_pylist()])))
        merged = set(tables[0]["version"].to_pylist()) if tables else set()
        loose = sorted(there - merged)
        if len(loose) < at_once:
            return
        for name in loose:
            path = self._sessions / f"{name}.parquet"
            try:
                tables.append(parquet.read_table(path))
            except (pa.ArrowInvalid, OSError) as error:
                raise RecordError(_unreadable(path, error)) from None
        self._merged.mkdir(exist_ok=True)
        data = _parquet(pa.concat_tables(tables, promote_options="default"))
        # another process that was faster has merged as well as this one
        with contextlib.suppress(FileExistsError):
            whole_file.write_new(self._merged / f"runs-{number + 1:08d}.parquet", data)
        for old_path in sorted(self._merged.glob("runs-*.parquet"))[:-_KEPT]:
            old_path.unlink(missing_ok=True)

    def connection(self) -> Any:
        """A DuckDB connection in which `runs` has the newest row of every run; it can read nothing else.

        Raises RecordError where nothing was added yet, or a file is damaged.
        """
        there = self.versions()
        if not there:
            raise RecordError(
                f"{self.folder}: holds no sessions; rig archive add --archive {self.folder} DIR"
            )
        duckdb = duckdb_module()
        connection = duckdb.connect(
            config={"autoinstall_known_extensions": "false", "python_enable_replacements": "false"}
        )
        newest, _ = self._newest()
        files: list[str] = []
        gone: list[str] = []
        merged: set[str] = set()
        try:
            if newest is not None:
                found = connection.execute("select distinct version from read_parquet(?)", [str(newest)])
                merged = {name for (name,) in found.fetchall()}
                files, gone = [str(newest)], sorted(merged - there)
            files += [str(self._sessions / f"{name}.parquet") for name in sorted(there - merged)]
            connection.execute("set variable files = ?", [files])
            connection.execute("set variable gone = ?", [gone])
            connection.execute(_REMARKS, list(read_remarks(self.folder)))
            connection.execute(_VIEWS)
        except duckdb.Error as error:
            raise RecordError(_unreadable(self.folder, error)) from None
        connection.execute("set allowed_paths = $files", {"files": files})
        connection.execute("set enable_external_access = false")
        connection.execute("set lock_configuration = true")
        return connection

    def _newest(self) -> tuple[Path | None, int]:
        """The merged file with the highest number, and that number."""
        numbered = {
            int(found[1]): path
            for path in self._merged.glob("runs-*.parquet")
            if (found := re.fullmatch(r"runs-(\d+)\.parquet", path.name))
        }
        number = max(numbered, default=0)
        return numbered.get(number), number

    def merge_many(self) -> None:
        """Merge if so many sessions are not in the merged file that reading them one by one takes long."""
        self.merge(at_once=_MANY)


_ALIASES = ", ".join(f"{name} as {short}" for short, name in SHORT_NAMES.items())
_REMARKS = """
create table remarks as
  select
    unnest($1::varchar[]) as run_sha256, unnest($2::varchar[][]) as tags, unnest($3::varchar[][]) as notes
"""
_VIEWS = f"""
create view versions as
  select * from read_parquet(getvariable('files'), union_by_name = true)
  where not list_contains(getvariable('gone'), version);
create view latest as
  select * from versions
  where version in (
    select arg_max(version, (added_utc, version)) from versions group by computer, folder
  );
create view runs as
  select
    latest.*, coalesce(tags, []::varchar[]) as tags, coalesce(notes, []::varchar[]) as notes, {_ALIASES}
  from latest left join remarks on run_sha256 = sha256
  qualify row_number() over (partition by sha256 order by added_utc desc, version desc) = 1;
"""


def duckdb_module() -> Any:
    """DuckDB. Raises ConfigurationError where it is not installed."""
    try:
        import duckdb
    except ImportError:
        raise ConfigurationError(
            "rig archive needs DuckDB and pyarrow: pip install 'optical-pendulum-rig[archive]'"
        ) from None
    return duckdb


def reads_archive(function: Callable[Concatenate[Path, _P], _R]) -> Callable[Concatenate[Path, _P], _R]:
    """A function of an archive's folder that raises RecordError where DuckDB finds a fault as it reads rows.

    A query's rows are read when they are fetched, after the query itself was found sound.
    """

    @functools.wraps(function)
    def reading(archive: Path, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        duckdb = duckdb_module()
        try:
            return function(archive, *args, **kwargs)
        except duckdb.Error as error:
            raise RecordError(_unreadable(archive, error)) from None

    return reading


def _unreadable(path: Path, error: object) -> str:
    text = str(error).splitlines()[0]
    return f"{path}: cannot be read: {text}; delete the file that is named, rig archive add makes it anew"


def _table(rows: Iterable[Mapping[str, Any]]) -> Any:
    import pyarrow as pa

    kinds = {
        "text": pa.string(),
        "number": pa.float64(),
        "count": pa.int64(),
        "yes or no": pa.bool_(),
        "time": pa.timestamp("us"),
    }
    schema = pa.schema([(name, kinds[column.kind]) for name, column in COLUMNS.items()])
    return pa.Table.from_pylist([dict(row) for row in rows], schema=schema)


def _parquet(table: Any) -> bytes:
    from pyarrow import parquet

    data = io.BytesIO()
    parquet.write_table(table, data, compression="zstd")
    return data.getvalue()
