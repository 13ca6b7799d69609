"""`rig archive add`, `update`, `check` and `refit`: the archive is brought up to date with its folders."""

import datetime
import hashlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, NamedTuple

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError, RigError, optional_module
from rig.analysis import analyse_record, chosen_laws, free_path, session_results, with_laws, write_results
from rig.archive.listing import (
    forget_sessions,
    hash_condition,
    open_for_reading,
    open_for_writing,
    query_runs,
    require_archive,
    write_sessions,
)
from rig.archive.session_rows import session_rows
from rig.instrument import code_identity, recorded_configuration
from rig.terminal import say
from rig.view import analyse_replayed

_WRITE_INTERVAL_S = 5.0
"""Interval of writes: a kill loses at most this much of what was read."""
_COMPARED = ("folder", "record", "run", "sha256", "state", "results", "results_sha256")


def add_folders(archive: Path, folders: Sequence[Path], *, read: bool = False) -> str:
    """Add folders to the archive and read all sessions in and below them; returns counts as a line of text.

    Raises ConfigurationError for a folder without sessions, else like `update_archive`.
    """
    if archive.is_dir():
        require_archive(archive)
    roots = list(dict.fromkeys(folder.resolve() for folder in folders))
    for root in roots:
        if next(sessions_below(root, []), None) is None:
            raise ConfigurationError(f"{root}: holds no session (no record, no results.json) in any folder")
    with open_for_writing(archive) as connection:
        for root in roots:
            connection.execute("insert or ignore into folders values (?)", [str(root)])
    return update_archive(archive, roots, read=read)


def update_archive(archive: Path, folders: Sequence[Path] | None = None, *, read: bool = False) -> str:
    """Read new and changed sessions in and below folders, by default all that were added.

    A session whose files have the same names, sizes and times is read again only if `read`. Rows of
    folders that are unavailable now stay. Flaws of records are printed on stderr and stored as `state`.
    Returns counts as a line of text.

    Raises RecordError, after all other sessions are written, if a session's files cannot be read.
    """
    require_archive(archive)
    with open_for_writing(archive) as connection:
        known = dict(connection.execute("select folder, files from sessions").fetchall())
        added = connection.execute("select folder from folders order by folder").fetchall()
    all_roots = {Path(folder) for (folder,) in added} if folders is None else {*folders}
    roots = sorted(root for root in all_roots if all_roots.isdisjoint(root.parents))
    present, unavailable, unreadable = set[str](), list[Path](), list[Path]()
    sessions, rows = dict[str, str](), list[dict[str, Any]]()
    read_sessions, read_runs, written_s = 0, 0, time.monotonic()
    for folder, files in (session for root in roots for session in sessions_below(root, unavailable)):
        present.add(str(folder))
        if not read and known.get(str(folder)) == files:
            continue
        try:
            new_rows, flaws = session_rows(folder)
        except RecordError as error:
            say(f"{error}; {folder} stays as it was in the archive")
            unreadable.append(folder)
            continue
        for flaw in flaws:
            say(flaw)
        now = datetime.datetime.now(datetime.UTC).replace(tzinfo=None)
        rows += [row | {"folder": str(folder), "added_utc": now} for row in new_rows]
        # the hash tells no change of a record outside the folder, so such a folder is read each time
        has_own_records = not any(Path(row["record"]).is_absolute() for row in new_rows)
        sessions[str(folder)] = files if has_own_records else ""
        read_sessions, read_runs = read_sessions + 1, read_runs + len(new_rows)
        if time.monotonic() - written_s > _WRITE_INTERVAL_S:
            with open_for_writing(archive) as connection:
                write_sessions(connection, sessions, rows)
            sessions, rows, written_s = {}, [], time.monotonic()
    for path in unavailable:
        say(f"{path}: is not here or cannot be read; what the archive has of it stays")
    ancestors = {name: {Path(name), *Path(name).parents} for name in known.keys() - present}
    removed = [
        name
        for name, folders_above in ancestors.items()
        if folders_above.isdisjoint(unavailable) and not folders_above.isdisjoint(roots)
    ]
    if sessions or removed:
        with open_for_writing(archive) as connection:
            forget_sessions(connection, removed)
            write_sessions(connection, sessions, rows)
    counts = (
        f"{read_sessions} session{'' if read_sessions == 1 else 's'} read "
        f"({read_runs} run{'' if read_runs == 1 else 's'}), "
        f"{len(present) - read_sessions - len(unreadable)} unchanged, {len(removed)} gone"
    )
    if unreadable:
        raise RecordError(
            f"{len(unreadable)} sessions cannot be read and stay as they were, the first is "
            f"{unreadable[0]}; {counts}"
        )
    return counts


