"""The catalogue of an archive: a DuckDB connection in which the runs are as facts say that they are now.

`facts/` is the log, `sessions/` holds a file for each state of a session, `refits/` one for each result that
was made again, `merged/` the same rows again (see `Shelf`), and `archive.json` says which archive it is.
"""

import datetime
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Concatenate, Final, ParamSpec, TypeVar

import zstandard

from acquisition.record import whole_file
from processing.errors import ConfigurationError, MissingPackage, RecordError
from rig.archive import catalogue
from rig.archive.blind import opened_keys, sealed
from rig.archive.columns import Column
from rig.archive.facts import Entry, Fact, FactLog
from rig.archive.hiding import show_as_it_is, show_hidden
from rig.archive.manifest import MANIFEST, identity, write_manifest
from rig.archive.proved import read_file, without_frame
from rig.archive.remarks import read_remarks
from rig.archive.sessions import Sessions, facts_table
from rig.archive.shelf import MANY, Shelf, digest_of, table_of, unreadable

REFIT_SUFFIX = ".json.zst"
_REFIT_COLUMNS = {**catalogue.REFIT_COLUMNS, "turn": Column("count", "order of the refits")}
CONFIG: Final = {"autoinstall_known_extensions": "false", "python_enable_replacements": "false"}
"""Of DuckDB: it loads nothing and sees no variables of this program."""
_MEMORY = "the condition needs more memory than there is; choose fewer columns, or add a limit"
_P = ParamSpec("_P")
_R = TypeVar("_R")


