"""One process at a time, by the system's lock of one byte of a file: a process that ends leaves none."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_POLL_S = 0.05
LONGEST_S = 600.0
"""After which the other process is taken for one that hangs, and is not waited for."""


@contextmanager
def byte_locked(path: Path, byte: int, waits: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of one byte within the context; `waits` is called once if another process has it.

    The byte need not exist. Where the disk or the system knows no such locks, or nothing can be written, the
    context is entered without.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError:
        yield
        return
    try:
        _take(file, byte, waits)
        yield
    finally:
        os.close(file)  # which gives the lock back


def _take(file: int, byte: int, waits: Callable[[], None]) -> None:
    until_s, said = time.monotonic() + LONGEST_S, False
    while not _taken(file, byte) and time.monotonic() < until_s:
        if not said:
            waits()
            said = True
        time.sleep(_POLL_S)


def _taken(file: int, byte: int) -> bool:
    """Whether another process does not have it; where there are no locks, none has."""
    if fcntl is None:
        return True
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True
