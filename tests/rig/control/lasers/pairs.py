"""A driver and the simulated instrument of its family, for every kind of laser."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rig.control.lasers import LaserSettings, SerialLaser, make_laser
from rig.control.serial_port import PortLost, SerialLine
from tests.rig.control.instruments import FakeCobolt, FakeLdc500, FakeObis, FakeThorlabs, Instrument
from tests.rig.control.stepped import Clock, InstrumentLine

FAMILIES: dict[str, tuple[type[Instrument], str, str]] = {
    "thorlabs4000": (FakeThorlabs, "ITC4001", "M00277475"),
    "obis": (FakeObis, "OBIS 640nm LX 100mW", "LX123456"),
    "ldc500": (FakeLdc500, "LDC501", "098023"),
    "cobolt": (FakeCobolt, "", "12345"),
}


LIMIT = 0.030


@dataclass
class Pair:
    """A driver and the instrument that it drives."""

    kind: str
    laser: SerialLaser
    instrument: Instrument

    def set(self, value: float) -> None:
        if self.kind in ("thorlabs4000", "ldc500"):
            self.laser.set_current_a(value)
        else:
            self.laser.set_power_w(value)


def laser_for(kind: str, port: str) -> SerialLaser:
    laser = make_laser(
        LaserSettings.model_validate(
            {"kind": kind, "port": port, "timeout_s": 0.3, "max_power_w": LIMIT, "max_current_a": LIMIT}
        )
    )
    assert laser is not None
    return laser


class Ports:
    """The instruments of a test by their ports, and the lines that were opened to them."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.instruments: dict[str, Instrument] = {}
        self.lines: list[InstrumentLine] = []

    def plug_in(self, instrument: Instrument) -> str:
        port = f"stepped{len(self.instruments)}"
        self.instruments[port] = instrument
        return port

    def open(self, port: str, *_: object, **__: object) -> SerialLine:
        if port not in self.instruments:
            raise PortLost(f"{port}: cannot open the serial port")
        self.lines.append(InstrumentLine(self.instruments[port], self.clock))
        return self.lines[-1]


STRAYED: dict[str, list[tuple[Callable[[Any], None], str]]] = {
    "thorlabs4000": [
        (lambda it: it.kept.update({"AM:STAT": "1"}), "amplitude modulation is on"),
        (lambda it: it.kept.update({"FUNC:SHAP": "PULS"}), "pulses"),
        (lambda it: it.kept.update({"FUNC:MODE": "POW"}), "constant current"),
        (lambda it: it.kept.update({"PROT:EXT:MODE": "ENAB"}), "LD ENABLE"),
    ],
    "obis": [
        (lambda it: setattr(it, "source", "ANALOG"), "ANALOG"),
        (lambda it: setattr(it, "source", "DIGITAL"), "DIGITAL"),
        (lambda it: setattr(it, "autostart", True), "autostart"),
    ],
    "ldc500": [
        (lambda it: it.kept.update(MODU="ON"), "modulation"),
        (lambda it: it.kept.update(MODU="1"), "modulation"),
        (lambda it: it.kept.update(SMOD="CP"), "constant current"),
        (lambda it: it.kept.update(SCAN="ON"), "scan"),
    ],
    "cobolt": [
        (lambda it: setattr(it, "mode", 3), "modulation"),
        (lambda it: setattr(it, "mode", 4), "modulation"),
        (lambda it: setattr(it, "direct_input", True), "direct input"),
        (lambda it: setattr(it, "autostart", True), "autostart"),
    ],
}
"""What another program or somebody at the panel can change, and the word that names it."""
