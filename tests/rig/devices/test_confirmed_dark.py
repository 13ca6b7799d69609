"""The end says in one line whether the laser is off: asked for long enough to hear it, and not cut short."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from rig.devices import Devices, laser
from tests.rig.control.wires import FirmwareBoard
from tests.rig.devices.test_wiring import of_parts

CONFIRMED = "laser off, confirmed by the controller"


@contextmanager
def lit(board: FirmwareBoard) -> Iterator[Devices]:
    with Devices(of_parts(board, {"kind": "controller"}, watchdog_s=5.0)) as devices:
        devices.light()
        assert board.outputs()["laser"][0] == 1
        yield devices


def late(board: FirmwareBoard) -> None:
    """Answers take 0.9 s, more than all repetitions of a command."""
    wire = board.wire

    def hold_back(data: bytes) -> bytes:
        threading.Timer(0.9, wire.inject, [data]).start()
        return b""

    wire.to_host = hold_back
    threading.Timer(0.7, lambda: setattr(wire, "to_host", bytes)).start()


def without_session(board: FirmwareBoard) -> None:
    """It was reset, and answers that it has no session (error -203)."""
    board.press(b"r")
    time.sleep(0.3)


def reopened(board: FirmwareBoard) -> None:
    """Nothing goes over the cable for a while."""
    board.wire.connected = False
    threading.Timer(1.0, lambda: setattr(board.wire, "connected", True)).start()


@pytest.mark.parametrize("fault", [late, without_session, reopened])
def test_what_answers_late_is_waited_for(
    make_board: Callable[..., FirmwareBoard],
    fault: Callable[[FirmwareBoard], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    board = make_board(through_wire=True)
    with lit(board):
        fault(board)
    # until the last late answer has come
    time.sleep(1.0)
    assert board.outputs()["laser"][0] == 0
    said = capsys.readouterr().err
    assert CONFIRMED in said
    assert "MAY BE LIT" not in said


def test_what_never_answers_is_not_confirmed(
    make_board: Callable[..., FirmwareBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    board = make_board(through_wire=True)
    with lit(board) as devices:
        board.wire.to_host = lambda _: b""
        begun_s = time.monotonic()
    assert "THE LASER MAY BE LIT: the controller does not confirm" in capsys.readouterr().err
    assert time.monotonic() - begun_s < 20.0
    # what nobody has confirmed the next program asks about
    assert devices.state.left_lit


@pytest.mark.parametrize("answers", [True, False])
def test_ctrl_c_in_the_wait_is_heard_after_one_of_the_two_lines(
    make_board: Callable[..., FirmwareBoard],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    answers: bool,
) -> None:
    board = make_board(through_wire=True)
    usual, interrupts = laser.wait_for_command, iter(range(2))

    def interrupted(*words: Any) -> None:
        for _ in interrupts:
            raise KeyboardInterrupt
        usual(*words)

    session = ExitStack()
    session.enter_context(lit(board))
    if not answers:
        board.wire.to_host = lambda _: b""
    monkeypatch.setattr(laser, "wait_for_command", interrupted)
    with pytest.raises(KeyboardInterrupt):
        session.close()
    assert (CONFIRMED if answers else "THE LASER MAY BE LIT") in capsys.readouterr().err
