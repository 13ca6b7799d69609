"""`rig archive add`, `update` and `check`: what folders hold now, and whether it is what the archive says."""

import datetime
import hashlib
import os
import time
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError, RecordError
from rig.archive.catalogue import check_is_there, forget_sessions, reading, write_sessions, writing
from rig.presentation import say

_WRITTEN_EVERY_S = 5.0
"""So much of what was read is lost to a kill at most."""
_COMPARED = ("folder", "record", "run", "sha256", "state", "results", "results_sha256")


def add_folders(archive: Path, folders: Sequence[Path], *, read: bool = False) -> str:
    """Remember folders, and update what is in and below them; returns a line that counts.

    Raises ConfigurationError for a folder without sessions, and as `update_archive` does.
    """
    if archive.is_dir():
        check_is_there(archive)
    roots = list(dict.fromkeys(folder.resolve() for folder in folders))
    for root in roots:
        if not any(True for _ in sessions_below(root, [])):
            raise ConfigurationError(f"{root}: holds no session (no record, no results.json) in any folder")
    with writing(archive) as connection:
        for root in roots:
            connection.execute("insert or ignore into folders values (?)", [str(root)])
    return update_below(archive, roots, read=read)


def update_archive(archive: Path, *, read: bool = False) -> str:
    """Read what is new or has changed in all folders that were added; returns a line that counts.

    A session whose files are as they were by name, size and time is not read, unless `read`. What lies in
    folders that are not here now stays as it is. Flaws of records are said on stderr and listed as `state`.

    Raises RecordError, when all others are written, where a session's files cannot be read.
    """
    check_is_there(archive)
    return update_below(archive, None, read=read)


def update_below(archive: Path, folders: Sequence[Path] | None, *, read: bool = False) -> str:
    """The same for what lies in and below some folders; None: those that were added."""
    with writing(archive) as connection:
        known = dict(connection.execute("select folder, files from sessions").fetchall())
        added = connection.execute("select folder from folders order by folder").fetchall()
    all_roots = {Path(folder) for (folder,) in added} if folders is None else {*folders}
    roots = sorted(root for root in all_roots if all_roots.isdisjoint(root.parents))
    seen, hidden, unread = set[str](), list[Path](), list[Path]()
    sessions, rows = dict[str, str](), list[dict[str, Any]]()
    read_sessions = read_runs = 0
    written_s = time.monotonic()
    for folder, files in (session for root in roots for session in sessions_below(root, hidden)):
        seen.add(str(folder))
        if not read and known.get(str(folder)) == files:
            continue
        # takes a second to import, for which an update that finds nothing must not wait
        from rig.archive.session_rows import session_rows

        try:
            found = session_rows(folder)
        except RecordError as error:
            say(f"{error}; {folder} stays as it was in the archive")
            unread.append(folder)
            continue
        for flaw in found.flaws:
            say(flaw)
        now = datetime.datetime.now(datetime.UTC).replace(tzinfo=None)
        rows += [row | {"folder": str(folder), "added_utc": now} for row in found.rows]
        # a record that lies elsewhere changes unseen: such a folder is read each time
        inside = not any(Path(row["record"]).is_absolute() for row in found.rows)
        sessions[str(folder)] = files if inside else ""
        read_sessions, read_runs = read_sessions + 1, read_runs + len(found.rows)
        if time.monotonic() - written_s > _WRITTEN_EVERY_S:
            with writing(archive) as connection:
                write_sessions(connection, sessions, rows)
            sessions, rows, written_s = {}, [], time.monotonic()
    for name in hidden:
        say(f"{name}: is not here or cannot be read; what the archive has of it stays")
    gone = [
        name
        for name in known.keys() - seen
        if not (above := {Path(name), *Path(name).parents}).isdisjoint(roots) and above.isdisjoint(hidden)
    ]
    if sessions or gone:
        with writing(archive) as connection:
            forget_sessions(connection, gone)
            write_sessions(connection, sessions, rows)
    told = (
        f"{read_sessions} session{'' if read_sessions == 1 else 's'} read "
        f"({read_runs} run{'' if read_runs == 1 else 's'}), "
        f"{len(seen) - read_sessions - len(unread)} unchanged, {len(gone)} gone"
    )
    if unread:
        raise RecordError(
            f"{len(unread)} sessions cannot be read and stay as they were, the first is {unread[0]}; {told}"
        )
    return told


def sessions_below(root: Path, hidden: list[Path]) -> Iterator[tuple[Path, str]]:
    """Folders with records or results in and below one, with a hash of names, sizes and times of their files.

    Folders that cannot be looked into are appended to `hidden`.
    """
    waiting = [str(root)]
    while waiting:
        folder = waiting.pop()
        files, inner, is_session = [], [], False
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    name = entry.name
                    if entry.is_dir(follow_symlinks=False):
                        inner.append(entry.path)
                    elif name.endswith((".mcap", ".json")) and entry.is_file():
                        status = entry.stat()
                        files.append(f"{name}\0{status.st_size}\0{status.st_mtime_ns}")
                        is_session |= name.endswith(".mcap") or name.startswith("results")
        except OSError:
            hidden.append(Path(folder))
            continue
        waiting += sorted(inner, reverse=True)
        if is_session:
            yield Path(folder), hashlib.sha256("\n".join(sorted(files)).encode()).hexdigest()


def check_archive(archive: Path) -> int:
    """Read every session again and compare hashes; prints what differs, returns 1 where something does."""
    with reading(archive) as connection:
        stored = connection.execute(f"select {', '.join(_COMPARED)} from every_run order by all").fetchall()
    different, said_s = 0, time.monotonic()
    for folder, rows in groupby(stored, key=lambda row: str(row[0])):
        for line in _differences(Path(folder), [row[1:] for row in rows]):
            print(line)
            different += 1
        if time.monotonic() - said_s > _WRITTEN_EVERY_S:
            said_s = time.monotonic()
            say(f"read up to {folder}")
    print(f"{len(stored)} runs read, {different} differences")
    return 1 if different else 0


def _differences(folder: Path, rows: Sequence[tuple[Any, ...]]) -> Iterator[str]:
    from rig.archive.session_rows import session_rows

    try:
        now = {(row["record"], row["run"]): row for row in session_rows(folder).rows}
    except RecordError as error:
        yield str(error)
        return
    changed = dict[str, None]()
    for record, run, sha256, state, results, results_sha256 in rows:
        path, found = folder / record, now.get((record, run))
        if found is None or (found["state"] == "missing" and state != "missing"):
            yield f"{path}: is not there any more"
            continue
        if found["state"] != state:
            yield f"{path}: was {state} and is {found['state']}: {found['flaw']}"
        elif found["sha256"] != sha256:
            yield f"{path}: has other bytes than when it was read; rig archive update --read"
        if results and (found["results"], found["results_sha256"]) != (results, results_sha256):
            changed[results] = None
    yield from (f"{folder / name}: has changed since it was read; rig archive update" for name in changed)
