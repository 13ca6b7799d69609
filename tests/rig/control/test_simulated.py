"""The simulated controller in its thread, as a session has it."""

import threading
import time

import pytest

from acquisition.simulation.inputs import RigInputs
from rig.control.controller import Controller, InterlockOpen, PowerLimit
from rig.control.light_permit import LightRefused
from rig.control.protocol import AmbientReading
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings
from rig.control.simulated import simulated_controller
from tests.waiting import until


class Rig(RigInputs):
    """Remembers what its outputs were told."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[tuple[float, str, float]] = []
        self.closed = True

    def _change(self, **changed: float | bool) -> None:
        self.said += [(time.monotonic(), name, float(value)) for name, value in changed.items()]

    def controller(self, settings: ControllerSettings) -> Controller:
        return simulated_controller(settings, 0.001, self, interlock_closed=lambda: self.closed)

    def last(self, name: str) -> float:
        return [value for _, said, value in self.said if said == name][-1]


def simulated(**changes: object) -> ControllerSettings:
    return ControllerSettings.model_validate({"kind": "simulated", "heartbeat_s": 0.05, **changes})


def test_simulated_rig_is_driven_through_the_real_protocol() -> None:
    rig = Rig()
    control = simulated()
    with ControlService(rig.controller(control), control) as service:
        assert service.wait_open().serial == "SIMULATED"
        service.set_laser_power_w(0.0004).result(5.0)
        service.laser_on().result(5.0)
        assert rig.last("laser_w") == pytest.approx(0.0004)
        service.submit(lambda c: c.hold()).result(5.0)
        service.submit(lambda c: c.release()).result(5.0)
        assert rig.last("magnet") == 0.0
        service.submit(lambda c: c.starter_pulse(0.1)).result(5.0)
        until(lambda: rig.last("starter") == 0.0)
        began, ended = [at for at, name, _ in rig.said if name == "starter"][-2:]
        assert ended - began >= 0.095
        with pytest.raises(PowerLimit):
            service.set_laser_power_w(0.0011).result(5.0)
        until(lambda: service.snapshot.environment == AmbientReading(20.0, 45.0, 101325.0))
        rig.closed = False
        until(lambda: rig.last("laser_w") == 0.0)
        # by the board, or by the permit once it has heard
        with pytest.raises((InterlockOpen, LightRefused)):
            service.laser_on().result(5.0)
    assert rig.last("laser_w") == 0.0


def test_simulated_watchdog_needs_nobody() -> None:
    rig = Rig()
    control = simulated(heartbeat_s=0.05, watchdog_s=1.5)
    controller = rig.controller(control)
    controller.open()
    controller.set_laser_power_w(0.001)
    controller.laser_on()
    assert rig.last("laser_w") == 0.001
    until(lambda: rig.last("laser_w") == 0.0)
    controller.close()
    until(lambda: not any(thread.name == "simulated-board" for thread in threading.enumerate()))
