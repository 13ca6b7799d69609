"""What one family of lasers does in a way of its own."""

import os
from collections.abc import Callable
from contextlib import closing

import pytest

from rig.control.lasers import LaserRefused, LaserSettings, SerialLaser, make_laser
from tests.rig.control.instruments import FakeCobolt, FakeLdc500, FakeObis, FakeThorlabs, Instrument
from tests.rig.control.lasers.pairs import FAMILIES, LIMIT, Ports, laser_for

Opened = Callable[[Instrument], SerialLaser]


@pytest.mark.parametrize(
    ("kind", "question", "reply"),
    [
        ("thorlabs4000", "*IDN?", "Thorlabs,ITC4001"),
        ("thorlabs4000", "*IDN?", "Thorlabs,CLD1015,M00277475,1.8.0"),
        ("thorlabs4000", "*IDN?", "Keysight,ITC4001,M00277475,1.8.0"),
        ("ldc500", "*IDN?", "Stanford_Research_Systems,LDC501"),
        ("ldc500", "*IDN?", "Stanford_Research_Systems,SIM960,s/n098023,v1.02"),
        ("ldc500", "*IDN?", "Newport,LDC501,s/n098023,v1.02"),
        ("obis", "*IDN?", "Coherent, Inc - CUBE 640nm 100mW C - V1.0.1 - Dec 14 2010"),
        ("obis", "*IDN?", "Vendor, Inc - OBIS 640nm 100mW C - V1.0.1 - Dec 14 2010"),
        ("cobolt", "sn?", "Syntax error: illegal command 1"),
        ("cobolt", "sn?", "unknown"),
        ("cobolt", "sn?", "Thorlabs,ITC4001,M00277475,1.8.0"),
    ],
)
def test_one_that_obeys_under_another_name_is_asked_for_it_and_told_nothing(
    ports: Ports, monkeypatch: pytest.MonkeyPatch, kind: str, question: str, reply: str
) -> None:
    instrument = FAMILIES[kind][0]()
    end = "\r\nOK\r\n" if kind == "obis" else "\r\n"
    usual = instrument.answer
    monkeypatch.setattr(instrument, "answer", lambda said: reply + end if said == question else usual(said))
    with pytest.raises(LaserRefused, match="check the port"):
        laser_for(kind, ports.plug_in(instrument)).open()
    assert instrument.received == [question]


def test_thorlabs_limit_goes_into_the_instrument_and_its_errors_come_out(opened: Opened) -> None:
    instrument = FakeThorlabs()
    laser = opened(instrument)
    assert instrument.limit_a == pytest.approx(LIMIT)
    # LIGHT OFF by another program came between a question and its answer
    interrupted = '-410,"Query INTERRUPTED"'
    instrument.errors = [interrupted, interrupted]
    laser.set_current_a(0.020)
    instrument.limit_a, instrument.errors = 0.010, [interrupted]
    with pytest.raises(LaserRefused, match="Data out of range"):
        laser.set_current_a(0.020)
    instrument.overheated = True
    with pytest.raises(LaserRefused, match="over-temperature"):
        laser.enable()


def test_a_setting_that_is_not_taken_is_refused_when_it_is_opened(ports: Ports) -> None:
    thorlabs, obis = FakeThorlabs(), FakeObis()
    thorlabs.deaf_to, obis.autostart_locked = "AM:STAT", True
    for kind, instrument, named in (("thorlabs4000", thorlabs, "modulation"), ("obis", obis, "autostart")):
        with pytest.raises(LaserRefused, match=f"{named}.*manual"):
            laser_for(kind, ports.plug_in(instrument)).open()
        assert ports.lines[-1].closed


def test_a_thorlabs_whose_enable_input_was_not_used_keeps_it_so(opened: Opened) -> None:
    instrument = FakeThorlabs()
    instrument.kept["PROT:EXT:MODE"] = "OFF"
    laser = opened(instrument)
    assert instrument.kept["PROT:EXT:MODE"] == "OFF"
    instrument.held_off = True
    with pytest.raises(LaserRefused, match="LD ENABLE"):
        laser.enable()


@pytest.mark.parametrize(("family", "lacks"), [(FakeCobolt, "direct_input"), (FakeObis, "handshaking")])
def test_one_that_lacks_a_direct_input_or_handshaking_is_driven(
    opened: Opened, family: type[Instrument], lacks: str
) -> None:
    instrument = family()
    setattr(instrument, lacks, None)
    laser = opened(instrument)
    laser.set_power_w(0.01)
    laser.enable()
    assert instrument.on
    laser.off()
    assert not instrument.on


