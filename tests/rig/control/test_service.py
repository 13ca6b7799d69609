"""The controller's thread on a real interpreter: reconnection, many callers, no leaks."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from processing.errors import DeviceError
from rig.control.controller import Controller, PowerLimit
from rig.control.serial_port import PortLost
from rig.control.service import ControlService, ControlState
from tests.rig.control.conftest import settings_for
from tests.rig.control.wires import FirmwareBoard
from tests.waiting import until


def test_snapshot_follows_the_board_and_many_may_call_at_once(board: FirmwareBoard) -> None:
    control = settings_for(board.port, heartbeat_s=0.05)
    with ControlService(Controller(control, 0.001), control, environment_period_s=0.1) as service:
        assert service.wait_open(10.0).serial == "TEST0001"
        service.set_laser_power_w(0.0003).result(5.0)
        service.laser_on().result(5.0)
        until(lambda: (s := service.snapshot.status) is not None and s.laser_on and s.laser_power_w == 0.0003)
        until(lambda: service.snapshot.environment.temperature_c == 20.125)
        with pytest.raises(PowerLimit):
            service.set_laser_power_w(1.0).result(5.0)
        assert service.snapshot.state is ControlState.OPEN
        readings: list[float] = []

        def call() -> None:
            for _ in range(50):
                readings.append(service.submit(lambda c: c.environment(), 20.0).result(20.0).temperature_c)

        threads = [threading.Thread(target=call) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert readings == [20.125] * 200
    assert service.snapshot.state is ControlState.CLOSED
    assert board.outputs()["laser"][0] == 0
    with pytest.raises(DeviceError, match="closed"):
        service.laser_on().result(1.0)


def test_unplugged_and_plugged_in_again(make_board: Callable[..., FirmwareBoard], tmp_path: Path) -> None:
    first = make_board(through_wire=True)
    # As udev does: the name stays, the device behind it changes.
    name = tmp_path / "rig-controller"
    name.symlink_to(first.port)
    control = settings_for(str(name), heartbeat_s=0.05)
    with ControlService(Controller(control, 0.001), control) as service:
        service.wait_open(10.0)
        first.wire.unplug()
        until(lambda: service.snapshot.state is ControlState.LOST)
        assert service.snapshot.status is None
        with pytest.raises(PortLost):
            service.laser_on().result(5.0)
        second = make_board()
        name.unlink()
        name.symlink_to(second.port)
        until(lambda: service.snapshot.state is ControlState.OPEN)
        service.laser_on().result(5.0)
        assert second.outputs()["laser"][0] == 1
        assert service.snapshot.reconnects >= 1


def test_no_descriptor_is_left_behind(board: FirmwareBoard) -> None:
    control = settings_for(board.port)
    missing = settings_for("/dev/ttyNoSuchPort")

    def open_and_close() -> None:
        with ControlService(Controller(control, 0.001), control) as service:
            service.wait_open(10.0)
        with pytest.raises(PortLost):
            Controller(missing, 0.001).open()

    open_and_close()
    before = len(os.listdir("/proc/self/fd"))
    threads = threading.active_count()
    for _ in range(10):
        open_and_close()
    assert len(os.listdir("/proc/self/fd")) == before
    assert threading.active_count() == threads
