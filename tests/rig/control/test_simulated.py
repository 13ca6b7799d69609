"""The simulated controller, the environment sensor on any serial port, ports and checks, settings."""

import math
import os
import pty
import re
import threading
import time
import tty
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from processing.errors import DeviceError
from rig.control.controller import AirReading, InterlockOpen, PowerLimit
from rig.control.environment import EnvironmentService, parse_environment
from rig.control.firmware.bme280 import Bme280, Calibration, compensate
from rig.control.firmware.core import Firmware
from rig.control.lasers import LaserSettings
from rig.control.ports import check_controller, check_environment, check_laser, list_serial_ports
from rig.control.service import ControlService, ControlState
from rig.control.settings import ControllerSettings, EnvironmentSettings, SerialFaults
from rig.control.simulated import SimulatedOutputs, simulated_controller
from tests.rig.control.instruments import FakeCobolt
from tests.rig.control.test_service import until

pytestmark = pytest.mark.realtime


class Rig:
    """Remembers what its outputs were told."""

    def __init__(self) -> None:
        self.said: list[tuple[float, str, float]] = []
        self.closed = True

    def outputs(self) -> SimulatedOutputs:
        def say(name: str) -> object:
            return lambda value: self.said.append((time.monotonic(), name, float(value)))

        names = ("laser", "magnet", "starter", "clamp", "brake")
        wires = {name: say(name) for name in names}
        return SimulatedOutputs(interlock_closed=lambda: self.closed, **wires)  # type: ignore[arg-type]

    def last(self, name: str) -> float:
        return [value for _, said, value in self.said if said == name][-1]


def simulated(**changes: object) -> ControllerSettings:
    return ControllerSettings.model_validate({"kind": "simulated", "heartbeat_s": 0.05, **changes})


def test_simulated_rig_is_driven_through_the_real_protocol() -> None:
    rig = Rig()
    control = simulated()
    with ControlService(simulated_controller(control, 0.001, rig.outputs()), control) as service:
        assert service.wait_open().serial == "SIMULATED"
        service.set_laser_power_w(0.0004).result(5.0)
        service.laser_on().result(5.0)
        assert rig.last("laser") == pytest.approx(0.0004)
        service.hold().result(5.0)
        service.release().result(5.0)
        assert rig.last("magnet") == 0.0
        service.starter_pulse(0.1).result(5.0)
        until(lambda: rig.last("starter") == 0.0)
        began, ended = [at for at, name, _ in rig.said if name == "starter"][-2:]
        assert ended - began >= 0.095
        with pytest.raises(PowerLimit):
            service.set_laser_power_w(0.0011).result(5.0)
        until(lambda: service.snapshot.environment == AirReading(20.0, 45.0, 101325.0))
        rig.closed = False
        until(lambda: rig.last("laser") == 0.0)
        with pytest.raises(InterlockOpen):
            service.laser_on().result(5.0)
    assert rig.last("laser") == 0.0


def test_simulated_watchdog_needs_nobody() -> None:
    rig = Rig()
    control = simulated(heartbeat_s=0.05, watchdog_s=1.5)
    controller = simulated_controller(control, 0.001, rig.outputs())
    controller.open()
    controller.set_laser_power_w(0.001)
    controller.laser_on()
    assert rig.last("laser") == 0.001
    until(lambda: rig.last("laser") == 0.0)
    controller.close()
    until(lambda: not any(thread.name == "simulated-board" for thread in threading.enumerate()))


def test_serial_junk_by_setting_is_survived() -> None:
    rig = Rig()
    faults = SerialFaults(junk_probability=0.15, loss_probability=0.15)
    control = simulated(faults=faults, timeout_s=0.05, retries=6)
    with ControlService(simulated_controller(control, 0.001, rig.outputs()), control) as service:
        service.wait_open(20.0)
        service.laser_on().result(10.0)
        powers = [1e-5 * i for i in range(1, 60)]
        for future in [service.submit(lambda c, p=p: c.set_laser_power_w(p), 60.0) for p in powers]:  # type: ignore[misc]
            future.result(60.0)
        until(lambda: service.snapshot.junk_lines > 0 and service.snapshot.retried > 0)
    lit = [value for _, name, value in rig.said if name == "laser" and value > 0]
    assert lit == pytest.approx(powers, rel=2e-6)


def test_reset_and_unplug_by_setting() -> None:
    control = simulated(faults=SerialFaults(reset_at_s=0.5, unplug_at_s=4.0))
    with ControlService(simulated_controller(control, 0.001), control) as service:
        service.wait_open()
        until(lambda: service.snapshot.reconnects >= 1)
        until(lambda: service.snapshot.state is ControlState.LOST)
        assert "simulated controller" in service.snapshot.last_error


# -- environment ---------------------------------------------------------------


