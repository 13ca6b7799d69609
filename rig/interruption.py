"""Being told to end: Ctrl-C, SIGTERM, and the terminal that is closed, all as one kind of exception.

Whatever is open is closed by the same ``with`` blocks that close it after any other error: the
record is complete, the laser dark, the port given back.
"""

import contextlib
import os
import signal
from collections.abc import Iterator
from types import FrameType

BY_USER = "stopped by the user"
_SAID = {"SIGTERM": "terminated", "SIGHUP": "terminated: the terminal was closed"}


class Terminated(KeyboardInterrupt):
    """The program is to end now and to ask nobody anything; the text says who wants it."""


def reason_of(interrupt: KeyboardInterrupt) -> str:
    """Why the program ends, in words for the record."""
    return str(interrupt) if isinstance(interrupt, Terminated) else BY_USER


@contextlib.contextmanager
def terminated_by_signals() -> Iterator[None]:
    """Turn the first SIGTERM or SIGHUP into `Terminated` in the main thread; restore the handlers afterwards.

    A second signal is not heard, so that it cannot break off the closing of laser and record. What
    is ignored already (``nohup``) stays ignored. A terminal that has gone takes no more output and
    must not fail a program that is about to end: what is said after SIGHUP is said to nobody.
    Enter it in the main thread.
    """
    known = [getattr(signal, name) for name in _SAID if hasattr(signal, name)]
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    heard = False

    def end(number: int, _: FrameType | None) -> None:
        nonlocal heard
        if heard:
            return
        heard = True
        name = signal.Signals(number).name
        if name == "SIGHUP":
            _silence(terminals)
        raise Terminated(_SAID[name])

    before = {each: signal.getsignal(each) for each in known}
    # None: a handler that Python did not set, and could not set again
    taken = {each: handler for each, handler in before.items() if handler not in (None, signal.SIG_IGN)}
    try:
        for each in taken:
            signal.signal(each, end)
        yield
    finally:
        for each, handler in taken.items():
            signal.signal(each, handler)


def _silence(descriptors: list[int]) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
