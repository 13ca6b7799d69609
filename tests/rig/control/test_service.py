"""The controller's thread on a real interpreter: reconnection, no leaks."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from rig.control.controller import Controller
from rig.control.serial_port import PortLost
from rig.control.service import ControlService, ControlState
from tests.rig.control.conftest import settings_for
from tests.rig.control.wires import FirmwareBoard
from tests.waiting import until


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
