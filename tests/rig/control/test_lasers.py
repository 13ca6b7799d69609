"""Every laser driver passes the same tests, each with a simulated instrument of its family."""

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from processing.errors import DeviceError
from rig.control.controller import InterlockOpen, PowerLimit
from rig.control.laser_service import LaserService
from rig.control.lasers import LASERS, Laser, LaserRefused, LaserSettings, make_laser, serial_laser
from rig.control.light_permit import LightPermit
from rig.control.link import ReplyTimeout
from rig.control.serial_port import PortLost, SerialLine
from tests.rig.control.instruments import FakeCobolt, FakeLdc500, FakeObis, FakeThorlabs, Instrument
from tests.rig.control.stepped import Clock, InstrumentLine, stepped_clock, turn

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
    assert not pair.instrument.on
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
def test_the_wrong_family_is_not_driven(ports: Ports, kind: str, there: str) -> None:
    instrument = FAMILIES[there][0]()
    laser = laser_for(kind, ports.plug_in(instrument))
    with pytest.raises(DeviceError):
        laser.open()
    assert not any(word.upper().endswith((" ON", " 1")) for word in instrument.received)


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


def test_thorlabs_limit_goes_into_the_instrument_and_its_errors_come_out(ports: Ports) -> None:
    instrument = FakeThorlabs()
    laser = laser_for("thorlabs4000", ports.plug_in(instrument))
    laser.open()
    assert instrument.limit_a == pytest.approx(LIMIT)
    instrument.limit_a = 0.010
    with pytest.raises(LaserRefused, match="Data out of range"):
        laser.set_current_a(0.020)
    instrument.overheated = True
    with pytest.raises(LaserRefused, match="over-temperature"):
        laser.enable()
    laser.close()


def test_ldc500_limit_goes_into_the_instrument(ports: Ports) -> None:
    instrument = FakeLdc500()
    laser = laser_for("ldc500", ports.plug_in(instrument))
    laser.open()
    assert instrument.limit_ma == pytest.approx(LIMIT * 1000)
    assert "MODU OFF" in instrument.received
    laser.close()


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
CASES = [(kind, change, named) for kind, changes in STRAYED.items() for change, named in changes]


@pytest.mark.parametrize(("kind", "change", "named"), CASES)
def test_what_changes_light_behind_the_program_is_set_and_later_refused(
    ports: Ports, kind: str, change: Callable[[Any], None], named: str
) -> None:
    instrument = FAMILIES[kind][0]()
    laser = laser_for(kind, ports.plug_in(instrument))
    laser.open()
    assert laser.state().excess == ""
    change(instrument)
    assert named in laser.state().excess
    with pytest.raises(LaserRefused, match=f"{named}.*not switched on"):
        laser.enable()
    assert not instrument.on
    laser.close()


def test_a_setting_that_is_not_taken_is_refused_when_it_is_opened(ports: Ports) -> None:
    thorlabs, obis = FakeThorlabs(), FakeObis()
    thorlabs.deaf_to, obis.autostart_locked = "AM:STAT", True
    for kind, instrument, named in (("thorlabs4000", thorlabs, "modulation"), ("obis", obis, "autostart")):
        with pytest.raises(LaserRefused, match=f"{named}.*manual"):
            laser_for(kind, ports.plug_in(instrument)).open()
        assert ports.lines[-1].closed


def test_a_thorlabs_whose_enable_input_was_not_used_keeps_it_so(ports: Ports) -> None:
    instrument = FakeThorlabs()
    instrument.kept["PROT:EXT:MODE"] = "OFF"
    laser = laser_for("thorlabs4000", ports.plug_in(instrument))
    laser.open()
    assert instrument.kept["PROT:EXT:MODE"] == "OFF"
    instrument.held_off = True
    with pytest.raises(LaserRefused, match="LD ENABLE"):
        laser.enable()
    laser.close()


def test_a_cobolt_without_a_direct_input_is_driven(ports: Ports) -> None:
    instrument = FakeCobolt()
    instrument.direct_input = None
    laser = laser_for("cobolt", ports.plug_in(instrument))
    laser.open()
    laser.enable()
    assert instrument.on
    laser.close()


def test_an_obis_that_would_light_after_its_warm_up_is_not_told_to(ports: Ports) -> None:
    instrument = FakeObis()
    laser = laser_for("obis", ports.plug_in(instrument))
    laser.open()
    instrument.warm = False
    with pytest.raises(LaserRefused, match="warming up"):
        laser.enable()
    assert "SOURce:AM:STATe ON" not in instrument.received
    laser.close()


def test_more_light_or_current_than_allowed_is_seen_and_not_lit(pair: Pair) -> None:
    pair.laser.open()
    pair.set(0.020)
    pair.laser.enable()
    assert pair.laser.state().excess == ""
    pair.instrument.measures = 0.050
    what = r"50 m[AW] measured, 30 m[AW] allowed by max_"
    assert re.search(what, pair.laser.state().excess)
    pair.laser.off()
    with pytest.raises(LaserRefused, match=what):
        pair.laser.enable()
    assert not pair.instrument.on


