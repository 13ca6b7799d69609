"""Signals raise an exception once, in the main thread, and the previous handlers are restored."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

import pytest

from rig.interruption import BY_USER, Terminated, reason_of, terminated_by_signals


def own_handler(_number: int, _frame: FrameType | None) -> None:
    """Whoever embeds the program has a handler of its own."""


def test_a_signal_is_an_interrupt_and_handlers_are_restored() -> None:
    before = signal.signal(signal.SIGTERM, own_handler)
    try:
        with pytest.raises(Terminated, match="terminated"), terminated_by_signals():
            signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is own_handler
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.skipif(os.name != "posix", reason="hangups are those of POSIX")
def test_an_ignored_hangup_stays_ignored() -> None:
    """As with nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with terminated_by_signals():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_second_signal_does_not_break_off_the_closing() -> None:
    closed = []

    def close() -> None:
        signal.raise_signal(signal.SIGTERM)
        closed.append("laser")

    def work() -> None:
        with terminated_by_signals(), ExitStack() as closing:
            closing.callback(close)
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Terminated):
        work()
    assert closed


def by_a_callback(raising: Callable[[], None]) -> None:
    """A library written in C calls back, as that does which loads compiled kernels."""
    ctypes.CFUNCTYPE(None)(raising)()


def by_a_finalizer(raising: Callable[[], None]) -> None:
    class Finalized:
        def __del__(self) -> None:
            raising()

    Finalized()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("somewhere", [by_a_callback, by_a_finalizer])
def test_a_signal_that_python_discards_is_raised_again(
    somewhere: Callable[[Callable[[], None]], None], number: signal.Signals
) -> None:
    if number == signal.SIGINT and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        pytest.skip("Ctrl-C has another handler here")

    def work() -> None:
        with terminated_by_signals():
            somewhere(lambda: signal.raise_signal(number))
            threading.Event().wait(30.0)

    with pytest.raises(KeyboardInterrupt) as raised:
        work()
    assert isinstance(raised.value, Terminated) == (number == signal.SIGTERM)


def test_reasons() -> None:
    assert reason_of(KeyboardInterrupt()) == BY_USER == "stopped by the user"
    assert reason_of(Terminated("terminated")) == "terminated"


CUT_SHORT = """
import signal
signal.raise_signal(signal.{number})
whole = True
"""
TURNED = """
try:
    import cut_short
except BaseException:
    raise ImportError("multiarray failed to import") from None
"""
"""As a module written in C does, such as those of scipy, whatever is raised while it loads numpy."""
DURING_AN_IMPORT = """
import signal, sys, threading
from rig.interruption import Terminated, terminated_by_signals
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    with terminated_by_signals():
        import turned
        threading.Event().wait(60.0)
except KeyboardInterrupt as error:
    print(type(error).__name__)
print(sys.modules["turned"].cut_short.whole)
"""
IMPORTED_ITSELF = """
import signal
from rig.interruption import terminated_by_signals
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    with terminated_by_signals():
        signal.raise_signal(signal.SIGINT)
        print("held")
except KeyboardInterrupt:
    print("raised")
"""


def printed_by(program: str, folder: Path) -> list[str]:
    """What a Python of its own prints, which imports from `folder` too."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(("number", "kind"), [("SIGINT", "KeyboardInterrupt"), ("SIGTERM", "Terminated")])
def test_a_signal_during_an_import_waits_for_its_end(number: str, kind: str, tmp_path: Path) -> None:
    (tmp_path / "cut_short.py").write_text(CUT_SHORT.format(number=number))
    (tmp_path / "turned.py").write_text(TURNED)
    assert printed_by(DURING_AN_IMPORT, tmp_path) == [kind, "True"]


def test_a_program_that_is_itself_imported_can_be_interrupted(tmp_path: Path) -> None:
    (tmp_path / "imported_itself.py").write_text(IMPORTED_ITSELF)
    assert printed_by("import imported_itself", tmp_path) == ["raised"]
