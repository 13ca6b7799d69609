"""LIGHT OFF at the desk that reaches no program: it is kept, and says what it could not do."""

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

import pytest

from processing.errors import ConfigurationError
from rig.control import run_in_thread
from rig.desk.desk import Desk
from rig.devices.light_off import LightOff
from tests.rig.desk.conftest import simulated_rig
from tests.rig.known_rig import known
from tests.waiting import until

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

REAL = '[controller]\nkind = "serial"\nport = "/dev/ttyNobodyHasIt"\n'
LASER = '[laser]\nkind = "controller"\nmax_power_w = 0.001\npower_w = 0.0005\n'


@pytest.fixture
def desk_of(tmp_path: Path) -> Iterator[Callable[[str], Desk]]:
    desks: list[Desk] = []

    def make(more: str) -> Desk:
        desks.append(Desk(simulated_rig(tmp_path, more)))
        desks[-1].safety.start()
        return desks[-1]

    yield make
    for desk in desks:
        desk.close()


def test_pressed_while_nothing_runs_nothing_is_started_until_it_is_acknowledged(
    desk_of: Callable[[str], Desk],
) -> None:
    known("/dev/ttyNobodyHasIt")
    desk = desk_of(REAL + LASER)
    said = desk.lighting.off("one")
    assert said[-1] == (
        "no program that could light has answered: it is kept, and nothing is lit until it is acknowledged"
    )
    # by the other way it says the same
    assert desk.lighting.off("one") == said
    until(lambda: desk.safety.trip is not None)
    trip = desk.safety.trip
    assert trip is not None
    assert trip.text == "trip 1 (PERSON): LIGHT OFF was pressed at the desk"
    with pytest.raises(ConfigurationError, match="acknowledge it first"):
        desk.start("doctor", "--preflight")


def test_a_laser_that_is_switched_by_hand_is_not_said_to_be_off(
    desk_of: Callable[[str], Desk],
) -> None:
    assert desk_of("").lighting.off("one") == ["no laser is switched by this program: turn its key"]


@pytest.mark.parametrize("error", [OSError("no such device"), RuntimeError("of another kind")])
def test_whatever_keeping_a_press_meets_it_is_said_and_all_else_is_done(
    desk_of: Callable[[str], Desk], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    ordered: list[object] = []
    monkeypatch.setattr(LightOff, "_order_holder_off", lambda _, told: bool(ordered.append(told)))
    desk = desk_of(REAL + LASER)

    def press(_presses: object, _at: str) -> None:
        raise error

    monkeypatch.setattr(type(desk.rig_state.presses), "press", press)
    off, unkept, nobody = desk.lighting.off("one")
    assert off.startswith("/dev/ttyNobodyHasIt: cannot be switched off")
    assert unkept == f"it is not kept ({error}): a program that starts may light; turn the key switch"
    assert nobody == "no program that could light has answered"
    assert len(ordered) == 1


def test_a_disk_that_hangs_holds_nothing_up(
    desk_of: Callable[[str], Desk], monkeypatch: pytest.MonkeyPatch
) -> None:
    desk = desk_of(REAL + LASER)
    goes_on, dark = Event(), Event()

    def darkened(*_: object) -> list[str]:
        dark.set()
        return []

    monkeypatch.setattr(type(desk.rig_state.presses), "press", lambda *_: goes_on.wait(60.0))
    monkeypatch.setattr("rig.devices.light_off.darken_directly", darkened)
    assert any("the disk hangs" in text for text in desk.lighting.off("one")), "it is not said to be kept"
    assert dark.is_set()
    dark.clear()
    monkeypatch.setattr("rig.devices.light_off._MAX_STORE_S", 60.0)
    said = run_in_thread(desk.lighting.off, "two")
    assert dark.wait(10.0)
    dark.clear()
    goes_on.set()
    assert said.result(10.0)
    # what began to light before the press was stored
    assert dark.is_set()
