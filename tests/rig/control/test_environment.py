"""Sensors of the air: any line on a serial port, and the BME280 on the board."""

import math
import os
import pty
import threading
import tty

import pytest

from rig.control import sensors
from rig.control.firmware.bme280 import Bme280, Calibration, compensate
from rig.control.protocol import AmbientReading
from rig.control.sensors import AmbientSensor
from rig.control.serial_port import PortLost, SerialLine
from rig.control.settings import EnvironmentSettings
from tests.rig.control.instruments import Instrument
from tests.rig.control.stepped import Clock, InstrumentLine, turn

THREE = r"T=(?P<temperature_c>[-\d.]+) (?:H=(?P<humidity_percent>[\d.]+) )?P=(?P<pressure_hpa>[\d.]+)"


class Sensor(Instrument):
    """Says what it is told to, or the same whenever it is asked."""

    def __init__(self) -> None:
        super().__init__()
        self.plugged_in = True
        self.reading = ""
        self.lines: list[SensorLine] = []

    def answer(self, command: str) -> str:
        return self.reading if command == "READ?" else ""


class SensorLine(InstrumentLine):
    def say(self, data: bytes) -> None:
        self._waiting += data

    def read(self, timeout_s: float) -> bytes:
        assert isinstance(self._instrument, Sensor)
        if not self._instrument.plugged_in:
            raise PortLost("sensor: unplugged")
        return super().read(timeout_s)


@pytest.fixture
def sensor(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Sensor:
    found = Sensor()

    def opened(port: str, *_: object) -> SerialLine:
        if not found.plugged_in:
            raise PortLost(f"{port}: cannot open the serial port")
        found.lines.append(SensorLine(found, clock))
        return found.lines[-1]

    monkeypatch.setattr(sensors, "SerialPort", opened)
    return found


class Read:
    """A service whose sensor says lines unasked."""

    def __init__(self, sensor: Sensor, **stated: float) -> None:
        settings = EnvironmentSettings.model_validate(
            {"kind": "serial", "port": "x", "pattern": THREE, **stated}
        )
        self.sensor, self.service = sensor, AmbientSensor(settings)
        self.pause_s = turn(self.service)

    def say(self, data: bytes) -> AmbientReading:
        self.sensor.lines[-1].say(data)
        turn(self.service)
        return self.service.latest


def test_a_line_in_two_pieces_is_one_and_what_is_missing_is_nan(sensor: Sensor, clock: Clock) -> None:
    read = Read(sensor)
    assert read.pause_s == 0.0
    assert math.isnan(read.say(b"T=21.5 H=40.25 P=1013.").temperature_c)
    assert read.say(b"25\r\n") == AmbientReading(21.5, 40.25, 101325.0)
    assert read.service.last_reading_ns == clock.monotonic_ns()
    assert read.say(b"T=22.0 P=1000\n").temperature_c == 22.0
    assert math.isnan(read.service.latest.humidity_percent)
    assert read.service.lines_without_reading == 0


def test_lines_of_another_kind_are_counted_and_shown(sensor: Sensor) -> None:
    read = Read(sensor)
    for number, text in enumerate((b"garbage\xff\r\n", b"T=1e400 P=1000\n", b"T=. P=1000\n"), 1):
        assert math.isnan(read.say(text).temperature_c)
        assert read.service.lines_without_reading == number
        assert read.service.last_line == text.decode("latin-1").strip()
    # an empty line is none
    read.say(b"\r\n")
    assert read.service.lines_without_reading == 3


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"T=-999 H=40 P=1013\n", (math.nan, 40.0, 101300.0)),
        (b"T=-127.00 P=1013\n", (math.nan, math.nan, 101300.0)),
        (b"T=20 H=999.9 P=0\n", (20.0, math.nan, math.nan)),
    ],
)
def test_what_a_broken_sensor_says_is_no_reading(
    sensor: Sensor, line: bytes, expected: tuple[float, ...]
) -> None:
    read = Read(sensor)
    found = read.say(line)
    values = found.temperature_c, found.humidity_percent, found.pressure_pa
    assert values == pytest.approx(expected, nan_ok=True)
    assert read.service.lines_without_reading == 0
    read.say(b"T=-999 P=0\n")
    assert read.service.lines_without_reading == 1


