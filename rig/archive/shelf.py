"""A folder of small files, each written once, whole or not at all, and one file that holds the rows of all.

Nobody waits for a lock: two processes that write at once write different files, or the same one. The merged
file holds the same rows again, for speed: deleted, it is made again. Its name says of which files it is.
"""

import contextlib
import hashlib
import io
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from acquisition.record import whole_file
from processing.errors import RecordError
from rig.archive.columns import COLUMNS, Column
from rig.archive.proved import NAMED_CHARACTERS, read_file, sha256_hex

MANY = 256
"""Files beside the merged one from which on they are merged while more are written."""
_FEW = 24
_KEPT = 2
"""Merged files that are kept: somebody may be reading the one before."""


SQL_TYPES: Final = {
    "text": "varchar",
    "number": "double",
    "count": "bigint",
    "yes or no": "boolean",
    "time": "timestamp",
}
"""Of the kinds of columns."""


class Merged(NamedTuple):
    """A merged file, and `of`, which says of which files it holds the rows (see `digest_of`)."""

    path: Path
    number: int
    of: str
    sha256: str


@dataclass(frozen=True)
class Shelf:
    """Files `NAME.suffix` in `folder`, and `kind-NUMBER-DIGEST-SHA256.parquet` in `merged`.

    `read` gives the rows of one file as an Arrow table whose column `version` is the file's name.
    """

    folder: Path
    merged: Path
    kind: str
    suffix: str
    read: Callable[[Path], Any]

    def path(self, name: str) -> Path:
        return self.folder / f"{name}{self.suffix}"

    def write(self, name: str, data: bytes) -> bool:
        """Write a file; False if it is there already. Raises RecordError where it cannot be written."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            whole_file.write_new(self.path(name), data)
        except FileExistsError:
            return False
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be written: {error.strerror or error}") from None
        return True

    def names(self) -> set[str]:
        """Names of all files, without their ending."""
        try:
            return {
                entry.name.removesuffix(self.suffix)
                for entry in os.scandir(self.folder)
                if entry.name.endswith(self.suffix) and not entry.name.startswith(".")
            }
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise RecordError(f"{self.folder}: cannot be read: {error.strerror or error}") from None

    def merge(self, *, at_once: int = _FEW) -> None:
        """Rewrite the merged file where at least so many files are not in it."""
        import pyarrow as pa

        for folder in (self.folder, self.merged):
            whole_file.take_away_leftovers(folder)
        newest = self.newest()
        there = self.names()
        tables = []
        if newest is not None:
            with contextlib.suppress(RecordError):
                old = read_merged(newest)
                tables.append(old.filter(pa.array([name in there for name in old["version"].to_pylist()])))
        merged = set(tables[0]["version"].to_pylist()) if tables else set()
        loose = sorted(there - merged)
        if len(loose) < at_once:
            return
        tables += [self.read(self.path(name)) for name in loose]
        write_merged(
            self.merged, self.kind, digest_of(there), pa.concat_tables(tables, promote_options="default")
        )

    def newest(self) -> Merged | None:
        """The merged file with the highest number."""
        return newest_merged(self.merged, self.kind)


def newest_merged(folder: Path, kind: str) -> Merged | None:
    """The merged file of a kind with the highest number."""
    found = [
        Merged(path, int(parts[1]), parts[2], parts[3])
        for path in folder.glob(f"{kind}-*.parquet")
        if (parts := re.fullmatch(rf"{kind}-(\d+)-(\w+)-(\w+)\.parquet", path.name))
    ]
    return max(found, key=lambda merged: merged[1:], default=None)


def read_merged(merged: Merged) -> Any:
    """The rows of a merged file. Raises RecordError where its bytes are not as they were written."""
    import pyarrow as pa
    from pyarrow import parquet

    data = read_file(merged.path)
    if not sha256_hex(data).startswith(merged.sha256):
        raise unreadable(merged.path, "its bytes have changed")
    try:
        return parquet.ParquetFile(pa.BufferReader(data), page_checksum_verification=True).read()
    except (pa.ArrowInvalid, OSError) as error:
        raise unreadable(merged.path, error) from None


def write_merged(folder: Path, kind: str, of: str, rows: Any) -> None:
    """Write the next merged file of a kind; the last but one, and what earlier versions wrote, goes."""
    newest = newest_merged(folder, kind)
    number = 1 if newest is None else newest.number + 1
    data = as_parquet(rows)
    name = f"{kind}-{number:08d}-{of}-{sha256_hex(data)[:NAMED_CHARACTERS]}.parquet"
    try:
        folder.mkdir(exist_ok=True)
        whole_file.take_away_leftovers(folder)
        # another process that was faster has merged the same files
        with contextlib.suppress(FileExistsError):
            whole_file.write_new(folder / name, data)
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    current = sorted(folder.glob(f"{kind}-*-*-*.parquet"))
    for old in {*folder.glob(f"{kind}-*.parquet"), *folder.glob("runs-*.parquet")} - set(current[-_KEPT:]):
        old.unlink(missing_ok=True)


def digest_of(names: Iterable[str]) -> str:
    """Says of which files a merged file holds the rows."""
    return hashlib.sha256("\0".join(sorted(names)).encode()).hexdigest()[:16]


def unreadable(path: Path, error: object, command: str = "add") -> RecordError:
    """That a derived file is damaged, and what makes it again."""
    text = (str(error).splitlines() or [type(error).__name__])[0]
    # of the archive itself nobody shall be advised to delete it: tags and notes follow from nothing else
    derived = re.findall(r"[\w.-]+\.(?:parquet|json\.zst)", f"{path.name} {text}")
    remedy = f"delete {derived[-1]}, rig archive {command} makes it again" if derived else "see --debug"
    return RecordError(f"{path}: cannot be read: {text}; {remedy}")


def table_of(rows: Iterable[Mapping[str, Any]], columns: Mapping[str, Column] = COLUMNS) -> Any:
    """Rows by the names of columns as an Arrow table; what a row lacks is null."""
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


def as_parquet(table: Any) -> bytes:
    """An Arrow table as the bytes of a Parquet file, each page with a checksum."""
    from pyarrow import parquet

    data = io.BytesIO()
    parquet.write_table(table, data, compression="zstd", write_page_checksum=True)
    return data.getvalue()