def sessions_below(root: Path, unavailable: list[Path]) -> Iterator[tuple[Path, str]]:
    """Folders with records or results in and below a root, with a hash of names, sizes and times of files.

    Folders that cannot be read are appended to `unavailable`.
    """
    folders = [str(root)]
    while folders:
        folder = folders.pop()
        files, subfolders, is_session = [], [], False
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    name = entry.name
                    if entry.is_dir(follow_symlinks=False):
                        subfolders.append(entry.path)
                    elif name.endswith((".mcap", ".json")) and entry.is_file():
                        status = entry.stat()
                        files.append(f"{name}\0{status.st_size}\0{status.st_mtime_ns}")
                        is_session |= name.endswith(".mcap") or name.startswith("results")
        except OSError:
            unavailable.append(Path(folder))
            continue
        folders += sorted(subfolders, reverse=True)
        if is_session:
            yield Path(folder), hashlib.sha256("\n".join(sorted(files)).encode()).hexdigest()


def check_archive(archive: Path) -> int:
    """Read every session again, compare hashes and print differences; returns 1 if there are any, else 0."""
    with open_for_reading(archive) as connection:
        stored = connection.execute(f"select {', '.join(_COMPARED)} from every_run order by all").fetchall()
    differences, reported_s = 0, time.monotonic()
    for folder, rows in groupby(stored, key=lambda row: str(row[0])):
        for line in _differences(Path(folder), [row[1:] for row in rows]):
            print(line)
            differences += 1
        if time.monotonic() - reported_s > _WRITE_INTERVAL_S:
            reported_s = time.monotonic()
            say(f"read up to {folder}")
    print(f"{len(stored)} runs read, {differences} differences")
    return 1 if differences else 0


def _differences(folder: Path, rows: Sequence[tuple[Any, ...]]) -> Iterator[str]:
    try:
        present = {(row["record"], row["run"]): row for row in session_rows(folder)[0]}
    except RecordError as error:
        yield str(error)
        return
    changed = dict[str, None]()
    for record, run, sha256, state, results, results_sha256 in rows:
        path, row = folder / record, present.get((record, run))
        if row is None or (row["state"] == "missing" and state != "missing"):
            yield f"{path}: is not there any more"
            continue
        if row["state"] != state:
            yield f"{path}: was {state} and is {row['state']}: {row['flaw']}"
        elif row["sha256"] != sha256:
            yield f"{path}: has other bytes than when it was read; rig archive update --read"
        if results and (row["results"], row["results_sha256"]) != (results, results_sha256):
            changed[results] = None
    yield from (f"{folder / name}: has changed since it was read; rig archive update" for name in changed)


Level = Literal["swings", "spots", "pixels"]
"""What a refit begins with: recorded half-cycles, recorded spots, or recorded pixels."""
_PROGRESS_INTERVAL = 100
"""Number of sessions from one report of the progress to the next."""
_MAX_WORKER_WAIT_S = 10
_RECORDS_SQL = """
select folder, record, sha256 from every_run
where ends_with(record, '.mcap') and state not in ('missing', 'unreadable')
  and folder in (select folder from chosen)
order by folder, began_utc, record
"""
"""Query of all records of the sessions of the chosen runs."""


class RefitTask(NamedTuple):
    """The records of one session to be fitted again, each with its SHA-256."""

    folder: Path
    records: tuple[tuple[Path, str], ...]
    level: Level
    laws: tuple[str, ...]
    settings: tuple[str, ...]


Work = Callable[[RefitTask], str]
"""Function that carries out a task and returns why it failed, or empty text."""


def refit(task: RefitTask) -> str:
    """Fit the records of one session and write a new results file; returns why it failed, or empty text."""
    try:
        for record, sha256 in task.records:
            if sha256_of(record) != sha256:
                return f"{record}: has changed since it was read; rig archive update"
        runs = [
            analyse_record(record, task.settings)
            if task.level == "swings"
            else analyse_replayed(record, retrack=task.level == "pixels", overrides=task.settings)
            for record, _ in task.records
        ]
        if task.laws:
            runs = [with_laws(run, chosen_laws(task.laws)) for run in runs]
        write_results(free_path(task.folder), session_results(runs, task.folder))
    except RigError as error:
        return str(error)
    return ""


