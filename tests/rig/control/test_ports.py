"""Checks of what is plugged in, and the settings of the devices: each says what to do."""

import math
from pathlib import Path

import pytest
from pydantic import ValidationError

from rig.control import sensors
from rig.control.controller import Controller
from rig.control.lasers import LaserSettings, serial_laser
from rig.control.ports import check_controller, check_environment, check_laser, list_serial_ports
from rig.control.serial_port import PortLost
from rig.control.settings import ControllerSettings, EnvironmentKind, EnvironmentSettings
from rig.control.usbtmc import UsbTmcLine, find_usbtmc, is_usbtmc
from rig.terminal import Verdict
from tests.rig.control.instruments import FakeCobolt, Instrument
from tests.rig.control.stepped import Clock, InstrumentLine, SteppedBoard


def by_name(checks: tuple[Verdict, ...]) -> dict[str, Verdict]:
    return {check.name: check for check in checks}


def test_ports_are_listed_without_being_opened() -> None:
    ports = list_serial_ports()
    assert [port.device for port in ports] == sorted(port.device for port in ports)


class TestController:
    @pytest.fixture
    def board(self, clock: Clock) -> SteppedBoard:
        return SteppedBoard(clock)

    def checks(
        self, board: SteppedBoard, laser: LaserSettings, sensor: EnvironmentKind = "controller"
    ) -> dict[str, Verdict]:
        settings, environment = ControllerSettings(kind="serial", port="stepped"), EnvironmentSettings
        controller = Controller(settings, laser.max_power_w, board.open_line)
        found = by_name(check_controller(controller, settings, laser, environment(kind=sensor), "mine.toml"))
        assert all(bool(check.remedy) is not check.ok for check in found.values())
        # nothing was switched on on the way
        assert not any(board.count(name, 1) for name in ("laser", "magnet", "starter", "clamp", "brake"))
        return found

    def test_all_is_well(self, board: SteppedBoard) -> None:
        found = self.checks(board, LaserSettings(kind="controller", power_w=0.001))
        assert all(check.ok for check in found.values())
        assert found["controller"].reason == "serial TEST0001, firmware 1.4"
        assert found["interlock"].reason == "closed"
        assert found["controller's sensor"].reason == "20.12 °C, 45.5 %, 1013.2 hPa"

    def test_an_open_interlock_a_low_limit_and_no_sensor(self, board: SteppedBoard) -> None:
        board.closed = board.sensor_works = False
        found = self.checks(board, LaserSettings(kind="controller", power_w=0.0011, max_power_w=0.002))
        assert found["controller"].ok
        assert found["interlock"].reason == "open: the laser stays off"
        assert "limits.json" in found["laser power"].remedy
        # what is open at the start is latched, too
        assert found["controller's latch"].reason == "INTERLOCK is latched: no light until it is acknowledged"
        assert found["controller errors"].reason == "Hardware error; environment sensor (-240)"
        assert found["controller's sensor"].reason == "no reading"

    def test_a_board_without_a_sensor_is_well_where_none_is_configured(self, board: SteppedBoard) -> None:
        board.sensor_works = False
        assert all(check.ok for check in self.checks(board, LaserSettings(), "none").values())

    def test_an_output_that_is_stuck_is_named(
        self, board: SteppedBoard, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(board, "laser_enabled", lambda: True)
        board.light = True
        found = self.checks(board, LaserSettings(kind="controller"))
        assert found["laser output"].reason == (
            "it is off, and the pin of its relay is high and the photodiode sees light"
        )
        assert found["controller's latch"].reason == "OUTPUT is latched: no light until it is acknowledged"

    def test_another_laser_has_another_limit(self, board: SteppedBoard) -> None:
        assert "laser power" not in self.checks(board, LaserSettings(kind="cobolt", port="x"))

    def test_none_and_a_missing_one(self, board: SteppedBoard) -> None:
        laser = LaserSettings()
        board.unplug()
        assert not self.checks(board, laser)["controller"].ok
        nothing = ControllerSettings()
        (check,) = check_controller(
            Controller(nothing, 0.001, board.open_line), nothing, laser, EnvironmentSettings(), ""
        )
        assert (check.ok, check.made) == (True, False)


def test_a_laser_without_watchdog_is_warned_of_and_its_wiring_tried(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    instrument = FakeCobolt()
    monkeypatch.setattr(serial_laser, "SerialPort", lambda *_, **__: InstrumentLine(instrument, clock))
    name = "laser switches off automatically"
    own = LaserSettings(kind="cobolt", port="y")
    wired = LaserSettings(kind="cobolt", port="y", interlock="controller")
    found = by_name(check_laser(own))
    assert all(check.ok for check in found.values())
    assert "stays on if the program is killed" in found[name].reason
    assert "enable relay" in found[name].remedy
    assert not found["laser interlock"].remedy
    # said to be wired through the relay, which is open: closed all the same means that it is not
    assert not by_name(check_laser(wired))[name].ok
    instrument.interlock_closed = False
    assert all(check.ok and not check.remedy for check in check_laser(wired))
    assert by_name(check_laser(own))["laser interlock"].remedy
    instrument.fault, instrument.interlock_closed = 4, True
    fault = by_name(check_laser(own))["laser fault"]
    assert (fault.ok, fault.reason) == (False, "constant-power time-out")
    instrument.silent = True
    (silent,) = check_laser(own)
    assert not silent.ok
    assert check_laser(LaserSettings()) == ()


@pytest.mark.parametrize(
    ("line", "request_text", "ok", "reason"),
    [
        ("20.5, 50.1, 999.9\n", "READ?", True, "20.5, 50.1, 999.9"),
        ("hello\n", "READ?", False, "'hello' does not match the pattern"),
        ("20.5, 50.1, 999.9\n", "", False, "no line within 5 s"),
    ],
)
def test_the_check_of_a_sensor_names_the_line_that_does_not_match(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, line: str, request_text: str, ok: bool, reason: str
) -> None:
    class Sensor(Instrument):
        def answer(self, command: str) -> str:
            return line

    monkeypatch.setattr(sensors, "SerialPort", lambda *_: InstrumentLine(Sensor(), clock))
    began_s = clock.monotonic()
    (check,) = check_environment(EnvironmentSettings(kind="serial", port="x", request=request_text))
    assert (check.ok, check.reason) == (ok, reason)
    assert bool(check.remedy) is not ok
    assert clock.monotonic() - began_s < 5.2
    assert check_environment(EnvironmentSettings()) == ()


def test_the_check_of_a_missing_sensor() -> None:
    (check,) = check_environment(EnvironmentSettings(kind="serial", port="/dev/ttyNoSuchPort"))
    assert not check.ok
    assert check.reason.startswith("/dev/ttyNoSuchPort: cannot open the serial port")


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
        (EnvironmentSettings, {"pattern": "(?P<temp>.*)"}, "it must name at least one of"),
        (EnvironmentSettings, {"kind": "serial"}, "port is missing"),
    ],
)
def test_settings_say_what_is_wrong(model: type, values: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        model(**values)


def plugged(folder: Path, number: int, vendor: str, serial: str) -> None:
    """As the kernel shows an instrument: the class device of an interface below the USB device."""
    usb = folder / f"usb{number}"
    (usb / "1:1.0").mkdir(parents=True)
    (usb / "idVendor").write_text(vendor + "\n")
    (usb / "serial").write_text(serial + "\n")
    node = folder / "class" / f"usbtmc{number}"
    node.mkdir(parents=True)
    (node / "device").symlink_to(usb / "1:1.0")


def test_an_instrument_is_found_by_vendor_and_serial_number(tmp_path: Path) -> None:
    devices = tmp_path / "class"
    plugged(tmp_path, 0, "0957", "MY1")
    plugged(tmp_path, 1, "1313", "M1")
    assert find_usbtmc("usbtmc", 0x1313, devices) == "/dev/usbtmc1"
    plugged(tmp_path, 2, "1313", "M2")
    assert find_usbtmc("usbtmc:M2", 0x1313, devices) == "/dev/usbtmc2"
    with pytest.raises(
        PortLost, match="2 USBTMC instruments of vendor 1313 fit, there is usbtmc:M1, usbtmc:M2"
    ):
        find_usbtmc("usbtmc", 0x1313, devices)
    with pytest.raises(PortLost, match="usbtmc:M3: 0 USBTMC instruments"):
        find_usbtmc("usbtmc:M3", 0x1313, devices)
    assert find_usbtmc("/dev/usbtmc7", 0x1313, devices) == "/dev/usbtmc7"


def test_serial_ports_are_told_apart_and_a_missing_instrument_is_named() -> None:
    ports = ("usbtmc", "usbtmc:M1", "/dev/usbtmc0", "/dev/ttyUSB0", "socket://box:7000")
    assert [is_usbtmc(port) for port in ports] == [True, True, True, False, False]
    with pytest.raises(PortLost, match="/dev/usbtmc99: cannot open the instrument: No such file"):
        UsbTmcLine("/dev/usbtmc99", 0.5)
