"""The simulated controller in its thread, as a session has it."""

import threading
import time
from contextlib import ExitStack

import pytest

from acquisition.simulation.inputs import RigInputs
from rig.control.controller import Controller, InterlockOpen, PowerLimit
from rig.control.light_permit import LightRefused
from rig.control.protocol import AirReading
from rig.control.service import ControlService, ControlState
from rig.control.settings import ControllerSettings, SerialFaults
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
        until(lambda: service.snapshot.environment == AirReading(20.0, 45.0, 101325.0))
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


def test_serial_junk_by_setting_is_survived() -> None:
    rig = Rig()
    faults = SerialFaults(junk_probability=0.15, loss_probability=0.15)
    control = simulated(faults=faults, timeout_s=0.05, retries=6)
    with ControlService(rig.controller(control), control) as service:
        service.wait_open(20.0)
        service.laser_on().result(10.0)
        powers = [1e-5 * i for i in range(1, 31)]
        for future in [service.submit(lambda c, p=p: c.set_laser_power_w(p), 60.0) for p in powers]:  # type: ignore[misc]
            future.result(60.0)
        until(lambda: service.snapshot.junk_lines > 0 and service.snapshot.retried > 0)
    lit = [value for _, name, value in rig.said if name == "laser_w" and value > 0]
    assert lit == pytest.approx(powers, rel=2e-6)


def test_reset_and_unplug_by_setting() -> None:
    services = []
    with ExitStack() as stack:
        for faults in (SerialFaults(reset_at_s=0.5), SerialFaults(unplug_at_s=1.0)):
            control = simulated(faults=faults)
            services.append(
                stack.enter_context(ControlService(simulated_controller(control, 0.001), control))
            )
            services[-1].wait_open()
        reset, unplugged = services
        until(lambda: reset.snapshot.reconnects >= 1)
        until(lambda: unplugged.snapshot.state is ControlState.LOST)
        assert "simulated controller" in unplugged.snapshot.last_error
