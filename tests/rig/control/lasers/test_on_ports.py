"""A laser on a real terminal; what the drivers decide is in the other files here."""

import os

import pytest

from rig.control.controller import PowerLimit
from rig.control.laser_service import LaserService
from tests.rig.control.instruments import FakeCobolt, FakeObis
from tests.rig.control.lasers.pairs import laser_for
from tests.waiting import until


def test_lit_and_closed_without_leaving_a_descriptor() -> None:
    instrument = FakeObis()
    laser = laser_for("obis", instrument.port)
    laser.open()
    laser.close()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(2):
        laser.open()
        laser.set_power_w(0.020)
        laser.enable()
        assert instrument.on
        assert instrument.set_value == pytest.approx(0.020, rel=1e-6)
        laser.close()
        assert not instrument.on
    assert len(os.listdir("/proc/self/fd")) == before
    instrument.close()


def test_service_publishes_and_survives_a_silence() -> None:
    instrument = FakeCobolt()
    with LaserService(laser_for("cobolt", instrument.port), period_s=0.05) as service:
        until(lambda: service.snapshot.state is not None)
        service.set_power_w(0.010).result(5.0)
        service.enable().result(5.0)
        until(lambda: (s := service.snapshot.state) is not None and s.on)
        with pytest.raises(PowerLimit):
            service.set_power_w(1.0).result(5.0)
        instrument.silent = True
        until(lambda: service.snapshot.state is None)
        instrument.silent = False
        until(lambda: service.snapshot.state is not None)
        # Found again, it is dark: nobody said that it should light.
        assert not instrument.on
        assert any("no reply" in text for text in service.take_events())
    instrument.close()