@pytest.mark.parametrize("kind", sorted(LASERS))
def test_a_meter_that_errs_by_a_few_percent_is_no_alarm(ports: Ports, kind: str) -> None:
    instrument = FAMILIES[kind][0]()
    laser = laser_for(kind, ports.plug_in(instrument))
    laser.open()
    instrument.measures = LIMIT * 1.03
    assert laser.state().excess == ""
    instrument.measures = LIMIT * 1.1
    assert "allowed by max_" in laser.state().excess
    instrument.measures = None
    laser.close()


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


def test_the_monitor_diode_of_an_ldc500_counts(ports: Ports) -> None:
    instrument = FakeLdc500()
    laser = laser_for("ldc500", ports.plug_in(instrument))
    laser.open()
    instrument.monitor_mw = 40.0
    assert "40 mW measured, 30 mW allowed by max_power_w" in laser.state().excess
    laser.close()


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


def test_an_obis_without_handshaking_is_given_it(ports: Ports) -> None:
    instrument = FakeObis()
    instrument.handshaking = False
    laser = laser_for("obis", ports.plug_in(instrument))
    assert laser.open().serial == "LX123456"
    laser.set_power_w(0.01)
    laser.enable()
    assert instrument.on
    laser.close()
    assert not instrument.on


def test_a_cobolt_in_autostart_names_the_remedy(ports: Ports) -> None:
    instrument = FakeCobolt()
    instrument.autostart = True
    laser = laser_for("cobolt", ports.plug_in(instrument))
    with pytest.raises(LaserRefused, match=r"autostart is on.*switch it off"):
        laser.open()
    assert ports.lines[-1].closed


def test_an_ldc500_that_enters_its_error_late_is_heard(ports: Ports) -> None:
    instrument = FakeLdc500()
    laser = laser_for("ldc500", ports.plug_in(instrument))
    laser.open()
    instrument.limit_ma = 1.0
    with pytest.raises(LaserRefused, match="LEXE 1"):
        laser.set_current_a(0.01)
    laser.close()


def test_a_laser_that_lights_late_is_waited_for_and_one_that_never_does_is_switched_off(ports: Ports) -> None:
    instrument = FakeObis()
    laser = laser_for("obis", ports.plug_in(instrument))
    laser.open()
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
    laser.close()


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


