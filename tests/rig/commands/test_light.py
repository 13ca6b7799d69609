"""`rig light`: what is latched is shown and acknowledged by its number."""

import json
import shlex
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from rig.control import ControllerSettings, LaserSettings, SafetyState, TripCause, rig_state_path
from rig.devices import Devices, light_shown_to_desk
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, rig, set_words
from tests.rig.control.instruments import FakeCobolt


@pytest.fixture
def instrument() -> Iterator[FakeCobolt]:
    instrument = FakeCobolt()
    yield instrument
    instrument.close()


@pytest.fixture
def words(tmp_path: Path, instrument: FakeCobolt) -> list[str]:
    """Settings of a laser without a controller."""
    stated = {
        "laser.kind": '"cobolt"',
        "laser.port": f'"{instrument.port}"',
        "laser.max_power_w": "0.03",
        "controller.kind": '"none"',
        "environment_sensor.kind": '"none"',
        "start.way": '"at once"',
        "session.output": f'"{tmp_path / "runs"}"',
    }
    return set_words(stated)


def state_of(words: list[str]) -> SafetyState:
    port = next(word for word in words if word.startswith("laser.port=")).split('"')[1]
    return SafetyState(rig_state_path(LaserSettings(kind="cobolt", port=port), ControllerSettings()))


def test_of_a_laser_without_a_wire_to_this_program_that_is_said(tmp_path: Path) -> None:
    output = set_words({"session.output": f'"{tmp_path}"'})
    shown = rig("light", "show", CONFIGS / "demo.toml", *output)
    assert (shown.returncode, shown.stderr) == (0, "")
    lines = ["laser      not controlled by this program", "interlock  not read by this program"]
    assert shown.stdout.splitlines()[:2] == lines


def test_a_trip_is_shown_acknowledged_and_logged(tmp_path: Path, words: list[str]) -> None:
    live = CONFIGS / "live.toml"
    with state_of(words) as state:
        state.latch(TripCause.OUTPUT, "it stays lit", lit=True)
    shown = rig("light", "show", live, *words)
    assert (shown.returncode, shown.stderr) == (1, "")
    assert "laser      off, 0." in shown.stdout
    assert "interlock  closed, 0." in shown.stdout
    assert "trip       trip 1 (OUTPUT): it stays lit" in shown.stdout
    printed = shlex.split(shown.stdout.split("  rig ")[-1])
    assert printed[-1] == "1"
    refused = rig("light", "acknowledge", live, "2", *words)
    assert refused.returncode == 1
    assert "trip 2 cannot be acknowledged: latched is trip 1 (OUTPUT): it stays lit" in refused.stderr
    done = rig(*printed)
    assert done.returncode == 0
    assert "trip 1 (OUTPUT): it stays lit: acknowledged" in done.stderr
    shown = rig("light", "show", live, *words)
    assert shown.returncode == 0
    assert "trip       none is latched" in shown.stdout
    (line,) = (tmp_path / "runs" / "audit.jsonl").read_text().splitlines()
    assert json.loads(line)["by"] == "rig light acknowledge"


def test_a_rig_that_another_program_holds_is_shown_from_its_file(words: list[str]) -> None:
    with state_of(words) as state:
        state.latch(TripCause.INTERLOCK, "it opened", lit=False)
        shown = rig("light", "show", CONFIGS / "live.toml", *words)
        assert "in use by process" in shown.stderr
        assert "trip       trip 1 (INTERLOCK): it opened" in shown.stdout
        refused = rig("light", "acknowledge", CONFIGS / "live.toml", "1", *words)
        assert refused.returncode == 1
        assert "in use by process" in refused.stderr


@pytest.mark.parametrize("lit_by", ["a program that has the rig", "its panel"])
def test_light_off_darkens_whoever_has_lit_it_until_it_is_acknowledged(
    instrument: FakeCobolt, words: list[str], tmp_path: Path, lit_by: str
) -> None:
    live = CONFIGS / "live.toml"
    with ExitStack() as stack:
        if lit_by == "its panel":
            instrument.light(True)
        else:
            config = load_configuration(live, words[1::2])
            devices = stack.enter_context(Devices(config, tmp_path / "elsewhere", "a test"))
            stack.enter_context(light_shown_to_desk(devices, tmp_path / "elsewhere"))
            devices.light()
        assert instrument.on
        off = rig("light", "off", live, *words)
        assert not instrument.on
    assert (off.returncode, off.stderr) == (0, "")
    assert "laser      off, 0." in off.stdout
    assert "trip       trip 1 (PERSON): LIGHT OFF was pressed at a terminal" in off.stdout
    refused = rig("light", "show", live, *words)
    assert refused.returncode == 1
    assert "trip 1 (PERSON): LIGHT OFF was pressed at a terminal" in refused.stdout


def test_light_off_of_what_it_cannot_darken_says_so(tmp_path: Path) -> None:
    output = set_words({"session.output": f'"{tmp_path}"'})
    by_hand = rig("light", "off", CONFIGS / "demo.toml", *output)
    assert (by_hand.returncode, by_hand.stderr) == (
        1,
        "rig: no laser is switched by this program: turn its key\n",
    )
    none_runs = rig("light", "off", CONFIGS / "live.toml", *output)
    assert none_runs.returncode == 1
    assert none_runs.stderr == f"rig: no session of this simulated rig runs in {tmp_path}\n"


def test_a_trip_that_is_no_number_is_named_with_the_remedy() -> None:
    refused = rig("light", "acknowledge", CONFIGS / "live.toml", "all")
    assert refused.returncode == 2
    assert refused.stderr == "rig: trip 'all': should be its number; rig light show CONFIG names it\n"
