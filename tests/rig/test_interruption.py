"""Signals raise an exception once, in the main thread, and the previous handlers are restored."""

import ctypes
import signal
import threading
from collections.abc import Callable
from contextlib import ExitStack
from types import FrameType

import pytest

from rig.terminal import BY_USER, Terminated, reason_of, terminated_by_signals


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
