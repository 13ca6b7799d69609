"""Serial ports: their list, checks of the configured devices on them, and udev rules for access to them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from serial.tools import list_ports

from processing.errors import DeviceError
from rig.control.controller import Controller
from rig.control.lasers import LaserSettings, make_laser
from rig.control.lasers.thorlabs4000 import USB_VENDOR as THORLABS_VENDOR
from rig.control.protocol import ControllerStatus
from rig.control.sensors import AmbientSensor
from rig.control.serial_port import ports_here
from rig.control.settings import ControllerSettings, EnvironmentSettings
from rig.terminal import Verdict

_PICO_VENDOR = 0x2E8A
"""Raspberry Pi's USB vendor number, under which MicroPython presents the controller's board."""
UDEV_MATCHES = {
    "laser drivers that the kernel's usbtmc serves": (
        f'SUBSYSTEM=="usbmisc", KERNEL=="usbtmc*", ATTRS{{idVendor}}=="{THORLABS_VENDOR:04x}"'
    ),
    "serial ports on USB: the controller's board, lasers, sensors": (
        'SUBSYSTEM=="tty", KERNEL=="ttyACM[0-9]*|ttyUSB[0-9]*", SUBSYSTEMS=="usb"'
    ),
}
"""Conditions of udev rules that match the device nodes, by kind of device."""
UDEV_BOARD = f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{_PICO_VENDOR:04x}"'
"""Condition of a udev rule that matches the controller's board itself."""
_SENSOR_TIMEOUT_S = 5.0
_TRIP_ERRORS = range(101, 105)
"""Error codes of the board that report trips; its latch reports them in more detail."""


@dataclass(frozen=True, slots=True)
class SerialPortInfo:
    """A serial port of this computer; `vendor` and `product` are its USB numbers, -1 if it has none."""

    device: str
    description: str
    vendor: int
    product: int
    serial: str


def list_serial_ports() -> tuple[SerialPortInfo, ...]:
    """All serial ports of this computer, sorted by name; none of them is opened."""
    ports = [
        SerialPortInfo(
            port.device,
            "" if port.description in (None, "n/a") else port.description,
            -1 if port.vid is None else port.vid,
            -1 if port.pid is None else port.pid,
            port.serial_number or "",
        )
        for port in list_ports.comports()
    ]
    return tuple(sorted(ports, key=lambda port: port.device))


def check_controller(
    controller: Controller,
    settings: ControllerSettings,
    laser: LaserSettings,
    environment: EnvironmentSettings,
    config_words: str,
) -> tuple[Verdict, ...]:
    """Verdicts on the controller, which is opened and closed; no output is switched on.

    `config_words` name the configuration in a command.
    """
    if settings.kind == "none":
        return (Verdict("controller", True, "none is configured", made=False),)
    try:
        identity = controller.open()
        status = controller.heartbeat()
        # without a sensor the board notes an error at each request
        air = controller.environment() if environment.kind == "controller" else None
        code, error_text = controller.next_error()
        while code in _TRIP_ERRORS:
            code, error_text = controller.next_error()
    except DeviceError as error:
        return (Verdict.failed("controller", error, ports_here()),)
    finally:
        controller.close()
    checks = [
        Verdict("controller", True, f"serial {identity.serial}, firmware {identity.firmware}"),
        Verdict.checked(
            "interlock",
            status.interlock_closed,
            "closed",
            "close cover and door; check that the loop is plugged in",
            "open: the laser stays off",
        ),
    ]
    if laser.kind == "controller":
        limit_w = identity.laser_max_w
        text = f"{laser.power_w:g} W is configured, the controller's limit is {limit_w:g} W"
        remedy = "lower laser.power_w, or laser_max_w in the board's limits.json"
        checks.append(Verdict.checked("laser power", laser.power_w <= limit_w, text, remedy))
    checks += _light_verdicts(status, config_words)
    if code:
        remedy = "remove the cause, then reset the board"
        checks.append(Verdict("controller errors", False, f"{error_text} ({code})", remedy))
    if air is not None:
        checks.append(
            Verdict.checked(
                "controller's sensor",
                not math.isnan(air.temperature_c),
                f"{air.temperature_c:.2f} °C, {air.humidity_percent:.1f} %, {air.pressure_pa / 100:.1f} hPa",
                "plug the BME280 in, or set environment_sensor.kind to none or serial",
                "no reading",
            )
        )
    return tuple(checks)


def _light_verdicts(status: ControllerStatus, config_words: str) -> Iterator[Verdict]:
    """Verdicts on light that the board detects although the laser is off, and on its latch."""
    contradictions = ["the pin of its relay is high"] * status.readback
    contradictions += ["the photodiode sees light"] * bool(status.light_seen)
    if contradictions:
        remedy = "the laser may be lit: turn its key, then check relay and wiring"
        yield Verdict("laser output", False, f"it is off, and {' and '.join(contradictions)}", remedy)
    if (latch := status.latch) is not None:
        show = f"rig light show {config_words}"
        yield Verdict(
            "controller's latch",
            False,
            f"{latch.cause} is latched: no light until it is acknowledged",
            f"check that nobody is in the beam path, then acknowledge what {show} names",
        )


def check_laser(settings: LaserSettings) -> tuple[Verdict, ...]:
    """Verdicts on the laser, which is opened and closed; it stays off, and the controller's relay open."""
    laser = make_laser(settings)
    if laser is None:
        return ()
    try:
        identity = laser.open()
        state = laser.state()
    except DeviceError as error:
        return (Verdict.failed("laser", error, ports_here()),)
    finally:
        laser.close()
    checks = [
        Verdict("laser", True, identity.text),
        *_interlock_verdicts(settings, state.interlock_closed),
    ]
    if state.fault:
        checks.append(Verdict("laser fault", False, state.fault, "check the laser's panel and manual"))
    return tuple(checks)


def _interlock_verdicts(settings: LaserSettings, closed: bool) -> Iterator[Verdict]:
    """Verdicts on the laser's interlock while the controller's relay, through which it may go, is open."""
    name = "laser switches off automatically"
    if settings.interlock == "own":
        remedy = "close the laser's interlock and turn its key"
        yield Verdict.checked("laser interlock", closed, "closed", remedy, "open: the laser stays off")
        yield Verdict(
            name,
            True,
            "no watchdog of its own: it stays on if the program is killed",
            "wire its interlock through a controller's enable relay and set laser.interlock = 'controller'",
        )
    else:
        yield Verdict.checked(
            name,
            not closed,
            "the controller's relay opens its interlock if the program ends or is killed",
            "check the wiring in docs/controller.md",
            "its interlock is closed while the controller's relay is open: it is not wired through it",
        )


def check_environment(settings: EnvironmentSettings) -> tuple[Verdict, ...]:
    """Verdict on a sensor with its own port: whether a line matches the pattern within 5 s."""
    if settings.kind != "serial":
        return ()
    sensor = AmbientSensor(settings)
    has_reading = sensor.wait_for_reading(_SENSOR_TIMEOUT_S)
    if sensor.last_error and not has_reading:
        verdict = Verdict.failed("environment sensor", DeviceError(sensor.last_error), ports_here())
        without = "; or measure without it: --set environment_sensor.kind=none"
        return (replace(verdict, remedy=verdict.remedy + without),)
    line = sensor.last_line
    fault = f"{line!r} does not match the pattern" if line else f"no line within {_SENSOR_TIMEOUT_S:g} s"
    remedy = "check port, baud rate, request and pattern in [environment_sensor]"
    return (Verdict.checked("environment sensor", has_reading, line, remedy, fault),)
