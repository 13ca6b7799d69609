"""Laser and magnet switch off without the host, and no power above a limit is accepted."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from rig.control.controller import Controller
from rig.control.protocol import ControllerReset
from rig.control.service import ControlService
from tests.rig.control.conftest import settings_for
from tests.rig.control.wires import FirmwareBoard

# The watchdog's time, a turn of the loop, and a machine that is busy with other tests.
DARK_WITHIN_S = 30.0
WATCHDOG_S = 1.5
LIGHTS = f"""
import os, signal, sys
from rig.control.controller import Controller
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings

def fail(*_):
    raise RuntimeError("the program's own fault")

signal.signal(signal.SIGUSR1, fail)
signal.signal(signal.SIGUSR2, lambda *_: service.close())
for port in sys.argv[1:]:
    if os.fork() == 0:
        settings = ControllerSettings(
            kind="serial", port=port, timeout_s=0.5, heartbeat_s=0.1, watchdog_s={WATCHDOG_S}
        )
        service = ControlService(Controller(settings, 0.001), settings)
        service.start()
        service.wait_open(10.0)
        service.set_laser_power_w(0.0005).result(5.0)
        service.laser_on().result(5.0)
        service.submit(lambda c: c.hold()).result(5.0)
        print(port, os.getpid(), flush=True)
        while True:
            signal.pause()
signal.pause()
"""
"""Programs that switch laser and magnet of a board each on, and fail or close when they are told to."""


@pytest.mark.slow
def test_however_a_program_ends_the_board_goes_dark(make_board: Callable[..., FirmwareBoard]) -> None:
    """At the same time, each with a board of its own."""
    boards = {make_board(): how for how in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGKILL, signal.SIGSTOP)}
    words = [sys.executable, "-c", LIGHTS, *(board.port for board in boards)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as programs:
        assert programs.stdout is not None
        lit = dict(programs.stdout.readline().split() for _ in boards)
        try:
            # Alive, they stay lit for longer than the watchdog waits: the heartbeat does its work.
            time.sleep(2 * WATCHDOG_S)
            for board, how in boards.items():
                assert board.outputs()["laser"] == [1, 0.0005]
                assert board.outputs()["magnet"] == [1]
                os.kill(int(lit[board.port]), how)
            for board in boards:
                board.wait_for(lambda board=board: board.is_safe, DARK_WITHIN_S)  # type: ignore[misc]
            # One that was stopped wakes up and finds its session gone; nothing lights by itself.
            for board, how in boards.items():
                if how is signal.SIGSTOP:
                    os.kill(int(lit[board.port]), signal.SIGCONT)
            time.sleep(0.5)
            assert all(board.is_safe for board in boards)
        finally:
            for pid in lit.values():
                with suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGKILL)
            programs.kill()


def test_cable_pulled_while_the_program_lives(make_board: Callable[..., FirmwareBoard]) -> None:
    board = make_board(through_wire=True)
    before = len(os.listdir("/proc/self/fd")), threading.active_count()
    control = settings_for(board.port, timeout_s=0.2, heartbeat_s=0.1, watchdog_s=1.5)
    with ControlService(Controller(control, 0.001), control) as service:
        service.wait_open(10.0)
        service.laser_on().result(5.0)
        service.submit(lambda c: c.hold()).result(5.0)
        assert board.outputs()["laser"][0] == 1
        board.wire.connected = False
        board.wait_for(lambda: board.is_safe, DARK_WITHIN_S)
        board.wire.connected = True
        # Plugged in again: the service finds the controller, reports it, and lights nothing.
        said: list[str] = []

        def connected_again() -> bool:
            said.extend(service.take_events())
            return " / ".join(said).count("TEST0001 is connected") == 2

        board.wait_for(connected_again, 30.0)
        assert board.is_safe
        assert any("no reply" in text or "no session" in text for text in said)
    assert (len(os.listdir("/proc/self/fd")), threading.active_count()) == before


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
