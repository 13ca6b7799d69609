"""Tasks done by several processes, here or on a Dask cluster, whatever one of them does to its process.

A process that dies takes its task with it, and sometimes a neighbour's: all that were under way then are
tried again, each alone. A task that ends its process twice when it is alone is given up.
"""

import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any, TypeVar

from processing.errors import ConfigurationError, MissingPackage

T = TypeVar("T")
Work = Callable[[T], str]
"""Does a task; returns what hindered it, or nothing."""
_TRIES = 2
"""Alone: once could be somebody else's doing, as a machine without memory ends whom it will."""


def in_processes(work: Work[T], tasks: Sequence[T], processes: int) -> Iterator[tuple[T, str | None]]:
    """Do tasks in processes of this machine; yields each with what `work` returned, None where given up."""
    waiting, suspects = deque(tasks), list[T]()
    while waiting:
        with _pool(processes) as pool:
            running: dict[Future[str], T] = {}
            try:
                while (waiting or running) and not suspects:
                    # one more than there are processes, so that none has to wait for this one
                    while waiting and len(running) <= processes:
                        # taken off afterwards: it is still waiting where the pool refuses it
                        future = pool.submit(work, waiting[0])
                        running[future] = waiting.popleft()
                    for done in wait(running, return_when=FIRST_COMPLETED).done:
                        task, outcome = running.pop(done), _outcome(done)
                        if outcome is None:
                            suspects.append(task)
                        else:
                            yield task, outcome
            except BrokenProcessPool:
                # told when a task was handed over, which then is still waiting
                pass
            for future, task in running.items():
                outcome = _outcome(future)
                if outcome is None:
                    suspects.append(task)
                else:
                    yield task, outcome
        yield from _alone(work, suspects)
        suspects.clear()


def _alone(work: Work[T], suspects: Sequence[T]) -> Iterator[tuple[T, str | None]]:
    left = deque((task, _TRIES) for task in suspects)
    while left:
        with _pool(1) as pool:
            outcome: str | None = ""
            while left and outcome is not None:
                task, tries = left.popleft()
                outcome = _outcome(pool.submit(work, task))
                if outcome is None and tries > 1:
                    left.append((task, tries - 1))
                else:
                    yield task, outcome


def _outcome(done: Future[str]) -> str | None:
    """What a task returned, or the fault that it raised as text; None where its process ended."""
    try:
        return done.result()
    except BrokenProcessPool:
        return None
    except Exception as error:
        # a fault that one record brings to light must not cost the others
        return f"failed: {error!r}"


def _pool(processes: int) -> ProcessPoolExecutor:
    # a fork would take the locks of this process's threads with it
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """Ctrl-C ends a worker at once and in silence; what it had not finished is done another time."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def on_cluster(work: Work[T], tasks: Sequence[T], address: str) -> Iterator[tuple[T, str | None]]:
    """The same on a Dask cluster that runs already, whose workers see the same files under the same names."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise MissingPackage("--cluster", "distributed") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigurationError(f"--cluster {address}: no Dask scheduler answers there: {error}") from None
    with client:
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