class Archive:
    """The archive in one folder, which is made when something is added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log = FactLog(folder)
        self.sessions = Sessions(folder, self.log)
        self.refits = refit_shelf(folder)

    def begin(self) -> None:
        """Make the archive where there is none, and take over what earlier versions of the program left."""
        if not self.names():
            write_manifest(self.folder)
            # the first fact stands before any state, so that states without facts mean that facts are missing
            self.log.write(self.sessions.facts_of_older(self.sessions.older()))
        for folder in ("", "facts", "sessions", "refits", "merged", "remarks", "blind", "quarantine"):
            whole_file.take_away_leftovers(self.folder / folder)

    def names(self) -> set[str]:
        """Names of the files of facts. Raises RecordError where they or `archive.json` are missing."""
        names, manifest = self.log.names(), identity(self.folder)
        if names and not manifest:
            raise RecordError(
                f"{self.folder / MANIFEST}: is missing, though the archive is there; restore it from a copy"
            )
        if not names and self.sessions.has_any():
            raise RecordError(
                f"{self.log.folder}: is missing, and with it the archive's history; restore it from a copy, "
                "or remove sessions and merged too, and rig archive add makes them again"
            )
        return names

    def merge(self, *, at_once: int = 24) -> None:
        """Rewrite the merged file where at least so many facts are not in it."""
        names = self.names()
        loose = self.sessions.not_covered(self._newest(), names)
        if sum(max(len(entry.facts), 1) for entry in loose) >= at_once:
            rows = (
                self.connection(mending=True, whole=True, within=True)
                .sql("select * from all_rows")
                .to_arrow_table()
            )
            self.sessions.write_merged(rows, names)

    def merge_many(self) -> None:
        """Merge if so many facts are not in the merged file that reading them one by one takes long."""
        self.merge(at_once=MANY)

    def _newest(self) -> Any:
        """The merged file; none that is damaged, which the next one replaces."""
        newest = self.sessions.newest()
        try:
            return newest if newest is None or self.sessions.proved(newest) else None
        except RecordError:
            return None

    def connection(
        self, *, refits: bool = False, mending: bool = False, whole: bool = False, within: bool = False
    ) -> Any:
        """A DuckDB connection in which `runs` has the present row of every run; it can read nothing else.

        With `refits` the table of that name has a row for each result that was made again. `mending`, for who
        makes states again, leaves out those whose files are missing or damaged, unless the catalogue must be
        `whole`, and reads no damaged merged file. Only the archive itself reads
        what is hidden, from `within`.

        Raises ConfigurationError where nothing was added yet, RecordError where a file is damaged.
        """
        names = self.names()
        older = [] if names else self.sessions.facts_of_older(self.sessions.older())
        if not older and not any(self.log.entry(name).facts for name in names):
            raise ConfigurationError(
                f"{self.folder}: holds no sessions; rig archive add --archive {self.folder} DIR"
            )
        duckdb = duckdb_module()
        connection = duckdb.connect(config=CONFIG)
        newest = self._newest() if mending else self.sessions.newest() if names else None
        files = [] if newest is None else [str(newest.path if mending else self.sessions.proved(newest))]
        try:
            connection.execute("set variable merged = ?", [files[0] if files else ""])
            connection.execute(catalogue.NO_ROWS)
            connection.execute(catalogue.REMARKS, list(read_remarks(self.folder)))
            if newest is not None and newest.of == digest_of(names):
                connection.execute(catalogue.ALL_MERGED)
            else:
                entries = self.sessions.not_covered(newest, names) if names else [_as_entry(older)]
                self._with_loose(connection, entries, bool(files), mending and not whole)
            connection.execute(catalogue.VIEWS)
            if refits:
                files += self._with_refits(connection)
            seal, tables = sealed(self.folder), ("runs", "refits") if refits else ("runs",)
            keys = opened_keys(self.folder)
            if within or (seal is None and not keys):
                show_as_it_is(connection, tables)
            else:
                # what is stored must not be read beside what is shown
                keys += [seal.key] if seal is not None and seal.key is not None else []
                show_hidden(connection, tables, seal, keys)
                files = []
        except duckdb.Error as error:
            raise unreadable(self.folder, error) from None
        connection.execute("set allowed_paths = $files", {"files": files})
        connection.execute("set enable_external_access = false")
        connection.execute("set lock_configuration = true")
        return connection

    def refit_turn(self) -> int:
        """The largest turn of all results that were made again."""
        question = "select coalesce(max(turn), 0) from made"
        return int(self.connection(refits=True, within=True).execute(question).fetchone()[0])

    def _with_loose(self, connection: Any, entries: Sequence[Entry], merged: bool, mending: bool) -> None:
        """Define the rows where facts came after the merged file."""
        table, facts = facts_table(entries)
        connection.register("facts_read", table)
        connection.execute("create table loose_facts as select * from facts_read")
        connection.register("rows_read", self.sessions.rows(facts, mending=mending))
        connection.execute("create table loose_rows as select * from rows_read")
        connection.execute(catalogue.STATES)
        before = catalogue.SOME_MERGED if merged else catalogue.NONE_MERGED
        connection.execute(catalogue.NOT_ALL_MERGED.replace("MERGED", before))
        for name in ("facts_read", "rows_read"):
            connection.unregister(name)

    def _with_refits(self, connection: Any) -> list[str]:
        """Define the table `refits`; returns the files that it is read from."""
        self.refits.merge(at_once=MANY)
        newest = self.refits.newest()
        loose, there = self.refits.names(), sorted(self.refits.names())
        source = "select * from loose_refits"
        if newest is not None:
            merged = str(self.sessions.proved(newest))
            found = connection.execute("select version from read_parquet(?)", [merged]).fetchall()
            loose = loose - {name for (name,) in found}
            source = f"{source} union all by name select * from read_parquet('{_quoted(newest.path)}')"
        import pyarrow as pa

        tables = [
            table_of([], _REFIT_COLUMNS),
            *(self.refits.read(self.refits.path(n)) for n in sorted(loose)),
        ]
        connection.register("loose_read", pa.concat_tables(tables, promote_options="default"))
        connection.execute("create table loose_refits as select * from loose_read")
        connection.unregister("loose_read")
        connection.execute("set variable refits_there = ?", [there])
        connection.execute(catalogue.REFITS.replace("SOURCE", source))
        return [] if newest is None else [str(newest.path)]


def _as_entry(facts: Sequence[Fact]) -> Entry:
    return Entry("", 0, facts, "", "")


def duckdb_module() -> Any:
    """DuckDB. Raises ConfigurationError where it is not installed."""
    try:
        import duckdb
    except ImportError:
        raise MissingPackage("rig archive", "duckdb", "pyarrow") from None
    return duckdb


def reads_archive(function: Callable[Concatenate[Path, _P], _R]) -> Callable[Concatenate[Path, _P], _R]:
    """Say in a line what damage, or a condition that no row can meet, raises anywhere within the function.

    A query's rows are read when they are fetched, after the query itself was found sound.
    """

    @functools.wraps(function)
    def reading(archive: Path, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        duckdb = duckdb_module()
        try:
            return function(archive, *args, **kwargs)
        except duckdb.OutOfMemoryException as error:
            raise RecordError(f"{archive}: {_MEMORY} ({str(error).splitlines()[0]})") from None
        except (duckdb.ConversionException, duckdb.OutOfRangeException) as error:
            # as '45 %' is no number: found when the rows are read
            said = str(error).splitlines()[0].partition(": ")[2]
            raise ConfigurationError(
                f"condition or columns: {said}; docs/reference/archive.md lists the columns and their units"
            ) from None
        except duckdb.Error as error:
            raise unreadable(archive, error) from None

    return reading


def refit_shelf(archive: Path) -> Shelf:
    """Where results that were made again lie."""
    return Shelf(archive / "refits", archive / "merged", "refits", REFIT_SUFFIX, _read_refit_row)


def _read_refit_row(path: Path) -> Any:
    try:
        packed = without_frame(path, read_file(path))
        tree = json.loads(zstandard.ZstdDecompressor().decompress(packed))
        if f"{tree['version']}{REFIT_SUFFIX}" != path.name:
            raise ValueError(f"it is {tree['version']} under another name")
        row = {
            **tree["row"],
            "level": tree["level"],
            "laws": ", ".join(tree["laws"]),
            "settings": "; ".join(tree["settings"]),
            "code": tree["code"],
            "made_utc": datetime.datetime.fromisoformat(tree["made_utc"]),
            "turn": tree.get("turn", 0),
        }
    except (OSError, ValueError, KeyError, TypeError, zstandard.ZstdError) as error:
        raise unreadable(path, error, "refit") from None
    return table_of([row], _REFIT_COLUMNS)


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")
