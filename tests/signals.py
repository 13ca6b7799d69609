"""Signals of a process that others start, so that those it starts itself can be told to end."""

import signal


def heed_signals() -> None:
    """Ctrl-C and a closed terminal mean what they mean to a program that a person starts.

    A background job of a shell ignores Ctrl-C, and one under nohup a closed terminal; every process that
    is started from here would ignore them, too. A signal with a handler has its default in those processes.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda number, frame: None)