@pytest.fixture
def sensor() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_sensor_that_writes_lines(sensor: tuple[int, str]) -> None:
    master, port = sensor
    pattern = r"T=(?P<temperature_c>[-\d.]+) (?:H=(?P<humidity_percent>[\d.]+) )?P=(?P<pressure_hpa>[\d.]+)"
    with EnvironmentService(EnvironmentSettings(kind="serial", port=port, pattern=pattern)) as service:
        assert math.isnan(service.latest.environment.temperature_c)
        # what comes before the port is open is lost, as with any sensor
        until(lambda: os.write(master, b"garbage\xff\r\n") > 0 and service.latest.unread_lines > 0)
        os.write(master, b"T=21.5 H=40.25 P=1013.")
        time.sleep(0.05)
        os.write(master, b"25\r\n")
        until(lambda: service.latest.environment == AirReading(21.5, 40.25, 101325.0))
        os.write(master, b"T=22.0 P=1000\n")
        until(lambda: service.latest.environment.temperature_c == 22.0)
        assert math.isnan(service.latest.environment.humidity_percent)


def test_sensor_that_must_be_asked_and_falls_silent(sensor: tuple[int, str]) -> None:
    master, port = sensor
    settings = EnvironmentSettings(
        kind="serial", port=port, request="READ?", period_s=0.05, stale_after_s=2.0
    )
    with EnvironmentService(settings) as service:
        for _ in range(3):
            assert b"READ?\n" in os.read(master, 100)
            os.write(master, b"20.5, 50.1, 999.9\n")
        until(lambda: service.latest.environment.temperature_c == 20.5)
        # An old reading is not passed on as the present one.
        until(lambda: math.isnan(service.latest.environment.temperature_c))


def test_missing_sensor_is_reported_and_awaited() -> None:
    with EnvironmentService(EnvironmentSettings(kind="serial", port="/dev/ttyNoSuchPort")) as service:
        until(lambda: "/dev/ttyNoSuchPort" in service.latest.last_error)
    assert service.failure is None


@given(st.text(max_size=60))
def test_any_line_parses_or_not_but_never_breaks(line: str) -> None:
    pattern = re.compile(EnvironmentSettings().pattern)
    environment = parse_environment(pattern, line)
    assert environment is None or math.isfinite(environment.temperature_c)


def test_bme280_compensation_agrees_with_the_data_sheets_worked_example() -> None:
    # Worked example of Bosch's BMP280 data sheet, section 3.12, of the same formulas.
    words = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
    low = b"".join((word & 0xFFFF).to_bytes(2, "little") for word in words) + b"\x00\x4b"
    high = bytes([0x6A, 0x01, 0x00, 0x13, 0x29, 0x03, 0x1E])
    temperature_c, humidity_percent, pressure_pa = compensate(Calibration(low, high), 519888, 415148, 30000)
    assert temperature_c == pytest.approx(25.08, abs=0.005)
    assert pressure_pa == pytest.approx(100653.27, abs=0.5)
    assert 0.0 < humidity_percent < 100.0


class Bme280Chip:
    """The registers of a BME280 as its data sheet describes them: sections 5.3 and 5.4, reset values 5.3."""

    def __init__(self) -> None:
        words = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
        self.memory = bytearray(256)
        self.memory[0xD0] = 0x60
        self.memory[0x88:0xA0] = b"".join((word & 0xFFFF).to_bytes(2, "little") for word in words)
        self.memory[0xA1] = 0x4B
        self.memory[0xE1:0xE8] = bytes([0x6A, 0x01, 0x00, 0x13, 0x29, 0x03, 0x1E])
        self.power_up()

    def power_up(self) -> None:
        self.memory[0xF2:0xF6] = bytes(4)
        self.memory[0xF7:0xFF] = bytes([0x80, 0, 0, 0x80, 0, 0, 0x80, 0])

    def measure(self, raw_p: int = 415148, raw_t: int = 519888, raw_h: int = 30000) -> None:
        if self.memory[0xF4] & 3 == 3:
            self.memory[0xF7:0xFF] = (
                (raw_p << 4).to_bytes(3, "big") + (raw_t << 4).to_bytes(3, "big") + raw_h.to_bytes(2, "big")
            )

    def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
        return bytes(self.memory[register : register + count])

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        self.memory[register] = data[0]


def test_a_bme280_that_lost_its_supply_is_set_up_again_and_reads_nothing_meanwhile() -> None:
    chip = Bme280Chip()
    sensor = Bme280(chip)
    with pytest.raises(OSError, match="not measured yet"):
        sensor.read()
    chip.measure()
    assert sensor.read()[0] == pytest.approx(25.08, abs=0.005)
    chip.power_up()
    with pytest.raises(OSError, match="lost its settings"):
        sensor.read()
    chip.measure()
    assert sensor.read()[0] == pytest.approx(25.08, abs=0.005)
    chip.measure(raw_p=1_000_000)
    with pytest.raises(OSError, match="outside its range"):
        sensor.read()


