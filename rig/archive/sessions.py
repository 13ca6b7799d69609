"""States of sessions, a Parquet file each in `sessions/`, and the merged file that says which hold now.

A file is named after its content. Nothing in it says where a session lies, or when: that is what facts say.
"""

import datetime
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from acquisition.record import whole_file
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.archive.columns import COLUMNS
from rig.archive.facts import Entry, Fact, FactLog, covered, newest_numbers
from rig.archive.proved import NAMED_CHARACTERS, check_name, read_file, sha256_hex
from rig.archive.shelf import Merged, as_parquet, digest_of, newest_merged, table_of, unreadable, write_merged
from rig.presentation import say

KIND = "present"
"""Of the merged file: `merged/present-NUMBER-DIGEST-SHA256.parquet`."""
_SUFFIX = ".parquet"
_NAME = re.compile(rf"[0-9a-f]{{16}}-[0-9a-f]{{{NAMED_CHARACTERS}}}\.parquet")
_OLDER_NAME = re.compile(r"[0-9a-f]{16}-[0-9a-f]{16}\.parquet")
OF_PLACES = ("computer", "folder", "files", "added_utc", "version")
"""Columns that facts decide."""
OF_FACTS = {"file_sha256": "varchar", "turn": "bigint", "writer": "varchar", "place": "bigint"}
"""Further columns of a fact, by which the last one is known."""