def test_one_that_must_be_asked_is_asked_once_a_period(sensor: Sensor, clock: Clock) -> None:
    settings = EnvironmentSettings(kind="serial", port="x", request="READ?", period_s=2.0)
    service = AmbientSensor(settings)
    sensor.reading = "20.5, 50.1, 999.9\n"
    began_s = clock.monotonic()
    while clock.monotonic() < began_s + 9.0:
        turn(service)
        clock.sleep(0.01)
    assert sensor.received.count("READ?") == 5
    assert service.latest == AmbientReading(20.5, 50.1, 99990.0)
    sensor.received.clear()
    unasked = AmbientSensor(EnvironmentSettings(kind="serial", port="x", request=""))
    for _ in range(50):
        turn(unasked)
    assert sensor.received == []


def test_an_old_reading_is_not_passed_on_as_the_present_one(sensor: Sensor, clock: Clock) -> None:
    read = Read(sensor, stale_after_s=30.0)
    read.say(b"T=22.0 P=1000\n")
    clock.sleep(29.9)
    assert read.service.latest.temperature_c == 22.0
    clock.sleep(0.2)
    assert math.isnan(read.service.latest.temperature_c)
    assert math.isnan(read.service.latest.pressure_pa)
    # what it said is still there to be looked at
    assert read.service.last_line == "T=22.0 P=1000"


def test_one_that_is_unplugged_is_said_once_and_found_again(sensor: Sensor) -> None:
    read = Read(sensor)
    service = read.service
    sensor.plugged_in = False
    assert turn(service) == 1.0
    assert service.last_error == "sensor: unplugged"
    assert sensor.lines[0].closed
    assert [turn(service), turn(service)] == [1.0, 1.0]
    assert service.take_events() == ("sensor: unplugged", "x: cannot open the serial port")
    sensor.plugged_in = True
    assert turn(service) == 0.0
    assert service.last_error == ""
    assert read.say(b"T=22.0 P=1000\n").temperature_c == 22.0


# Worked example of Bosch's BMP280 data sheet, section 3.12, of the same formulas.
WORDS = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
CALIBRATION_LOW = b"".join((word & 0xFFFF).to_bytes(2, "little") for word in WORDS) + b"\x00\x4b"
CALIBRATION_HIGH = bytes([0x6A, 0x01, 0x00, 0x13, 0x29, 0x03, 0x1E])


def test_bme280_compensation_agrees_with_the_data_sheets_worked_example() -> None:
    found = compensate(Calibration(CALIBRATION_LOW, CALIBRATION_HIGH), 519888, 415148, 30000)
    temperature_c, humidity_percent, pressure_pa = found
    assert temperature_c == pytest.approx(25.08, abs=0.005)
    assert pressure_pa == pytest.approx(100653.27, abs=0.5)
    assert 0.0 < humidity_percent < 100.0


class Bme280Chip:
    """The registers of a BME280 as its data sheet describes them: sections 5.3 and 5.4, reset values 5.3."""

    def __init__(self) -> None:
        self.memory = bytearray(256)
        self.memory[0xD0] = 0x60
        self.memory[0x88:0xA2] = CALIBRATION_LOW
        self.memory[0xE1:0xE8] = CALIBRATION_HIGH
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


@pytest.mark.parametrize("skipped", ["raw_p", "raw_t", "raw_h"])
def test_a_quantity_that_a_bme280_has_not_measured_is_no_reading(skipped: str) -> None:
    """Data sheet, 5.4.7 and 5.4.8: a measurement that was skipped reads 80000h, of humidity 8000h."""
    chip = Bme280Chip()
    sensor = Bme280(chip)
    chip.measure(**{skipped: 0x8000 if skipped == "raw_h" else 0x80000})
    with pytest.raises(OSError, match="not measured yet"):
        sensor.read()


@pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal is POSIX's")
def test_the_rest_of_a_line_that_was_being_sent_is_no_reading() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    over = threading.Event()

    def send() -> None:
        while not over.is_set():
            for byte in b"21.5\n":
                os.write(master, bytes([byte]))
                over.wait(0.002)

    sending = threading.Thread(target=send)
    sending.start()
    settings = EnvironmentSettings(kind="serial", port=os.ttyname(slave), pattern=r"^(?P<temperature_c>\S+)$")
    try:
        for _ in range(5):
            service = AmbientSensor(settings)
            while service.last_reading_ns < 0:
                turn(service)
            assert service.latest.temperature_c == 21.5
            service._finish()
    finally:
        over.set()
        sending.join()
        os.close(master)
        os.close(slave)