def refit_runs(
    archive: Path,
    names: Sequence[str],
    where: str,
    level: Level,
    *,
    laws: Sequence[str] = (),
    settings: Sequence[str] = (),
    cluster: str = "",
    processes: int | None = None,
) -> int:
    """Fit the sessions again whose runs are named or meet a condition (neither: all sessions with records).

    Each session gets a new results file next to its records, as by `rig fit`, and new rows in the archive.
    Returns the exit status: 1 if a session could not be fitted, else 0. An unknown law or setting raises
    ConfigurationError before anything is made.
    """
    chosen_laws(laws)
    if names and where:
        raise ConfigurationError(f"--where {where!r}: has no effect beside {names[0]}; leave out one")
    records = dict[str, list[tuple[Path, str]]]()
    condition = where or hash_condition(archive, names)
    for folder, record, sha256 in query_runs(archive, "*", condition, _RECORDS_SQL)[1]:
        records.setdefault(folder, []).append((Path(folder) / record, sha256))
    options = (level, tuple(laws), tuple(settings))
    tasks = [RefitTask(Path(folder), tuple(paths), *options) for folder, paths in records.items()]
    if tasks and settings:
        # an unknown setting is refused once, not by every session
        with RecordReader(tasks[0].records[0][0]) as reader:
            recorded_configuration(reader, settings)
    fitted, failed_count = list[Path](), 0
    outcomes = _on_cluster(refit, tasks, cluster) if cluster else _in_processes(refit, tasks, processes)
    try:
        for done, (task, problem) in enumerate(outcomes, start=1):
            if problem:
                failed_count += 1
                say(problem if str(task.folder) in problem else f"{task.folder}: {problem}")
            else:
                fitted.append(task.folder)
            if done % _PROGRESS_INTERVAL == 0:
                say(f"{done} of {len(tasks)} sessions")
    finally:
        update_archive(archive, fitted)
    print(f"{len(fitted)} sessions fitted again, {failed_count} left as they were")
    return 1 if failed_count else 0


def _in_processes(
    work: Work, tasks: Sequence[RefitTask], processes: int | None
) -> Iterator[tuple[RefitTask, str]]:
    """Carry out tasks in processes of this machine; yields each with its problem, empty if it succeeded."""
    # each process is to use one processor: libraries that read this variable start no threads
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # a fork would copy locks held by threads of this process
    context, unfinished = get_context("spawn"), list[RefitTask]()
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        for task, future in _completed(pool, work, tasks):
            # a process that dies breaks the whole pool: what is unfinished is tried again, each task alone
            if isinstance(future.exception(), BrokenProcessPool):
                unfinished.append(task)
            else:
                yield task, _problem(future)
    for task in unfinished:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            yield task, _problem(pool.submit(work, task))


def _completed(
    executor: Executor, work: Work, tasks: Sequence[RefitTask]
) -> Iterator[tuple[RefitTask, Future[str]]]:
    futures = {executor.submit(work, task): task for task in tasks}
    for future in as_completed(futures):
        yield futures[future], future


def _problem(future: Future[str]) -> str:
    error = future.exception()
    if isinstance(error, BrokenProcessPool):
        return "its process was ended, also when it ran alone"
    # an unexpected error in one session must not stop the others
    return future.result() if error is None else f"failed: {error!r}"


def _on_cluster(work: Work, tasks: Sequence[RefitTask], address: str) -> Iterator[tuple[RefitTask, str]]:
    """Carry out tasks on a running Dask cluster, whose workers see the same files under the same names."""
    distributed = optional_module("distributed", "--cluster", "distributed", "series")
    try:
        client = distributed.Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigurationError(f"--cluster {address}: no Dask scheduler answers there: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_MAX_WORKER_WAIT_S)
        except TimeoutError:
            raise ConfigurationError(
                f"--cluster {address}: it has no worker; dask worker {address} adds one"
            ) from None
        codes, own = client.run(code_identity), code_identity()
        if other := next((worker for worker, code in codes.items() if code != own), None):
            raise ConfigurationError(
                f"--cluster {address}: {other} runs other code ({codes[other]}) than this program ({own})"
            )
        for task, future in _completed(client.get_executor(pure=False), work, tasks):
            yield task, _problem(future)
