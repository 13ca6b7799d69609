"""Ctrl-C and a terminal that closes, child processes that it spares, characters that it lacks."""

import _thread
import codecs
import contextlib
import io
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final

BY_USER = "stopped by the user"
_SAID = {"SIGTERM": "terminated", "SIGHUP": "terminated: the terminal was closed"}
_AGAIN_S = 0.05
"""So long after it was lost, or held, an interrupt is raised again: by then the callback has returned."""
_IMPORTING = "<frozen importlib._bootstrap>"


class Terminated(KeyboardInterrupt):
    """The program must end without asking the user anything: why, and the signal's number."""

    def __init__(self, why: str, number: int = signal.SIGTERM) -> None:
        super().__init__(why)
        self.number = number


def reason_of(interrupt: KeyboardInterrupt) -> str:
    """Why the program ends, as text for the record."""
    return str(interrupt) if isinstance(interrupt, Terminated) else BY_USER


@contextlib.contextmanager
def terminated_by_signals() -> Iterator[None]:
    """Turn the first SIGTERM or SIGHUP into `Terminated` in the main thread; restore the handlers afterwards.

    Further signals interrupt nothing, so that laser and record are closed; they discard all further output,
    because a reader that does not read would hold that up for ever. Signals that are already ignored
    (``nohup``) stay ignored. After SIGHUP the output is discarded at once, because writing to the closed
    terminal would raise an error.

    An interrupt that comes up where nobody can catch it (in a finalizer, or in a callback of a library
    written in C, such as that by which compiled kernels are loaded) would be forgotten by Python, and with
    it what the user asked for: Ctrl-C too is raised again after it. One that comes during an import waits
    for its end: a module cut short may raise ImportError instead, and may be importable never again. To be
    entered in the main thread.
    """
    known = [getattr(signal, name) for name in _SAID if hasattr(signal, name)]
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    heard = False
    # whoever calls this may itself be imported
    around = _imports(sys._getframe())

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal heard
        if _imports(frame) > around:
            _raise_again(number)
            return
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        if heard:
            _silence([fd for fd in (1, 2) if _may_block(fd)])
            return
        heard = True
        name = signal.Signals(number).name
        if name == "SIGHUP":
            _silence(terminals)
        raise Terminated(_SAID[name], number)

    usual = sys.unraisablehook

    def discarded(lost: "sys.UnraisableHookArgs") -> None:
        nonlocal heard
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            usual(lost)
            return
        number: int = signal.SIGINT
        if isinstance(lost.exc_value, Terminated):
            number, heard = lost.exc_value.number, False
        # raised inside of this hook it would be lost once more
        _raise_again(number)

    before = {each: signal.getsignal(each) for each in known}
    # None: a handler not set from Python, which could not be restored
    taken = {each: handler for each, handler in before.items() if handler not in (None, signal.SIG_IGN)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        taken[signal.SIGINT] = signal.default_int_handler
    try:
        sys.unraisablehook = discarded
        for each in taken:
            signal.signal(each, end)
        yield
    finally:
        sys.unraisablehook = usual
        for each, handler in taken.items():
            signal.signal(each, handler)


def _imports(frame: FrameType | None) -> int:
    """How many calls of Python's import are on the stack."""
    found = 0
    while frame is not None:
        found += frame.f_code.co_filename == _IMPORTING
        frame = frame.f_back
    return found


def _raise_again(number: int) -> None:
    again = threading.Timer(_AGAIN_S, _interrupt_main, (number,))
    again.daemon = True
    again.start()


@contextlib.contextmanager
def told_of_hang_up(do: Callable[[], None]) -> Iterator[None]:
    """Within `terminated_by_signals`: call `do` when the terminal is closed, where nothing may be raised.

    An event loop that is left by an exception leaves threads that wait for it for ever. A hang-up that is
    ignored stays so. To be entered in the main thread.
    """
    number = getattr(signal, "SIGHUP", None)
    before = None if number is None else signal.getsignal(number)
    if number is None or before in (None, signal.SIG_IGN):
        yield
        return
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    def end(_number: int, _frame: FrameType | None) -> None:
        _silence(terminals)
        do()

    signal.signal(number, end)
    try:
        yield
    finally:
        signal.signal(number, before)


def _interrupt_main(number: int) -> None:
    """Raise a signal in the main thread, also where that waits for something."""
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.pthread_kill(main, number)


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


LOOPBACK = "127.0.0.1"


def own_group() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a process in a process group of its own, without a console."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def start_python(*words: str, **how: Any) -> "subprocess.Popen[Any]":
    """Start this interpreter in a group of its own, with this program importable; `how` as for `Popen`.

    What `env` states is added to this process's own environment.
    """
    project = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(part for part in (project, os.environ.get("PYTHONPATH")) if part)
    environment = {**os.environ, **how.pop("env", {}), "PYTHONPATH": path}
    return subprocess.Popen([sys.executable, "-P", *words], env=environment, **how, **own_group())


def free_port(preferred: int) -> int:
    """The preferred port of 127.0.0.1 if it is free, otherwise any free one (also if it is 0)."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            if os.name == "posix":
                # Connections of a server that has just ended (TIME_WAIT) do not prevent the use of its port.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"no free port on {LOOPBACK}")


_SUPERSCRIPTS: Final = dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵖ", "-0123456789p", strict=True))
_SPELLED: Final = {
    "±": "+-", "×": "x", "−": "-", "–": "-", "…": "...", "°": " deg", "µ": "u", "₀": "0", "ₜ": "t",
    "α": "alpha", "γ": "gamma", "κ": "kappa", "σ": "sigma", "χ": "chi", "ν": "nu", "φ": "phi",
}  # fmt: skip


def spelled(text: str) -> str:
    """The text in ASCII; a character without a replacement becomes a question mark."""
    parts = []
    raised = False
    for character in text:
        if character in _SUPERSCRIPTS:
            parts.append(("" if raised else "^") + _SUPERSCRIPTS[character])
        else:
            parts.append(character if character.isascii() else _SPELLED.get(character, "?"))
        raised = character in _SUPERSCRIPTS
    return "".join(parts)


def spell_out_what_is_missing() -> None:
    """Make stdout and stderr replace characters that their encoding lacks, instead of raising an error."""
    codecs.register_error("spelled", _spell)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spelled")


def _spell(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return spelled(error.object[error.start : error.end]), error.end