class Sessions:
    """The folder `sessions/` of an archive, and its merged file."""

    def __init__(self, archive: Path, log: FactLog) -> None:
        self.folder, self.merged_folder, self._log = archive / "sessions", archive / "merged", log

    def write(self, session: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
        """Write a state of a session; returns its name and its SHA-256. One that is there stays."""
        kept = [name for name in COLUMNS if name not in OF_PLACES]
        data = as_parquet(table_of(rows, {name: COLUMNS[name] for name in kept}))
        sha256 = sha256_hex(data)
        name = f"{session[:16]}-{sha256[:NAMED_CHARACTERS]}"
        path = self.path(name)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            whole_file.write_new(path, data)
        except FileExistsError:
            if read_file(path) != data:
                say(f"{path}: was damaged and is written again")
                whole_file.replace(path, data)
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be written: {error.strerror or error}") from None
        return name, sha256

    def path(self, name: str) -> Path:
        """The file of a state."""
        return self.folder / f"{name}{_SUFFIX}"

    def names(self) -> set[str]:
        """Names of all states, those of earlier versions of the program included."""
        return {name.removesuffix(_SUFFIX) for name in self._files() if not name.startswith(".")}

    def older(self) -> list[str]:
        """Names of states that an earlier version wrote, which say themselves where they were seen."""
        return sorted(
            name.removesuffix(_SUFFIX) for name in self._files() if _OLDER_NAME.fullmatch(name) is not None
        )

    def has_any(self) -> bool:
        """Whether there is a state that facts must speak of."""
        return any(_NAME.fullmatch(name) for name in self._files()) or self.newest() is not None

    def _files(self) -> list[str]:
        try:
            return [entry.name for entry in os.scandir(self.folder) if entry.name.endswith(_SUFFIX)]
        except FileNotFoundError:
            return []
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be read: {error.strerror or error}") from None

    def facts_of_older(self, names: Iterable[str]) -> list[Fact]:
        """What states of an earlier version say of where they were seen, in the order of its clocks."""
        found = []
        for name in names:
            data = read_file(self.path(name))
            rows = self._table(name, data, sha256_hex(data)).select(list(OF_PLACES)).to_pylist()
            first = rows[0]
            added = (first["added_utc"] or datetime.datetime.min).isoformat()
            fact = Fact(
                first["computer"] or "",
                first["folder"] or "",
                name,
                sha256_hex(data),
                first["files"] or "",
                added,
            )
            found.append((added, name, fact))
        return [fact for _, _, fact in sorted(found)]

    def newest(self) -> Merged | None:
        """The merged file with the highest number."""
        return newest_merged(self.merged_folder, KIND)

    def proved(self, merged: Merged) -> Path:
        """A merged file whose bytes are as they were written. Raises RecordError."""
        if not sha256_of(merged.path).startswith(merged.sha256):
            raise unreadable(merged.path, "its bytes have changed")
        return merged.path

    def rows(self, facts: Sequence[Fact], *, mending: bool = False) -> Any:
        """The rows of the states that facts name, each proved, with the column `version`.

        Left out are those that are missing or damaged and have been followed by another one, or all such with
        `mending`. Raises RecordError.
        """
        import pyarrow as pa

        states = {fact.version: fact.sha256 for fact in facts}
        present = set({(fact.computer, fact.folder): fact.version for fact in facts}.values())
        tables = [table_of([])]
        for name, sha256 in states.items():
            try:
                tables.append(self._table(name, self._state(name), sha256))
            except RecordError:
                if name in present and not mending:
                    raise
        return pa.concat_tables(tables, promote_options="default")

    def _state(self, name: str) -> bytes:
        path = self.path(name)
        if not path.exists():
            raise RecordError(f"{path}: is missing; rig archive add of its session's folder makes it again")
        return read_file(path)

    def _table(self, name: str, data: bytes, sha256: str) -> Any:
        import pyarrow as pa
        from pyarrow import parquet

        path = self.path(name)
        if sha256_hex(data) != sha256:
            raise unreadable(path, "its bytes have changed")
        if _NAME.fullmatch(path.name):
            check_name(path, data)
        try:
            # several times faster for a small file than `read_table`, which starts threads
            reader = parquet.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
            table = reader.read(use_threads=False)
        except (pa.ArrowInvalid, OSError) as error:
            raise unreadable(path, error) from None
        if "version" in table.column_names:
            return table
        return table.append_column("version", pa.array([name] * len(table), pa.string()))

    def write_merged(self, rows: Any, names: set[str]) -> None:
        """Write a merged file of all rows, with `now` and `listed`, as these files of facts have them."""
        covers = json.dumps(newest_numbers(names))
        write_merged(
            self.merged_folder, KIND, digest_of(names), rows.replace_schema_metadata({"covers": covers})
        )

    def not_covered(self, merged: Merged | None, names: set[str]) -> list[Entry]:
        """The files of facts, in order, that are not in a merged file."""
        if merged is None:
            return self._log.entries(names)
        from pyarrow import parquet

        metadata = parquet.read_schema(merged.path).metadata or {}
        return self._log.entries(names - covered(names, json.loads(metadata[b"covers"])))


def facts_table(entries: Iterable[Entry]) -> tuple[Any, list[Fact]]:
    """The last fact of each state in each folder as a table of what it decides, and as facts."""
    import pyarrow as pa

    last: dict[tuple[str, str, str], tuple[Fact, int, str, int]] = {}
    for entry in entries:
        for place, fact in enumerate(entry.facts):
            # taken out first, so that the order stays that in which they hold
            last.pop((fact.computer, fact.folder, fact.version), None)
            last[fact.computer, fact.folder, fact.version] = (fact, entry.turn, entry.name, place)
    found = list(last.values())
    columns = {
        "computer": pa.array([fact.computer for fact, *_ in found], pa.string()),
        "folder": pa.array([fact.folder for fact, *_ in found], pa.string()),
        "version": pa.array([fact.version for fact, *_ in found], pa.string()),
        "files": pa.array([fact.files or None for fact, *_ in found], pa.string()),
        "added_utc": pa.array(
            [datetime.datetime.fromisoformat(fact.seen_utc) for fact, *_ in found], pa.timestamp("us")
        ),
        "file_sha256": pa.array([fact.sha256 for fact, *_ in found], pa.string()),
        "turn": pa.array([turn for _, turn, _, _ in found], pa.int64()),
        "writer": pa.array([writer for _, _, writer, _ in found], pa.string()),
        "place": pa.array([place for *_, place in found], pa.int64()),
    }
    return pa.table(columns), [fact for fact, *_ in found]
