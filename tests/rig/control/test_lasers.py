"""Every laser driver passes the same tests, each with a simulated instrument of its family."""

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from processing.errors import DeviceError
from rig.control.controller import InterlockOpen, PowerLimit
from rig.control.laser_service import LaserService
from rig.control.lasers import LASERS, Laser, LaserRefused, LaserSettings, make_laser
from rig.control.link import ReplyTimeout
from rig.control.serial_port import PortLost
from tests.rig.control.instruments import FakeCobolt, FakeLdc500, FakeObis, FakeThorlabs, Instrument
from tests.rig.control.test_service import until

pytestmark = pytest.mark.realtime

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
    laser: Laser
    instrument: Instrument

    def set(self, value: float) -> None:
        if self.kind in ("thorlabs4000", "ldc500"):
            self.laser.set_current_a(value)
        else:
            self.laser.set_power_w(value)


def laser_for(kind: str, port: str) -> Laser:
    laser = make_laser(
        LaserSettings.model_validate(
            {"kind": kind, "port": port, "timeout_s": 0.3, "max_power_w": LIMIT, "max_current_a": LIMIT}
        )
    )
    assert laser is not None
    return laser


@pytest.fixture(params=sorted(LASERS))
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    kind = request.param
    instrument = FAMILIES[kind][0]()
    instrument.on, instrument.set_value = True, 0.001
    laser = laser_for(kind, instrument.port)
    yield Pair(kind, laser, instrument)
    instrument.stuck_on = False
    laser.close()
    instrument.close()


def test_opening_identifies_and_leaves_it_dark(pair: Pair) -> None:
    identity = pair.laser.open()
    assert (identity.model, identity.serial) == FAMILIES[pair.kind][1:]
    assert not pair.instrument.on


def test_lit_set_read_and_dark_again(pair: Pair) -> None:
    pair.laser.open()
    pair.set(0.020)
    pair.laser.enable()
    assert pair.instrument.on
    assert pair.instrument.set_value == pytest.approx(0.020, rel=1e-6)
    state = pair.laser.state()
    assert state.on
    assert state.interlock_closed
    assert state.fault == ""
    read = state.current_a if pair.kind in ("thorlabs4000", "ldc500") else state.power_w
    assert read == pytest.approx(0.020, rel=1e-4)
    pair.laser.off()
    assert not pair.instrument.on
    assert not pair.laser.state().on


def test_closing_turns_it_off(pair: Pair) -> None:
    pair.laser.open()
    pair.laser.enable()
    pair.laser.close()
    until(lambda: not pair.instrument.on)
    with pytest.raises(PortLost, match="not open"):
        pair.laser.state()
    pair.laser.close()


def test_open_interlock_forbids(pair: Pair) -> None:
    pair.laser.open()
    pair.instrument.interlock_closed = False
    pair.instrument.received.clear()
    with pytest.raises(InterlockOpen):
        pair.laser.enable()
    # Read before enabling: the command that lights was not sent at all.
    assert not any(command.endswith("ON") or command == "l1" for command in pair.instrument.received)
    assert not pair.laser.state().interlock_closed


def test_never_above_the_limit_whatever_is_asked(pair: Pair) -> None:
    pair.laser.open()
    pair.laser.enable()

    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.one_of(st.floats(), st.floats(0.0, 2 * LIMIT), st.floats(LIMIT * 0.999999, LIMIT * 1.000001)))
    @example(LIMIT)
    @example(1.5e-5)
    @example(1.99e-5)
    def check(value: float) -> None:
        if 0.0 <= value <= LIMIT:
            pair.set(value)
        else:
            with pytest.raises(PowerLimit, match="is allowed by max_"):
                pair.set(value)

    check()
    assert pair.instrument.highest_lit <= LIMIT
    assert pair.instrument.highest_lit == pytest.approx(LIMIT, rel=1e-6)


