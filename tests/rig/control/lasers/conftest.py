"""Instruments by their ports, and each driver with its instrument."""

from collections.abc import Callable, Iterator

import pytest

from rig.control.lasers import LASERS, SerialLaser, serial_laser
from tests.rig.control.instruments import Instrument
from tests.rig.control.lasers.pairs import FAMILIES, Pair, Ports, laser_for
from tests.rig.control.stepped import stepped_clock


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Ports:
    found = Ports(stepped_clock(monkeypatch))
    monkeypatch.setattr(serial_laser, "SerialPort", found.open)
    return found


@pytest.fixture(params=sorted(LASERS))
def pair(request: pytest.FixtureRequest, ports: Ports) -> Iterator[Pair]:
    kind = request.param
    instrument = FAMILIES[kind][0]()
    instrument.on, instrument.set_value = True, 0.001
    laser = laser_for(kind, ports.plug_in(instrument))
    yield Pair(kind, laser, instrument)
    instrument.stuck_on = False
    laser.close()
    assert all(line.closed for line in ports.lines)


@pytest.fixture
def opened(ports: Ports) -> Iterator[Callable[[Instrument], SerialLaser]]:
    """Opens the laser that an instrument is, and closes it with the test."""
    kinds = {family: kind for kind, (family, _, _) in FAMILIES.items()}
    lasers: list[SerialLaser] = []

    def open_one(instrument: Instrument) -> SerialLaser:
        lasers.append(laser_for(kinds[type(instrument)], ports.plug_in(instrument)))
        lasers[-1].open()
        return lasers[-1]

    yield open_one
    for laser in lasers:
        laser.close()