class TestService:
    """What the laser's thread decides, turn by turn."""

    @pytest.fixture
    def instrument(self) -> FakeCobolt:
        return FakeCobolt()

    @pytest.fixture
    def permit(self, ports: Ports) -> LightPermit:
        return LightPermit(ports.clock.monotonic)

    @pytest.fixture
    def service(self, ports: Ports, instrument: FakeCobolt, permit: LightPermit) -> LaserService:
        return LaserService(laser_for("cobolt", ports.plug_in(instrument)), period_s=0.2, permit=permit)

    def test_it_is_opened_dark_and_lit_when_asked(
        self, ports: Ports, service: LaserService, instrument: FakeCobolt
    ) -> None:
        assert turn(service) == 0.2
        assert service.take_events() == ("Cobolt 12345 open, dark",)
        assert service.snapshot.state is not None
        power, lit, too_much = service.set_power_w(0.01), service.enable(), service.set_power_w(1.0)
        turn(service)
        assert power.result(0) is lit.result(0) is None
        with pytest.raises(PowerLimit):
            too_much.result(0)
        assert instrument.on
        # known at once, not with the next turn
        assert service.snapshot.state.on
        assert service.snapshot.state_time_ns == ports.clock.monotonic_ns()
        off = service.off()
        turn(service)
        off.result(0)
        assert not instrument.on

    def test_silence_is_said_once_and_a_laser_found_again_is_dark(
        self, service: LaserService, instrument: FakeCobolt
    ) -> None:
        turn(service)
        service.enable()
        turn(service)
        assert instrument.on
        service.take_events()
        instrument.silent = True
        assert [turn(service), turn(service)] == [1.0, 1.0]
        assert service.snapshot.state is None
        said = service.take_events()
        assert said[-1] == service.snapshot.last_error
        assert all("no reply" in text for text in said)
        turn(service)
        assert service.take_events() == ()
        refused = service.enable()
        turn(service)
        with pytest.raises(PortLost, match="no reply"):
            refused.result(0)
        instrument.silent = False
        turn(service)
        assert not instrument.on
        assert service.snapshot.last_error == ""
        opened, dark = service.take_events()
        assert opened == "Cobolt 12345 open, dark"
        assert dark.startswith("laser off: trip 1 (WATCHDOG): the laser was lost: ")

    def test_without_a_permit_it_goes_dark_once_and_stays_dark(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        turn(service)
        service.enable()
        turn(service)
        permit.withdraw("the run ends")
        turn(service)
        assert not instrument.on
        assert "laser off: the run ends" in service.take_events()
        count = instrument.received.count("l0")
        refused = service.enable()
        turn(service)
        with pytest.raises(DeviceError, match="the laser stays off: the run ends"):
            refused.result(0)
        assert instrument.received.count("l0") == count

    def test_more_light_than_allowed_darkens_and_withdraws_the_permit(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        turn(service)
        service.set_power_w(0.01)
        service.enable()
        turn(service)
        service.take_events()
        instrument.measures = 0.050
        turn(service)
        assert not instrument.on
        said = "50 mW measured, 30 mW allowed by max_power_w"
        assert service.take_events() == (f"laser off: {said}",)
        assert said in permit.refusal
        instrument.measures = None
        refused = service.enable()
        turn(service)
        with pytest.raises(DeviceError, match=said):
            refused.result(0)
        assert not instrument.on

    def test_modulation_switched_on_while_it_is_lit_darkens(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        turn(service)
        service.enable()
        turn(service)
        instrument.mode = 4
        turn(service)
        assert not instrument.on
        assert "modulation" in permit.refusal

    def test_a_laser_that_is_lit_at_its_panel_is_darkened_and_that_is_latched(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        for _ in range(2):
            turn(service)
        instrument.light(True)
        turn(service)
        assert not instrument.on
        assert "it lights although this program did not" in permit.refusal
        refused = service.enable()
        turn(service)
        with pytest.raises(DeviceError, match="it lights although"):
            refused.result(0)

    def test_an_off_outdates_a_light_that_still_waits(
        self, service: LaserService, instrument: FakeCobolt
    ) -> None:
        turn(service)
        lit, dark = service.enable(), service.off()
        turn(service)
        dark.result(0)
        with pytest.raises(DeviceError, match="was switched off meanwhile"):
            lit.result(0)
        assert "l1" not in instrument.received

    @pytest.mark.parametrize("by", ["off", "permit"])
    def test_a_laser_that_lights_late_is_not_waited_for_when_it_shall_be_dark(
        self, ports: Ports, permit: LightPermit, by: str
    ) -> None:
        instrument = FakeObis()
        service = LaserService(laser_for("obis", ports.plug_in(instrument)), permit=permit)
        turn(service)
        instrument.delay = 10_000
        began_s = ports.clock.monotonic()
        usual, asked = instrument.answer, [service.off if by == "off" else lambda: permit.withdraw("the end")]

        def answer(command: str) -> str | None:
            if asked and ports.clock.monotonic() > began_s + 1.0:
                asked.pop()()
            return usual(command)

        instrument.answer = answer  # type: ignore[method-assign]
        lit = service.enable()
        turn(service)
        with pytest.raises(DeviceError, match="it was switched off"):
            lit.result(0)
        assert not instrument.on
        assert ports.clock.monotonic() - began_s < 2

    def test_an_off_that_was_not_obeyed_is_given_again(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        turn(service)
        service.enable()
        turn(service)
        instrument.deaf_to_off = 20
        permit.withdraw("the run ends")
        turn(service)
        assert instrument.on
        instrument.deaf_to_off = 0
        turn(service)
        assert not instrument.on

    def test_one_that_refused_to_light_and_is_lit_at_its_panel_later_is_darkened(
        self, service: LaserService, instrument: FakeCobolt, permit: LightPermit
    ) -> None:
        turn(service)
        instrument.fault = 4
        lit = service.enable()
        turn(service)
        with pytest.raises(DeviceError):
            lit.result(0)
        assert not instrument.on
        instrument.fault = 0
        turn(service)
        instrument.light(True)
        turn(service)
        assert not instrument.on
        assert "it lights although this program did not" in permit.refusal

    def test_an_off_is_never_too_late(
        self, ports: Ports, service: LaserService, instrument: FakeCobolt
    ) -> None:
        """A computer that stood still must not forget it."""
        turn(service)
        service.enable()
        turn(service)
        assert instrument.on
        off = service.off()
        ports.clock.sleep(60.0)
        turn(service)
        off.result(0)
        assert not instrument.on

    @pytest.mark.parametrize("own", [True, False])
    def test_its_own_interlock_needs_an_acknowledgement(
        self, ports: Ports, instrument: FakeCobolt, permit: LightPermit, own: bool
    ) -> None:
        laser = laser_for("cobolt", ports.plug_in(instrument))
        service = LaserService(laser, permit=permit, own_interlock=own)
        permit.begin()
        turn(service)
        instrument.interlock_closed = False
        turn(service)
        turn(service)
        assert service.take_events().count("interlock opened") == 1
        assert permit.refusal == ("trip 1 (INTERLOCK): the interlock of the laser opened" if own else "")

    def test_a_fault_is_said_when_it_comes(self, service: LaserService, instrument: FakeCobolt) -> None:
        turn(service)
        for fault in (4, 4, 1):
            instrument.fault = fault
            turn(service)
        assert service.take_events()[1:] == ("constant-power time-out", "temperature error")
