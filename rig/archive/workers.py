"""Tasks in processes of this machine, some of which end: by a fault of the task, or by what others do."""

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Generic, TypeVar

from rig.presentation import say

T = TypeVar("T")
Work = Callable[[T], str]
"""Does a task; returns what hindered it, or nothing."""

_ENOUGH = 4
"""So much must speak against a task before it is given up."""
_OWN_FAULT = 2
"""Its process ended by a fault: nobody else does that, but it may be of the machine."""
_ENDED_ALONE = 1
"""Its process was ended from outside, and one that did nothing was not."""
_TRIES = 8
_WATCHED_TIMES = 4.0
_WATCHED_S = 60.0
"""One that does nothing is watched for so many times as long as a task lived, but not longer than this, or
than it lived.
"""
_FROM_OUTSIDE = {getattr(signal, name, None) for name in ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")}


def in_processes(work: Work[T], tasks: Sequence[T], processes: int) -> Iterator[tuple[T, str | None]]:
    """Do tasks in processes of this machine; yields each with what `work` returned, None where given up.

    A process that dies takes its task with it, and sometimes a neighbour's: all that were under way then are
    tried again, each alone. Given up is what ends its process by a fault twice, or is ended by others (as a
    machine without memory does) four times while a process that does nothing lives on. Where that is ended,
    too, nothing is held against a task: it is left for another time.
    """
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
        yield from alone(work, suspects)
        suspects.clear()


@dataclass
class _Suspect(Generic[T]):
    """A task that was under way when a process ended; `against` counts what speaks against it."""

    task: T
    against: int = 0


@dataclass
class _Ended:
    """How a process ended that was to do a task; without `outcome` it was ended, after so many seconds."""

    outcome: str | None
    exit_code: int
    lived_s: float

    @property
    def from_outside(self) -> bool:
        """Whether somebody else has ended it, as far as that can be told."""
        # Windows does not say
        return os.name != "posix" or -self.exit_code in _FROM_OUTSIDE


def alone(work: Work[T], tasks: Sequence[T]) -> Iterator[tuple[T, str | None]]:
    """The same for tasks that were under way when a process ended, each in a process of its own."""
    suspects = [_Suspect(task) for task in tasks]
    ended = _Ended("", 0, 0.0)
    for _ in range(_TRIES):
        victims, longest_s = list[_Suspect[T]](), 0.0
        left = list[_Suspect[T]]()
        for suspect in suspects:
            ended = _tried(work, suspect.task)
            if ended.outcome is not None:
                yield suspect.task, ended.outcome
                continue
            left.append(suspect)
            if ended.from_outside:
                victims.append(suspect)
                longest_s = max(longest_s, ended.lived_s)
            else:
                suspect.against += _OWN_FAULT
        if victims and _lives(min(_WATCHED_TIMES * longest_s, max(_WATCHED_S, longest_s))):
            for suspect in victims:
                suspect.against += _ENDED_ALONE
        suspects = [suspect for suspect in left if suspect.against < _ENOUGH]
        for suspect in left:
            if suspect.against >= _ENOUGH:
                yield suspect.task, None
        if not suspects:
            return
    for suspect in suspects:
        told = (
            f"its process was ended {_TRIES} times from outside (the last by signal {-ended.exit_code}), as "
            "others were, too; nothing is held against it: start the command again"
        )
        yield suspect.task, told


def _tried(work: Work[T], task: T) -> _Ended:
    """Do a task in a process of its own."""
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_do_alone, args=(sender, work, task), daemon=True)
    began_s = time.monotonic()
    process.start()
    sender.close()
    outcome: str | None
    try:
        outcome = receiver.recv()
    except (EOFError, OSError):
        # it was ended, in the middle of what it said at the latest
        outcome = None
    receiver.close()
    process.join()
    return _Ended(outcome, process.exitcode or 0, time.monotonic() - began_s)


def _do_alone(sender: Connection, work: Work[T], task: T) -> None:
    _begin()
    try:
        outcome = work(task)
    except Exception as error:
        outcome = _fault(error)
    sender.send(outcome)


def _lives(watched_s: float) -> bool:
    """Whether a process that does nothing is not ended in this time."""
    say(f"a process was ended from outside; watching for {watched_s:.0f} s whether another one is, too")
    context = get_context("spawn")
    ends, held = context.Pipe(duplex=False)
    process = context.Process(target=_wait_for_end, args=(ends,), daemon=True)
    process.start()
    ends.close()
    process.join(watched_s)
    lives = process.is_alive()
    held.close()
    process.join()
    return lives


def _wait_for_end(ends: Connection) -> None:
    _begin()
    try:
        ends.recv()
    except EOFError:
        return


def _outcome(done: Future[str]) -> str | None:
    """What a task returned, or the fault that it raised as text; None where its process ended."""
    try:
        return done.result()
    except BrokenProcessPool:
        return None
    except Exception as error:
        return _fault(error)


def _fault(error: Exception) -> str:
    # a fault that one record brings to light must not cost the others
    return f"failed: {error!r}"


def _pool(processes: int) -> ProcessPoolExecutor:
    # a fork would take the locks of this process's threads with it
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """Ctrl-C ends a worker at once and in silence; what it had not finished is done another time."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
