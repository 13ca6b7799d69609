"""Interruption by Ctrl-C, signals and hang-up; child processes; ports; characters that an encoding lacks."""

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
_REASONS = {"SIGTERM": "terminated", "SIGHUP": "terminated: the terminal was closed"}
_RAISE_AGAIN_S = 0.05
"""Delay after which a lost or postponed interrupt is raised again: the callback has then returned."""
_IMPORT_FILE = "<frozen importlib._bootstrap>"
"""Name of the file, in a stack frame, of Python's import."""


class Terminated(KeyboardInterrupt):
    """Raised if the program must end without asking the user; holds the reason and the signal's number."""

    def __init__(self, reason: str, number: int = signal.SIGTERM) -> None:
        super().__init__(reason)
        self.number = number


def reason_of(interrupt: KeyboardInterrupt) -> str:
    """Why the program ends, as text for the record."""
    return str(interrupt) if isinstance(interrupt, Terminated) else BY_USER


@contextlib.contextmanager
def terminated_by_signals() -> Iterator[None]:
    """Turn the first SIGTERM or SIGHUP into `Terminated` in the main thread; restore the handlers afterwards.

    Further signals interrupt nothing, so that laser and record are closed; they discard all further output,
    which could block for ever if nobody reads it. Signals that are already ignored (``nohup``) stay ignored.
    After SIGHUP the output is discarded at once, because writing to the closed terminal would raise an error.

    Python discards an interrupt that is raised where it cannot be caught (in a finalizer, or in a callback
    from a C library, such as the loader of compiled kernels); such an interrupt, also Ctrl-C, is raised again
    afterwards. An interrupt during an import waits for the end of the import: an interrupted module may raise
    ImportError instead, and may never be importable again. Enter it in the main thread.
    """
    numbers = [getattr(signal, name) for name in _REASONS if hasattr(signal, name)]
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    signalled = False
    # the caller itself may be running during an import
    outer_imports = _imports(sys._getframe())

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal signalled
        if _imports(frame) > outer_imports:
            _raise_again(number)
            return
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        if signalled:
            _silence([fd for fd in (1, 2) if _may_block(fd)])
            return
        signalled = True
        name = signal.Signals(number).name
        if name == "SIGHUP":
            _silence(terminals)
        raise Terminated(_REASONS[name], number)

    default_hook = sys.unraisablehook

    def raise_lost_again(lost: "sys.UnraisableHookArgs") -> None:
        nonlocal signalled
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            default_hook(lost)
            return
        number: int = signal.SIGINT
        if isinstance(lost.exc_value, Terminated):
            number, signalled = lost.exc_value.number, False
        # an interrupt raised inside this hook would be lost again
        _raise_again(number)

    handlers = {number: signal.getsignal(number) for number in numbers}
    # None is a handler that was not set from Python and could not be restored
    replaced = {number: old for number, old in handlers.items() if old not in (None, signal.SIG_IGN)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        replaced[signal.SIGINT] = signal.default_int_handler
    try:
        sys.unraisablehook = raise_lost_again
        for number in replaced:
            signal.signal(number, end)
        yield
    finally:
        sys.unraisablehook = default_hook
        for number, handler in replaced.items():
            signal.signal(number, handler)


def _imports(frame: FrameType | None) -> int:
    """Number of calls of Python's import on the stack."""
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == _IMPORT_FILE
        frame = frame.f_back
    return count


def _raise_again(number: int) -> None:
    timer = threading.Timer(_RAISE_AGAIN_S, _interrupt_main, (number,))
    timer.daemon = True
    timer.start()


@contextlib.contextmanager
def call_on_hang_up(callback: Callable[[], None]) -> Iterator[None]:
    """Call `callback`, and raise nothing, when the terminal is closed, within `terminated_by_signals`.

    An event loop that is left by an exception leaves threads that wait for it for ever. A hang-up that is
    ignored stays ignored. Enter it in the main thread.
    """
    number = getattr(signal, "SIGHUP", None)
    old_handler = None if number is None else signal.getsignal(number)
    if number is None or old_handler in (None, signal.SIG_IGN):
        yield
        return
    terminals = [fd for fd in (0, 1, 2) if os.isatty(fd)]

    def end(_number: int, _frame: FrameType | None) -> None:
        _silence(terminals)
        callback()

    signal.signal(number, end)
    try:
        yield
    finally:
        signal.signal(number, old_handler)


def _interrupt_main(number: int) -> None:
    """Raise a signal in the main thread, even while it waits."""
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.pthread_kill(main, number)


def _may_block(descriptor: int) -> bool:
    """Whether writing to a descriptor may block: it is not a regular file."""
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


def process_group_options() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a process in a process group of its own, without a console."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def start_python(*arguments: str, **options: Any) -> "subprocess.Popen[Any]":
    """Start this interpreter in a process group of its own, with this program importable.

    `options` are those of `Popen`; the variables of `env` are added to the environment of this process.
    """
    project = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join(folder for folder in (project, os.environ.get("PYTHONPATH")) if folder)
    environment = {**os.environ, **options.get("env", {}), "PYTHONPATH": path}
    options |= {"env": environment, **process_group_options()}
    return subprocess.Popen([sys.executable, "-P", *arguments], **options)


def free_port(preferred: int) -> int:
    """The preferred port of 127.0.0.1 if it is free, otherwise (and for 0) any free one."""
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
_ASCII_TEXTS: Final = {
    "±": "+-", "×": "x", "−": "-", "–": "-", "…": "...", "°": " deg", "µ": "u", "₀": "0", "ₜ": "t",
    "α": "alpha", "γ": "gamma", "κ": "kappa", "σ": "sigma", "χ": "chi", "ν": "nu", "φ": "phi",
}  # fmt: skip


def ascii_text(text: str) -> str:
    """The text in ASCII; a character without a replacement becomes a question mark."""
    parts = []
    in_exponent = False
    for character in text:
        if character in _SUPERSCRIPTS:
            parts.append(("" if in_exponent else "^") + _SUPERSCRIPTS[character])
        else:
            parts.append(character if character.isascii() else _ASCII_TEXTS.get(character, "?"))
        in_exponent = character in _SUPERSCRIPTS
    return "".join(parts)


def replace_missing_characters() -> None:
    """Make stdout and stderr replace characters that their encoding lacks, instead of raising an error."""
    codecs.register_error("ascii_text", _replace)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="ascii_text")


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return ascii_text(error.object[error.start : error.end]), error.end
