"""Signals raise an exception once, in the main thread, and the previous handlers are restored."""

import signal
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


def test_reasons() -> None:
    assert reason_of(KeyboardInterrupt()) == BY_USER == "stopped by the user"
    assert reason_of(Terminated("terminated")) == "terminated"
