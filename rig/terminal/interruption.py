"""Ctrl-C, SIGTERM and SIGHUP (a closed terminal) as one kind of exception.

The ``with`` blocks that clean up after any error then also clean up here: the record is completed,
the laser is switched off, ports are closed.
"""

import contextlib
import os
import signal
import stat
from collections.abc import Iterator
from types import FrameType

BY_USER = "stopped by the user"
_SAID = {"SIGTERM": "terminated", "SIGHUP": "terminated: the terminal was closed"}


class Terminated(KeyboardInterrupt):
    """The program must end without asking the user anything; the text says why."""


def reason_of(interrupt: KeyboardInterrupt) -> str:
    """Why the program ends, as text for the record."""
    return str(interrupt) if isinstance(interrupt, Terminated) else BY_USER


@contextlib.contextmanager
def terminated_by_signals() -> Iterator[None]:
    """Turn the first SIGTERM or SIGHUP into `Terminated` in the main thread; restore the handlers afterwards.

    Further signals interrupt nothing, so that laser and record are closed; they discard all further output,
    because a reader that does not read would hold that up for ever. Signals that are already ignored
    (``nohup``) stay ignored. After SIGHUP the output is discarded at once, because writing to the closed
    terminal would raise an error. To be entered in the main thread.
    """
    known = [getattr(signal, name) for name in _SAID if hasattr(signal, name)]
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    heard = False

    def end(number: int, _: FrameType | None) -> None:
        nonlocal heard
        if heard:
            _silence([fd for fd in (1, 2) if _may_block(fd)])
            return
        heard = True
        name = signal.Signals(number).name
        if name == "SIGHUP":
            _silence(terminals)
        raise Terminated(_SAID[name])

    before = {each: signal.getsignal(each) for each in known}
    # None: a handler not set from Python, which could not be restored
    taken = {each: handler for each, handler in before.items() if handler not in (None, signal.SIG_IGN)}
    try:
        for each in taken:
            signal.signal(each, end)
        yield
    finally:
        for each, handler in taken.items():
            signal.signal(each, handler)


def _may_block(descriptor: int) -> bool:
    """Whether it is not open on a file."""
    try:
        return not stat.S_ISREG(os.fstat(descriptor).st_mode)
    except OSError:
        return False


def _silence(descriptors: list[int]) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
