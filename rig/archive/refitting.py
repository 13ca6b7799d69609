"""`rig archive refit`: sessions fitted again, in processes of this machine or on a cluster."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, NamedTuple

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RigError
from rig.analysis import (
    AnalysedRun,
    analyse_record,
    chosen_laws,
    free_path,
    session_results,
    with_laws,
    write_results,
)
from rig.archive.listing import meant, selected
from rig.archive.updating import update_below
from rig.instrument import code_identity, recorded_configuration
from rig.presentation import say
from rig.replay import analyse_replayed

Level = Literal["swings", "spots", "pixels"]
_SAID_EVERY = 100
_WORKER_WITHIN_S = 10
_RECORDS = """
select folder, record, sha256 from every_run
where ends_with(record, '.mcap') and state not in ('missing', 'unreadable')
  and folder in (select folder from chosen)
order by folder, began_utc, record
"""
"""Of the sessions of the runs that are meant."""


class Task(NamedTuple):
    """The records of one session, each with its SHA-256, to be fitted again."""

    folder: Path
    records: tuple[tuple[Path, str], ...]
    level: Level
    laws: tuple[str, ...]
    settings: tuple[str, ...]


Work = Callable[[Task], str]
"""Does a task; returns what hindered it, or nothing."""


def refit(task: Task) -> str:
    """Fit the records of one session and write a new results file; says what hindered it, or nothing."""
    try:
        for record, sha256 in task.records:
            if sha256_of(record) != sha256:
                return f"{record}: has changed since it was read; rig archive update"
        runs = [_analysed(record, task) for record, _ in task.records]
        write_results(free_path(task.folder), session_results(runs, task.folder))
    except RigError as error:
        return str(error)
    return ""


def _analysed(record: Path, task: Task) -> AnalysedRun:
    if task.level == "swings":
        run = analyse_record(record, task.settings)
    else:
        run = analyse_replayed(record, retrack=task.level == "pixels", overrides=task.settings)
    if task.laws:
        run = with_laws(run, chosen_laws(task.laws))
    return run


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
    work: Work = refit,
) -> int:
    """Fit the sessions again whose runs are named or meet a condition (neither: all that have records).

    The results of each are a new results file beside its records, as `rig fit` makes it, and the rows of the
    archive are those of the new ones. Returns the exit status: 1 where a session was left as it was.

    Raises ConfigurationError for a law or setting that does not exist, before anything is made.
    """
    chosen_laws(laws)
    if names and where:
        raise ConfigurationError(f"--where {where!r}: has no effect beside {names[0]}; leave out one")
    records = dict[str, list[tuple[Path, str]]]()
    for folder, record, sha256 in selected(archive, "*", where or meant(archive, names), _RECORDS)[1]:
        records.setdefault(folder, []).append((Path(folder) / record, sha256))
    recipe = (level, tuple(laws), tuple(settings))
    tasks = [Task(Path(folder), tuple(inside), *recipe) for folder, inside in records.items()]
    if tasks and settings:
        # one that no configuration has is refused once, not by every session
        with RecordReader(tasks[0].records[0][0]) as reader:
            recorded_configuration(reader, settings)
    made, left = list[Path](), 0
    try:
        for task, hindered in (
            _on_cluster(work, tasks, cluster) if cluster else _in_processes(work, tasks, processes)
        ):
            if hindered:
                left += 1
                say(hindered if str(task.folder) in hindered else f"{task.folder}: {hindered}")
            else:
                made.append(task.folder)
            if (len(made) + left) % _SAID_EVERY == 0:
                say(f"{len(made) + left} of {len(tasks)} sessions")
    finally:
        update_below(archive, made)
    print(f"{len(made)} sessions fitted again, {left} left as they were")
    return 1 if left else 0


def _in_processes(work: Work, tasks: Sequence[Task], processes: int | None) -> Iterator[tuple[Task, str]]:
    """Do tasks in processes of this machine; yields each with what hindered it.

    A process that dies takes what is under way with it; what was not done then is tried again, each in a
    process of its own.
    """
    # each process is to use one processor: libraries that read this start no threads of their own
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # a fork would take the locks of this process's threads with it
    how, broken = get_context("spawn"), list[Task]()
    with ProcessPoolExecutor(processes, mp_context=how) as pool:
        running = {pool.submit(work, task): task for task in tasks}
        for done in as_completed(running):
            if isinstance(done.exception(), BrokenProcessPool):
                broken.append(running[done])
            else:
                yield running[done], _hindered(done)
    for task in broken:
        with ProcessPoolExecutor(1, mp_context=how) as pool:
            yield task, _hindered(pool.submit(work, task))


def _on_cluster(work: Work, tasks: Sequence[Task], address: str) -> Iterator[tuple[Task, str]]:
    """The same on a Dask cluster that runs already, whose workers see the same files under the same names."""
    with client_of(address) as client:
        from distributed import as_completed as as_done

        running = {client.submit(work, task, pure=False): task for task in tasks}
        for future in as_done(running, loop=client.loop):
            yield running[future], _hindered(future)


def _hindered(done: Any) -> str:
    error = done.exception()
    if isinstance(error, BrokenProcessPool):
        return "its process was ended, also when it ran alone"
    # a fault that one session brings to light must not cost the others
    return str(done.result()) if error is None else f"failed: {error!r}"


@contextlib.contextmanager
def client_of(address: str) -> Iterator[Any]:
    """A client of the scheduler of a Dask cluster that runs already, and runs the same code.

    Raises ConfigurationError where Dask is not installed, no scheduler answers, no worker is there, or one
    runs other code.
    """
    try:
        from distributed import Client
    except ImportError:
        remedy = "pip install 'optical-pendulum-rig[series]'"
        raise ConfigurationError(f"--cluster needs distributed: {remedy}") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigurationError(f"--cluster {address}: no Dask scheduler answers there: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKER_WITHIN_S)
        except TimeoutError:
            raise ConfigurationError(
                f"--cluster {address}: it has no worker; dask worker {address} adds one"
            ) from None
        codes, own = client.run(code_identity), code_identity()
        if other := next((worker for worker, code in codes.items() if code != own), None):
            raise ConfigurationError(
                f"--cluster {address}: {other} runs other code ({codes[other]}) than this program ({own})"
            )
        yield client
