"""Laser and magnet switch off without the host, and no power above a limit is accepted."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import serial
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rig.control.controller import Controller
from rig.control.link import ControllerReset
from rig.control.protocol import encode
from rig.control.service import ControlService
from tests.rig.control.conftest import settings_for
from tests.rig.control.wires import FirmwareBoard

pytestmark = pytest.mark.realtime

# The watchdog's time, a turn of the loop, and a machine that is busy with other tests.
DARK_WITHIN_S = 30.0
WATCHDOG_S = 1.5


@contextmanager
def lit_by_another_program(board: FirmwareBoard, ending: str) -> Iterator["subprocess.Popen[str]"]:
    with subprocess.Popen(
        [sys.executable, "-m", "tests.rig.control.host_program", board.port, ending],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "lit\n"
        assert board.outputs()["laser"] == [1, 0.0005]
        assert board.outputs()["magnet"] == [1]
        yield program
        program.kill()


def dark(board: FirmwareBoard) -> bool:
    outputs = board.outputs()
    return outputs["laser"][0] == 0 and outputs["magnet"] == [0] and outputs["starter"] == [0]


def test_killed_with_signal_9(board: FirmwareBoard) -> None:
    with lit_by_another_program(board, "waits") as program:
        # Alive, it stays lit for longer than the watchdog waits: the heartbeat does its work.
        time.sleep(2 * WATCHDOG_S)
        assert board.outputs()["laser"] == [1, 0.0005]
        program.send_signal(signal.SIGKILL)
        program.wait()
        board.wait_for(lambda: dark(board), DARK_WITHIN_S)


def test_stopped_but_not_ended(board: FirmwareBoard) -> None:
    with lit_by_another_program(board, "waits") as program:
        program.send_signal(signal.SIGSTOP)
        board.wait_for(lambda: dark(board), DARK_WITHIN_S)
        program.send_signal(signal.SIGCONT)
        # It wakes up and finds its session gone; nothing lights by itself.
        time.sleep(0.5)
        assert dark(board)


@pytest.mark.parametrize("ending", ["returns", "raises", "exits", "closes"])
def test_every_other_way_to_end(board: FirmwareBoard, ending: str) -> None:
    with lit_by_another_program(board, ending) as program:
        assert program.stdin is not None
        program.stdin.write("\n")
        program.stdin.flush()
        board.wait_for(lambda: dark(board), DARK_WITHIN_S)


def test_cable_pulled_while_the_program_lives(make_board: Callable[..., FirmwareBoard]) -> None:
    board = make_board(through_wire=True)
    assert board.wire is not None
    control = settings_for(board.port, timeout_s=0.2, heartbeat_s=0.1, watchdog_s=1.5)
    with ControlService(Controller(control, 0.001), control) as service:
        service.wait_open(10.0)
        service.laser_on().result(5.0)
        service.hold().result(5.0)
        assert board.outputs()["laser"][0] == 1
        board.wire.connected = False
        board.wait_for(lambda: dark(board), DARK_WITHIN_S)
        board.wire.connected = True
        # Plugged in again: the service finds the controller, reports it, and lights nothing.
        board.wait_for(lambda: service.snapshot.reconnects >= 1, 30.0)
        assert dark(board)
        said = " / ".join(service.take_events())
        assert "no reply" in said or "no session" in said
        assert said.count("TEST0001 is connected") == 2


def test_a_hung_board_goes_dark_before_it_listens_again(board: FirmwareBoard) -> None:
    controller = Controller(settings_for(board.port, timeout_s=2.0, watchdog_s=0.5), 0.001)
    controller.open()
    controller.laser_on()
    lit_ms = board.events()[-1][0]
    board.press(b"h")
    board.wait_for(lambda: board.outputs()["laser"][0] == 0, DARK_WITHIN_S)
    with pytest.raises(ControllerReset, match="no session"):
        controller.heartbeat()
    off_ms = next(
        ms for ms, name, values in board.events() if name == "laser" and values[0] == 0 and ms > lit_ms
    )
    assert off_ms - lit_ms >= 500
    controller.close()


NUMBERS = st.one_of(
    st.floats(width=64).map(repr),
    st.floats(0.0009, 0.0011).map(repr),
    st.sampled_from(
        ["nan", "inf", "-inf", "1e-3", "1.0000001e-3", "1e400", "0x1p-3", "1_0", "", "-0.0", "1,0"]
    ),
)
COMMANDS = st.one_of(
    st.just("LAS:STAT ON"),
    NUMBERS.map(lambda n: f"LAS:POW {n}"),
    NUMBERS.map(lambda n: f"las:power:limit {n}"),
    st.sampled_from(
        [
            "LAS:STAT ON",
            "LAS:STAT OFF",
            "LASER:STATE 1",
            "SYST:SAFE",
            "*RST",
            "SYST:HEAR?",
            "INT?",
            "SYST:SESS B,5000",
            "SYST:SESS C,1e9",
            "SYST:SESS:END",
        ]
    ),
    st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="#!"), max_size=40),
)
SENDINGS = st.one_of(
    st.tuples(st.just("command"), COMMANDS),
    st.tuples(st.just("bytes"), st.binary(max_size=40)),
    st.tuples(st.just("interlock"), st.booleans()),
)


def test_no_power_above_the_stored_limit_whatever_is_sent(board: FirmwareBoard) -> None:
    tag = 0

    with serial.Serial(board.port, timeout=2.0) as line:

        def ask(command: str) -> bytes:
            nonlocal tag
            tag = tag % 65535 + 1
            line.write(b"\n" + encode(tag, command))
            while not (reply := line.readline()).startswith(b"#%d " % tag):
                assert reply, f"no answer to {command}"
            return reply

        @settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), database=None)
        @given(st.lists(SENDINGS, min_size=1, max_size=12))
        @example(
            [("command", "LAS:STAT ON"), ("command", "LAS:POW 1e-3"), ("command", "LAS:POW 1.0000001e-3")]
        )
        def check(sendings: list[tuple[str, object]]) -> None:
            ask("SYST:SESS A,5000")
            before = len(board.events())
            for kind, what in sendings:
                if kind == "command":
                    assert isinstance(what, str)
                    ask(what)
                elif kind == "bytes":
                    assert isinstance(what, bytes)
                    line.write(what)
                else:
                    board.press(b"c" if what else b"o")
            ask("SYST:SESS:END")
            board.press(b"c")
            for _, name, values in board.events()[before:]:
                if name == "laser":
                    assert 0.0 <= values[1] <= 0.001
            assert board.outputs()["laser"][0] == 0

        check()
    # The property is not empty: it has been lit on the way, also at the limit itself.
    assert board.count("laser", 1) > 10
    assert any(row[1] == "laser" and row[2] == [1, 0.001] for row in board.events())
