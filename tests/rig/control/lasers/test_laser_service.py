"""The thread that drives a laser: what it decides, turn by turn."""

from concurrent.futures import Future
from typing import Any

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


class Bench:
    """A laser's service, turned by hand, with its instrument and permit."""

    def __init__(self, ports: Ports, family: type[Any] = FakeCobolt, **stated: Any) -> None:
        self.clock, self.instrument = ports.clock, family()
        self.permit = LightPermit(ports.clock.monotonic)
        kind = "cobolt" if family is FakeCobolt else "obis"
        laser = laser_for(kind, ports.plug_in(self.instrument))
        self.service = LaserService(laser, permit=self.permit, **stated)

    def turn(self) -> float:
        return turn(self.service)

    def done(self, job: Future[Any]) -> None:
        """What becomes of a job in the next turn."""
        self.turn()
        assert job.result(0) is None

    def refused(self, said: str) -> None:
        """A light that is asked for now is refused, with these words, and nothing is lit."""
        with pytest.raises(DeviceError, match=said):
            self.done(self.service.enable())
        assert not self.instrument.on

    def light(self) -> None:
        """The laser open and on."""
        self.turn()
        self.done(self.service.enable())
        assert self.instrument.on
        self.service.take_events()


@pytest.fixture
def bench(ports: Ports) -> Bench:
    return Bench(ports)


def test_it_is_opened_dark_and_lit_when_asked(bench: Bench) -> None:
    service = bench.service
    assert bench.turn() == 0.5
    assert service.take_events() == ("Cobolt 12345 open, dark",)
    assert service.snapshot.state is not None
    power, too_much = service.set_power_w(0.01), service.set_power_w(1.0)
    bench.done(service.enable())
    assert power.result(0) is None
    with pytest.raises(PowerLimit):
        too_much.result(0)
    assert bench.instrument.on
    # known at once, not with the next turn
    assert service.snapshot.state.on
    assert service.snapshot.state_time_ns == bench.clock.monotonic_ns()
    bench.done(service.off())
    assert not bench.instrument.on


def test_no_disk_is_read_while_a_laser_may_be_lit(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that hangs then would hold up the thread that could switch the laser off."""
    bench = Bench(ports, FakeObis)
    lit_at_looks: list[bool] = []
    monkeypatch.setattr(bench.permit, "look_for_presses", lambda: lit_at_looks.append(bench.instrument.on))
    bench.light()
    assert lit_at_looks
    assert not any(lit_at_looks)


def test_silence_is_said_once_and_a_laser_found_again_is_dark(bench: Bench) -> None:
    bench.light()
    bench.instrument.silent = True
    assert [bench.turn(), bench.turn()] == [1.0, 1.0]
    assert bench.service.snapshot.state is None
    said = bench.service.take_events()
    assert said[-1] == bench.service.snapshot.last_error
    assert all("no reply" in text for text in said)
    bench.turn()
    assert bench.service.take_events() == ()
    with pytest.raises(PortLost, match="no reply"):
        bench.done(bench.service.enable())
    bench.instrument.silent = False
    bench.turn()
    assert not bench.instrument.on
    assert bench.service.snapshot.last_error == ""
    opened, dark = bench.service.take_events()
    assert opened == "Cobolt 12345 open, dark"
    assert dark.startswith("laser off: trip 1 (WATCHDOG): the laser was lost: ")


def test_without_a_permit_it_goes_dark_once_and_stays_dark(bench: Bench) -> None:
    bench.light()
    bench.permit.withdraw("the run ends")
    bench.turn()
    assert not bench.instrument.on
    assert bench.service.take_events() == ("laser off: the run ends",)
    count = bench.instrument.received.count("l0")
    bench.refused("the laser stays off: the run ends")
    assert bench.instrument.received.count("l0") == count


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"measures": 0.050}, "50 mW measured, 30 mW allowed by max_power_w"),
        ({"mode": 4}, "modulation"),
        ({"on": True}, "it is lit, but not by this program"),
    ],
)
def test_what_must_not_be_darkens_and_withdraws_the_permit(
    bench: Bench, changed: dict[str, object], said: str
) -> None:
    if "on" in changed:
        bench.turn()
        bench.turn()
        bench.service.take_events()
    else:
        bench.light()
    vars(bench.instrument).update(changed)
    bench.turn()
    assert not bench.instrument.on
    assert [said in text for text in bench.service.take_events()] == [True]
    assert said in bench.permit.refusal
    bench.instrument.measures = None
    bench.refused(said)


def test_an_off_outdates_a_light_that_still_waits(bench: Bench) -> None:
    bench.turn()
    lit, dark = bench.service.enable(), bench.service.off()
    bench.done(dark)
    with pytest.raises(DeviceError, match="was switched off meanwhile"):
        lit.result(0)
    assert "l1" not in bench.instrument.received


@pytest.mark.parametrize("by", ["off", "permit"])
def test_a_laser_that_lights_late_is_not_waited_for_when_it_shall_be_dark(ports: Ports, by: str) -> None:
    bench = Bench(ports, FakeObis)
    bench.turn()
    bench.instrument.delay = 10_000
    began_s = bench.clock.monotonic()
    usual = bench.instrument.answer
    asked = [bench.service.off if by == "off" else lambda: bench.permit.withdraw("the end")]

    def answer(command: str) -> str | None:
        if asked and bench.clock.monotonic() > began_s + 1.0:
            asked.pop()()
        reply: str | None = usual(command)
        return reply

    bench.instrument.answer = answer
    bench.refused("it was switched off")
    assert bench.clock.monotonic() - began_s < 2


def test_an_off_that_was_not_obeyed_is_given_again(bench: Bench) -> None:
    bench.light()
    bench.instrument.deaf_to_off = 20
    bench.permit.withdraw("the run ends")
    bench.turn()
    assert bench.instrument.on
    bench.instrument.deaf_to_off = 0
    bench.turn()
    assert not bench.instrument.on


def test_one_that_refused_to_light_and_is_lit_at_its_panel_later_is_darkened(bench: Bench) -> None:
    bench.turn()
    bench.instrument.fault = 4
    bench.refused("constant-power time-out")
    bench.instrument.fault = 0
    bench.turn()
    bench.instrument.light(True)
    bench.turn()
    assert not bench.instrument.on
    assert "it is lit, but not by this program" in bench.permit.refusal


def test_an_off_is_never_too_late(bench: Bench) -> None:
    """A computer that stood still must not forget it."""
    bench.light()
    off = bench.service.off()
    bench.clock.sleep(60.0)
    bench.done(off)
    assert not bench.instrument.on


@pytest.mark.parametrize("own", [True, False])
def test_its_own_interlock_needs_an_acknowledgement(ports: Ports, own: bool) -> None:
    bench = Bench(ports, has_own_interlock=own)
    bench.permit.begin()
    bench.turn()
    bench.instrument.interlock_closed = False
    bench.turn()
    bench.turn()
    assert bench.service.take_events().count("interlock opened") == 1
    assert bench.permit.refusal == ("trip 1 (INTERLOCK): the interlock of the laser opened" if own else "")


def test_a_fault_is_said_when_it_comes(bench: Bench) -> None:
    bench.turn()
    for bench.instrument.fault in (4, 4, 1):
        bench.turn()
    assert bench.service.take_events()[1:] == ("constant-power time-out", "temperature error")


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
