"""`rig archive add`: sessions found below folders, each into a file of its own in the archive."""

import hashlib
import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.record.proof import Thinning
from processing.errors import ConfigurationError
from rig.archive.store import Archive, duckdb_module
from rig.presentation import say

if TYPE_CHECKING:
    from rig.archive.session_rows import Row


def add_sessions(archive: Path, sources: Sequence[Path], *, read: bool = False) -> str:
    """Add every session below the folders; returns a line that counts them.

    A session whose files are as they were by name, size and time is not read, unless `read`.

    A session is known by the SHA-256 of its records: added again it changes nothing, with new results or
    records it becomes a new version. Flaws of records are said on stderr and listed as their `state`.

    Raises ConfigurationError for a folder without sessions, and without DuckDB.
    """
    duckdb_module()
    # reading results takes seconds to import, which `list` must not wait for
    from rig.archive.session_rows import now_utc, session_rows

    store, computer = Archive(archive), platform.node()
    known = store.versions()
    unchanged = set() if read else store.known_files(computer)
    added = runs = before = 0
    seen: set[str] = set()
    for source in {source.resolve(): source for source in sources}.values():
        folders = list(session_folders(source, archive))
        if not folders:
            raise ConfigurationError(f"{source}: holds no session (no record, no results.json) in any folder")
        for folder in folders:
            files = _files(folder)
            if (str(folder), files) in unchanged:
                before += 1
                continue
            found = session_rows(folder)
            for flaw in found.flaws:
                say(flaw)
            if not found.rows:
                continue
            states = sorted(_state(row) for row in found.rows)
            place = (computer, str(folder), found.results_sha256, *states)
            name = f"{found.session[:16]}-{hashlib.sha256(chr(0).join(place).encode()).hexdigest()[:16]}"
            inside = not any(Path(row["record"]).is_absolute() for row in found.rows)
            more = {"folder": str(folder), "computer": computer, "added_utc": now_utc(), "version": name}
            more["files"] = files if inside else None
            if name in known or not store.add(name, [row | more for row in found.rows]):
                before += 1
                continue
            known.add(name)
            added, runs = added + 1, runs + len(found.rows)
            seen.update(row["sha256"] for row in found.rows)
            if added % 256 == 0:
                store.merge_many()
    store.merge()
    again = runs - len(seen)
    twice = f", {again} of them in more than one session and listed once" if again else ""
    return f"{added} sessions added ({runs} runs{twice}), {before} known already"


def _state(row: "Row") -> str:
    """What makes another version of a session: another record, another state of it, fewer pixels."""
    thinned = [row["windows"]] if row.get("windows") in set(Thinning) else []
    return " ".join([row["sha256"], row["state"], *thinned])


def _files(folder: Path) -> str:
    """Hash of names, sizes and times of a session's files, as far as `add` reads them."""
    found = sorted(
        f"{entry.name}\0{entry.stat().st_size}\0{entry.stat().st_mtime_ns}"
        for entry in os.scandir(folder)
        if entry.name.endswith((".mcap", ".json")) and entry.is_file()
    )
    return hashlib.sha256("\n".join(found).encode()).hexdigest()


def session_folders(source: Path, archive: Path) -> Iterator[Path]:
    """Folders with records or results in and below one, in order; never those of the archive itself."""
    own = archive.resolve()
    for name, folders, files in os.walk(source.resolve()):
        folder = Path(name)
        folders[:] = sorted(inner for inner in folders if folder / inner != own)
        if any(
            file.endswith(".mcap") or (file.startswith("results") and file.endswith(".json"))
            for file in files
        ):
            yield folder
