"""The thread that drives a laser."""

import pytest

from processing.errors import DeviceError
from rig.control.controller import PowerLimit
from rig.control.laser_service import LaserService
from rig.control.lasers import LASERS, LaserSettings, off_bytes
from rig.control.light_permit import LightPermit
from rig.control.serial_port import PortLost
from tests.rig.control.instruments import FakeCobolt, FakeObis
from tests.rig.control.lasers.pairs import FAMILIES, Ports, laser_for
from tests.rig.control.stepped import turn


def lit(service: LaserService, instrument: FakeCobolt) -> None:
    """The service's laser open and on."""
    turn(service)
    service.enable()
    turn(service)
    assert instrument.on


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
        return LaserService(laser_for("cobolt", ports.plug_in(instrument)), permit=permit)

    def test_it_is_opened_dark_and_lit_when_asked(
        self, ports: Ports, service: LaserService, instrument: FakeCobolt
    ) -> None:
        assert turn(service) == 0.5
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

    def test_no_disk_is_read_while_a_laser_may_be_lit(
        self, ports: Ports, permit: LightPermit, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A disk that hangs then would hold up the thread that could switch the laser off."""
        instrument = FakeObis()
        service = LaserService(laser_for("obis", ports.plug_in(instrument)), permit=permit)
        lit_at_looks: list[bool] = []
        monkeypatch.setattr(permit, "look_for_presses", lambda: lit_at_looks.append(instrument.on))
        turn(service)
        service.enable()
        turn(service)
        assert instrument.on
        assert lit_at_looks
        assert not any(lit_at_looks)

    def test_silence_is_said_once_and_a_laser_found_again_is_dark(
        self, service: LaserService, instrument: FakeCobolt
    ) -> None:
        lit(service, instrument)
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
        lit(service, instrument)
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

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            ({"measures": 0.050}, "50 mW measured, 30 mW allowed by max_power_w"),
            ({"mode": 4}, "modulation"),
            ({"on": True}, "it is lit, but not by this program"),
        ],
    )
    def test_what_must_not_be_darkens_and_withdraws_the_permit(
        self,
        service: LaserService,
        instrument: FakeCobolt,
        permit: LightPermit,
        changed: dict[str, object],
        said: str,
    ) -> None:
        if "on" in changed:
            turn(service)
            turn(service)
        else:
            lit(service, instrument)
        service.take_events()
        vars(instrument).update(changed)
        turn(service)
        assert not instrument.on
        assert [said in text for text in service.take_events()] == [True]
        assert said in permit.refusal
        instrument.measures = None
        refused = service.enable()
        turn(service)
        with pytest.raises(DeviceError, match=said):
            refused.result(0)
        assert not instrument.on

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
        lit(service, instrument)
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
        assert "it is lit, but not by this program" in permit.refusal

    def test_an_off_is_never_too_late(
        self, ports: Ports, service: LaserService, instrument: FakeCobolt
    ) -> None:
        """A computer that stood still must not forget it."""
        lit(service, instrument)
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
        service = LaserService(laser, permit=permit, has_own_interlock=own)
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


@pytest.mark.parametrize("kind", sorted(LASERS))
def test_an_off_by_another_program_among_its_questions_is_no_trip(ports: Ports, kind: str) -> None:
    """LIGHT OFF writes to the port itself, and the instrument's "OK" comes to who has the port."""
    instrument, permit = FAMILIES[kind][0](), LightPermit(ports.clock.monotonic)
    laser = laser_for(kind, ports.plug_in(instrument))
    off = off_bytes(LaserSettings(kind=kind, port="any"))
    assert off is not None
    service, usual = LaserService(laser, permit=permit), instrument.hear
    turn(service)
    questions = 0
    while True:
        instrument.on, service._light_requested, left = True, True, questions
        turn(service)

        def hear(data: bytes) -> bytes:
            nonlocal left
            left -= 1
            # it is written twice
            return (usual(off + off) if left == -1 else b"") + usual(data)

        instrument.hear = hear  # type: ignore[method-assign]
        turn(service)
        instrument.hear = usual  # type: ignore[method-assign]
        turn(service)
        assert permit.latched is None, f"off before question {questions}"
        assert service.snapshot.state is not None
        if left >= 0:
            break
        assert not instrument.on
        assert not service.snapshot.state.on
        questions += 1
    assert questions > 0
