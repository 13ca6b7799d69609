"""The simulated controller in its thread, as a session has it."""

import threading

import pytest

from acquisition.simulation.inputs import RigInputs
from rig.control.controller import PowerLimit
from rig.control.protocol import AmbientReading
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings
from rig.control.simulated import simulated_controller
from tests.waiting import until


class Rig(RigInputs):
    """Remembers what its outputs were told."""

    def __init__(self) -> None:
        super().__init__()
        self.said: dict[str, list[float]] = {}
        self.closed = True

    def _change(self, **changed: float | bool) -> None:
        for name, value in changed.items():
            self.said.setdefault(name, []).append(value)


def test_a_simulated_rig_is_driven_through_the_real_protocol_and_its_watchdog_needs_nobody() -> None:
    rig = Rig()
    settings = ControllerSettings(kind="simulated", heartbeat_s=0.05, watchdog_s=1.5)
    controller = simulated_controller(settings, 0.001, rig, interlock_closed=lambda: rig.closed)
    with ControlService(controller, settings) as service:
        assert service.wait_open().serial == "SIMULATED"
        service.set_laser_power_w(0.0004).result(5.0)
        service.laser_on().result(5.0)
        assert rig.said["laser_w"][-1] == pytest.approx(0.0004)
        service.submit(lambda c: c.hold()).result(5.0)
        service.submit(lambda c: c.release()).result(5.0)
        service.submit(lambda c: c.starter_pulse(0.02)).result(5.0)
        until(lambda: rig.said["starter"][-2:] == [1.0, 0.0])
        assert rig.said["magnet"][-2:] == [1.0, 0.0]
        with pytest.raises(PowerLimit):
            service.set_laser_power_w(0.0011).result(5.0)
        until(lambda: service.snapshot.environment == AmbientReading(20.0, 45.0, 101325.0))
        rig.closed = False
        until(lambda: rig.said["laser_w"][-1] == 0.0)
        rig.closed = True
    controller.open()
    controller.acknowledge(1)
    controller.set_laser_power_w(0.0004)
    controller.laser_on()
    assert rig.said["laser_w"][-1] > 0.0
    until(lambda: rig.said["laser_w"][-1] == 0.0)
    controller.close()
    until(lambda: not any(thread.name == "simulated-board" for thread in threading.enumerate()))