@pytest.mark.parametrize("status", ["1,1,1,0.001,0,0,0,0,NONE,many", "1,maybe,1,0.001,0,0,0,0,NONE,0", "1,2"])
def test_a_status_that_makes_no_sense_does_not_end_the_service(
    status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its checksum is right: the board itself speaks nonsense for a while."""
    usual, sensible = Firmware._status, threading.Event()

    def nonsense(firmware: Firmware, argument: str) -> str:
        return usual(firmware, argument) if sensible.is_set() else status

    monkeypatch.setattr(Firmware, "_status", nonsense)
    settings = simulated()
    with ControlService(simulated_controller(settings, 0.001), settings) as service:
        service.wait_open()
        until(lambda: any(repr(status) in event for event in service.take_events()))
        assert service.failure is None
        sensible.set()
        until(lambda: service.snapshot.status is not None)


# -- ports and checks ------------------------------------------------------------


def test_ports_are_listed_without_being_opened() -> None:
    ports = list_serial_ports()
    assert [port.device for port in ports] == sorted(port.device for port in ports)


def test_checks_say_what_to_do() -> None:
    rig = Rig()
    control = simulated()
    laser = LaserSettings(kind="controller", power_w=0.001)
    controller = simulated_controller(control, laser.max_power_w, rig.outputs(), stored_laser_max_w=0.0005)
    rig.closed = False
    checks = {check.name: check for check in check_controller(controller, control, laser)}
    assert checks["controller"].ok
    assert not checks["interlock"].ok
    assert "limits.json" in checks["laser power"].remedy
    assert checks["controller's sensor"].ok
    assert all(check.remedy for check in checks.values() if not check.ok)
    missing = ControllerSettings(kind="serial", port="/dev/ttyNoSuchPort")
    (check,) = check_controller(
        simulated_controller(simulated(faults=SerialFaults(unplug_at_s=0)), 0.001), missing, laser
    )
    assert not check.ok
    assert check.remedy


def test_a_laser_without_watchdog_is_warned_of_and_its_wiring_tried() -> None:
    instrument = FakeCobolt()
    name = "laser switches off by itself"
    board = ControllerSettings(kind="serial", port="x")
    own = LaserSettings(kind="cobolt", port=instrument.port)
    wired = LaserSettings(kind="cobolt", port=instrument.port, interlock="controller")
    try:
        (warning,) = [check for check in check_laser(own, board) if check.name == name]
        assert warning.ok
        assert "stays on if the program is killed" in warning.reason
        assert "enable relay" in warning.remedy
        # said to be wired through the relay, which is open: closed all the same means that it is not
        (not_wired,) = [check for check in check_laser(wired, board) if check.name == name]
        assert not not_wired.ok
        instrument.interlock_closed = False
        assert all(check.ok and not check.remedy for check in check_laser(wired, board))
        assert not all(check.ok for check in check_laser(wired, ControllerSettings()))
    finally:
        instrument.close()


def test_environment_check_names_the_line_that_does_not_match(sensor: tuple[int, str]) -> None:
    master, port = sensor
    ended = threading.Event()

    def write() -> None:
        while not ended.wait(0.05):
            os.write(master, b"hello\n")

    writer = threading.Thread(target=write)
    writer.start()
    (check,) = check_environment(EnvironmentSettings(kind="serial", port=port), patience_s=1.0)
    ended.set()
    writer.join()
    assert not check.ok
    assert "'hello' does not match" in check.reason


# -- settings ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (ControllerSettings, {"kind": "serial"}, "port is missing"),
        (ControllerSettings, {"heartbeat_s": 1.0, "watchdog_s": 1.5}, "two heartbeats"),
        (LaserSettings, {"power_w": 0.002, "max_power_w": 0.001}, "above max_power_w"),
        (LaserSettings, {"current_a": 0.002}, "above max_current_a"),
        (LaserSettings, {"power_w": math.nan}, "finite number"),
        (LaserSettings, {"kind": "obis"}, "port is missing"),
        (EnvironmentSettings, {"pattern": "("}, "not a regular expression"),
        (EnvironmentSettings, {"pattern": "(?P<temp>.*)"}, "is needed and no other"),
    ],
)
def test_settings_say_what_is_wrong(model: type, values: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        model(**values)


def test_a_board_whose_firmware_knows_no_pulses_is_named() -> None:
    controller = simulated_controller(simulated(), 0.001)
    controller.open()
    controller.set_laser_pulse(0.0, 20.0)
    firmware = controller._open_line.__self__._firmware  # type: ignore[attr-defined]
    for spelling in [
        name for name in firmware._acting if name.endswith(("PULS", "LASER:PULSE", "LAS:PULSE"))
    ]:
        del firmware._acting[spelling]
    with pytest.raises(DeviceError, match="knows no pulses; flash the one that came with this version"):
        controller.set_laser_pulse(0.0, 20.0)
    controller.close()
