"""`rig archive refit`: many records fitted again, by all processors here or by a cluster."""

import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from acquisition.record import whole_file
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError
from rig.analysis import chosen_laws
from rig.archive.blind import sealed
from rig.archive.chosen import chosen_runs
from rig.archive.cluster import client_of
from rig.archive.proved import with_line
from rig.archive.refits import Level, Recipe, Task, code_identity, refit
from rig.archive.session_rows import now_utc
from rig.archive.shelf import MANY
from rig.archive.store import Archive, reads_archive
from rig.archive.workers import T, Work, in_processes
from rig.instrument import recorded_configuration
from rig.presentation import say

_READABLE = "state not in ('missing', 'unreadable')"
_SAID_EVERY = 100


@reads_archive
def refit_runs(
    archive: Path,
    names: Sequence[str],
    where: str,
    level: Level,
    *,
    sent_to: str = "",
    laws: Sequence[str] = (),
    settings: Sequence[str] = (),
    cluster: str = "",
    processes: int | None = None,
    work: Callable[[Task], str] = refit,
) -> int:
    """Fit runs again that are named or meet a condition (neither: all that can be read).

    What was made by the same code from the same record with the same settings is left as it is, so that an
    interrupted command is simply started again. Each worker sends its results to `sent_to`, the URL of a
    remote archive of which `archive` is a copy, and without one writes them into `archive`. Returns the exit
    status: 1 where a record was given up.

    Raises ConfigurationError for a law or setting that does not exist, before anything is made.
    """
    chosen_laws(laws)
    recipe = Recipe(level, tuple(laws), tuple(settings), code_identity())
    runs = chosen_runs(archive, names, where or ("" if names else _READABLE))
    place = sent_to or str(archive.resolve())
    store, quarantine = Archive(archive), archive / "quarantine"
    turn, seal = store.refit_turn() + 1, sealed(archive)
    public_key = "" if seal is None else seal.public_key
    tasks = [Task(place, path, sha256, recipe, turn, public_key) for sha256, path in runs.items()]
    done, given_up = store.refits.names(), {path.stem for path in quarantine.glob("[!.]*.json")}
    pending = [task for task in tasks if recipe.name(task.sha256) not in done | given_up]
    skipped = [task for task in tasks if recipe.name(task.sha256) in given_up - done]
    for task in skipped:
        say(f"{task.record}: left out: in quarantine since it ended its process; {quarantine} says when")
    if pending:
        _check_settings(pending, settings)
    made, left, dead = 0, 0, 0
    for task, hindered in _done(work, pending, cluster, processes or os.cpu_count() or 1):
        if hindered is None:
            dead += 1
            _give_up(quarantine, task)
            say(f"{task.record}: ended its process each time it ran alone; it is now in quarantine")
        elif hindered:
            left += 1
            say(hindered if str(task.record) in hindered else f"{task.record}: {hindered}")
        else:
            made += 1
            if made % MANY == 0:
                store.refits.merge(at_once=MANY)
        if (made + left + dead) % _SAID_EVERY == 0:
            say(f"{made + left + dead} of {len(pending)}")
    store.refits.merge()
    known = len(tasks) - len(pending) - len(skipped)
    print(
        f"{made} runs fitted again, {known} known already, {left} left out, "
        f"{dead + len(skipped)} in quarantine"
    )
    return 1 if left or dead or skipped else 0


def _done(
    work: Callable[[Task], str], tasks: Sequence[Task], cluster: str, processes: int
) -> Iterator[tuple[Task, str | None]]:
    if cluster:
        return on_cluster(work, tasks, cluster)
    # each process is to use one processor: libraries that read this start no threads of their own
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return in_processes(work, tasks, min(processes, len(tasks)))


def _check_settings(tasks: Sequence[Task], settings: Sequence[str]) -> None:
    """A setting that no configuration has is refused once, not by every record."""
    for task in tasks if settings else ():
        try:
            with RecordReader(task.record) as reader:
                recorded_configuration(reader, settings)
        except RecordError:
            continue
        return


def _give_up(quarantine: Path, task: Task) -> None:
    said = {
        "record": str(task.record),
        "sha256": task.sha256,
        "level": task.recipe.level,
        "utc": now_utc().isoformat(),
    }
    path = quarantine / f"{task.recipe.name(task.sha256)}.json"
    try:
        quarantine.mkdir(exist_ok=True)
        whole_file.replace(path, with_line(json.dumps(said, indent=1).encode()))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror or error}") from None


def on_cluster(work: Work[T], tasks: Sequence[T], address: str) -> Iterator[tuple[T, str | None]]:
    """The same on a Dask cluster that runs already, whose workers see the same files under the same names."""
    with client_of(address) as client:
        from distributed.scheduler import KilledWorker

        suspects: list[T] = []
        for task, outcome in _submitted(client, work, tasks):
            if isinstance(outcome, KilledWorker):
                suspects.append(task)
            else:
                yield task, _text(outcome)
        # the scheduler itself has tried each several times, among others
        for suspect in suspects:
            for task, outcome in _submitted(client, work, [suspect]):
                yield task, None if isinstance(outcome, KilledWorker) else _text(outcome)


def _submitted(client: Any, work: Work[T], tasks: Sequence[T]) -> Iterator[tuple[T, object]]:
    from distributed import as_completed

    waiting, running = deque(tasks), dict[Any, T]()
    done = as_completed(loop=client.loop)
    most = 2 * max(1, sum(client.nthreads().values()))
    while waiting or running:
        while waiting and len(running) < most:
            future = client.submit(work, waiting[0], pure=False)
            running[future] = waiting.popleft()
            done.add(future)
        future = next(done)
        yield running.pop(future), future.result() if future.status == "finished" else future.exception()


def _text(outcome: object) -> str:
    return outcome if isinstance(outcome, str) else f"failed: {outcome!r}"