def test_an_obis_that_would_light_after_its_warm_up_is_not_told_to(opened: Opened) -> None:
    instrument = FakeObis()
    laser = opened(instrument)
    instrument.warm = False
    with pytest.raises(LaserRefused, match="warming up"):
        laser.enable()
    assert "SOURce:AM:STATe ON" not in instrument.received


def test_what_an_obis_answers_by_a_word_alone_is_understood(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some say OK of a closed interlock; a power that it refuses is an error at once."""
    instrument = FakeObis()
    laser, usual = opened(instrument), instrument.answer
    alone = {"SYSTem:LOCK?": "OK\r\nOK\r\n", f"{laser.set_header} 0.010000": "ERR-222\r\n"}
    monkeypatch.setattr(instrument, "answer", lambda said: alone.get(said) or usual(said))
    assert laser.state().interlock_closed
    with pytest.raises(LaserRefused, match="answered ERR-222"):
        laser.set_power_w(0.01)


class TooBright(FakeObis):
    """Its light is not what it was set to."""

    def light(self, on: bool) -> None:
        super().light(on)
        self.measures = 0.050 if on else None


def test_an_obis_that_lights_with_more_than_allowed_is_dark_at_once(ports: Ports) -> None:
    instrument = TooBright()
    laser = make_laser(LaserSettings(kind="obis", port=ports.plug_in(instrument), max_power_w=0.001))
    assert laser is not None
    laser.open()
    laser.set_power_w(0.0005)
    with pytest.raises(LaserRefused, match="50 mW measured, 1 mW allowed by max_power_w; it was switched"):
        laser.enable()
    assert not instrument.on
    laser.close()


def test_the_monitor_diode_of_an_ldc500_counts(opened: Opened) -> None:
    instrument = FakeLdc500()
    laser = opened(instrument)
    instrument.monitor_mw = 40.0
    assert "40 mW measured, 30 mW allowed by max_power_w" in laser.state().dark_reason


def test_a_fault_forbids_lighting(ports: Ports) -> None:
    obis, cobolt = FakeObis(), FakeCobolt()
    obis.faults, cobolt.fault = 0x20, 1
    for laser, what in (
        (laser_for("obis", ports.plug_in(obis)), "00000020"),
        (laser_for("cobolt", ports.plug_in(cobolt)), "temperature"),
    ):
        laser.open()
        with pytest.raises(LaserRefused, match=what):
            laser.enable()
        laser.close()


def test_a_cobolt_in_autostart_names_the_remedy(ports: Ports) -> None:
    instrument = FakeCobolt()
    instrument.autostart = True
    laser = laser_for("cobolt", ports.plug_in(instrument))
    with pytest.raises(LaserRefused, match=r"autostart is on.*switch it off"):
        laser.open()
    assert ports.lines[-1].closed


def test_an_ldc500_that_enters_its_error_late_is_heard(opened: Opened) -> None:
    instrument = FakeLdc500()
    laser = opened(instrument)
    assert instrument.limit_ma == pytest.approx(LIMIT * 1000)
    assert "MODU OFF" in instrument.received
    instrument.limit_ma = 1.0
    with pytest.raises(LaserRefused, match="LEXE 1"):
        laser.set_current_a(0.01)


def test_a_laser_that_lights_late_is_waited_for_and_one_that_never_does_is_switched_off(
    ports: Ports, opened: Opened
) -> None:
    instrument = FakeObis()
    laser = opened(instrument)
    instrument.delay = 5
    laser.enable()
    assert laser.state().on
    laser.off()
    instrument.delay = 10_000
    began_s = ports.clock.monotonic()
    with pytest.raises(LaserRefused, match="does not emit after 10 s"):
        laser.enable()
    assert 10 <= ports.clock.monotonic() - began_s < 11
    assert not instrument.on


def test_a_laser_deaf_to_off_is_told_again_when_it_is_closed(ports: Ports) -> None:
    for deaf, dark in ((2, True), (3, False)):
        instrument = FakeLdc500()
        laser = laser_for("ldc500", ports.plug_in(instrument))
        laser.open()
        laser.enable()
        instrument.deaf_to_off = deaf
        laser.close()
        assert instrument.on is not dark
        assert ports.lines[-1].closed


def test_on_a_real_terminal_one_is_lit_and_closed_without_leaving_a_descriptor() -> None:
    with closing(FakeObis()) as instrument:
        laser = laser_for("obis", instrument.port)
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