def test_the_other_unit_is_refused(pair: Pair) -> None:
    pair.laser.open()
    if pair.kind in ("thorlabs4000", "ldc500"):
        with pytest.raises(LaserRefused, match="current_a, not power_w"):
            pair.laser.set_power_w(0.001)
    else:
        with pytest.raises(LaserRefused, match="power_w, not current_a"):
            pair.laser.set_current_a(0.001)


def test_a_laser_that_stays_lit_is_reported(pair: Pair) -> None:
    pair.laser.open()
    pair.laser.enable()
    pair.instrument.stuck_on = True
    with pytest.raises(LaserRefused, match="still emits"):
        pair.laser.off()


def test_silence_is_a_timeout(pair: Pair) -> None:
    pair.laser.open()
    pair.instrument.silent = True
    with pytest.raises(ReplyTimeout, match="check port"):
        pair.laser.state()


@pytest.mark.parametrize(("kind", "there"), sorted(itertools.permutations(LASERS, 2)))
def test_the_wrong_family_is_not_driven(kind: str, there: str) -> None:
    instrument = FAMILIES[there][0]()
    laser = make_laser(LaserSettings(kind=kind, port=instrument.port, timeout_s=0.05))  # type: ignore[arg-type]
    assert laser is not None
    with pytest.raises(DeviceError):
        laser.open()
    assert not any(word.upper().endswith((" ON", " 1")) for word in instrument.received)
    instrument.close()


def test_no_descriptor_is_left_behind(pair: Pair) -> None:
    pair.laser.open()
    pair.laser.close()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        pair.laser.open()
        pair.laser.close()
    assert len(os.listdir("/proc/self/fd")) == before


def test_thorlabs_limit_goes_into_the_instrument_and_its_errors_come_out() -> None:
    instrument = FakeThorlabs()
    laser = laser_for("thorlabs4000", instrument.port)
    laser.open()
    assert instrument.limit_a == pytest.approx(LIMIT)
    instrument.limit_a = 0.010
    with pytest.raises(LaserRefused, match="Data out of range"):
        laser.set_current_a(0.020)
    instrument.overheated = True
    with pytest.raises(LaserRefused, match="over-temperature"):
        laser.enable()
    laser.close()
    instrument.close()


def test_ldc500_limit_goes_into_the_instrument() -> None:
    instrument = FakeLdc500()
    laser = laser_for("ldc500", instrument.port)
    laser.open()
    assert instrument.limit_ma == pytest.approx(LIMIT * 1000)
    assert "MODU OFF" in instrument.received
    laser.close()
    instrument.close()


def test_a_fault_forbids_lighting() -> None:
    obis, cobolt = FakeObis(), FakeCobolt()
    obis.faults, cobolt.fault = 0x20, 1
    for laser, what in (
        (laser_for("obis", obis.port), "00000020"),
        (laser_for("cobolt", cobolt.port), "temperature"),
    ):
        laser.open()
        with pytest.raises(LaserRefused, match=what):
            laser.enable()
        laser.close()
    obis.close()
    cobolt.close()


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


def test_an_obis_without_handshaking_is_given_it() -> None:
    instrument = FakeObis()
    instrument.handshaking = False
    laser = laser_for("obis", instrument.port)
    try:
        assert laser.open().serial == "LX123456"
        laser.set_power_w(0.01)
        laser.enable()
        assert instrument.on
    finally:
        laser.close()
        instrument.close()
    assert not instrument.on


def test_a_cobolt_in_autostart_names_the_remedy() -> None:
    instrument = FakeCobolt()
    instrument.autostart = True
    laser = laser_for("cobolt", instrument.port)
    try:
        with pytest.raises(LaserRefused, match=r"autostart is on.*switch it off"):
            laser.open()
    finally:
        laser.close()
        instrument.close()


def test_an_ldc500_that_enters_its_error_late_is_heard() -> None:
    instrument = FakeLdc500()
    laser = laser_for("ldc500", instrument.port)
    try:
        laser.open()
        instrument.limit_ma = 1.0
        with pytest.raises(LaserRefused, match="LEXE 1"):
            laser.set_current_a(0.01)
    finally:
        laser.close()
        instrument.close()
