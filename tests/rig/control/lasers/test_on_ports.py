"""A laser on a real terminal; what the drivers decide is in the other files here."""

import os

import pytest

from tests.rig.control.instruments import FakeObis
from tests.rig.control.lasers.pairs import laser_for


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
