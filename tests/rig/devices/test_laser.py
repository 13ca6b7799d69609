"""Lasers with a serial port in a session: on at its beginning, off after every kind of end."""

import json
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from processing.errors import DeviceError
from rig.control import ControlService, Light, LightRefused
from rig.control.service import ControlSnapshot
from rig.devices.session_devices import Devices
from rig.settings import Configuration, validate_configuration
from tests.benchmarks.safety_lasers import TRIALS, measured
from tests.benchmarks.safety_sequences import run_sequences
from tests.rig.control.instruments import FakeObis, Instrument
from tests.rig.control.lasers.pairs import FAMILIES
from tests.rig.control.test_ending import ENDED_WITHIN_S, command, running
from tests.rig.control.wires import FirmwareBoard
from tests.waiting import until


def configuration(kind: str, port: str, **sections: Any) -> Configuration:
    value = "current_a" if kind in ("thorlabs4000", "ldc500") else "power_w"
    laser = {"kind": kind, "port": port, value: 0.02, f"max_{value}": 0.03, "timeout_s": 2.0}
    laser |= sections.pop("laser", {})
    tree = {"camera": {"driver": "simulated"}, "laser": laser, **sections}
    return validate_configuration(tree, "test")


@pytest.fixture(params=sorted(FAMILIES))
def family(request: pytest.FixtureRequest) -> Iterator[tuple[str, Instrument]]:
    instrument = FAMILIES[request.param][0]()
    yield request.param, instrument
    instrument.close()


def test_lit_in_a_session_and_dark_after_it(family: tuple[str, Instrument]) -> None:
    kind, instrument = family
    with Devices(configuration(kind, instrument.port)) as devices:
        assert not instrument.on
        assert "stays lit when this program is killed" in devices.light()
        assert instrument.on
        assert instrument.set_value == pytest.approx(0.02)
        now = devices.laser_report()
        assert now is not None
        assert now.on
        assert devices.safety().devices_text == "laser on"
        # lit already: nothing is done to it
        assert devices.light() == ""
    assert not instrument.on

    # also after an error, and where the first command to switch it off is lost
    def measure() -> None:
        with Devices(configuration(kind, instrument.port, laser={"timeout_s": 0.2})) as devices:
            devices.light()
            instrument.deaf_to_off = 1
            raise RuntimeError("our own fault")

    with pytest.raises(RuntimeError, match="our own fault"):
        measure()
    assert not instrument.on


def test_an_open_interlock_lights_nothing(family: tuple[str, Instrument]) -> None:
    kind, instrument = family
    instrument.interlock_closed = False
    with Devices(configuration(kind, instrument.port)) as devices:
        until(lambda: devices.permit.latched is not None)
        with pytest.raises(LightRefused, match="the interlock of the laser opened"):
            devices.light()
        now = devices.laser_report()
        assert now is not None
        assert now.light is Light.INTERLOCK_OPEN
    assert instrument.highest_lit == 0.0


def test_too_much_light_is_acknowledged_only_when_it_is_gone() -> None:
    with closing(FakeObis()) as instrument, Devices(configuration("obis", instrument.port)) as devices:
        devices.light()
        instrument.measures = 0.050
        until(lambda: devices.permit.latched is not None)
        until(lambda: not instrument.on)
        with pytest.raises(DeviceError, match="cannot be acknowledged: 50 mW measured, 30 mW allowed"):
            devices.acknowledge(1, "test")
        instrument.measures = None
        laser = devices.laser
        until(lambda: laser and (state := laser.snapshot.state) and not state.dark_reason)
        assert "acknowledged" in devices.acknowledge(1, "test")
        assert not instrument.on


class BehindTheRelay(FakeObis):
    """Its interlock loop runs through the enable relay of a board."""

    def __init__(self, board: FirmwareBoard) -> None:
        self.board = board
        super().__init__()

    @property
    def interlock_closed(self) -> bool:
        return self.board.outputs().get("laser", [0.0])[0] == 1

    @interlock_closed.setter
    def interlock_closed(self, closed: bool) -> None:
        """The board says it."""

    @property
    def emits(self) -> bool:
        return self.on and self.interlock_closed


def behind_the_relay(board: FirmwareBoard, instrument: FakeObis) -> Configuration:
    controller = {"kind": "serial", "port": board.port, "timeout_s": 0.5, "watchdog_s": 5.0}
    return configuration("obis", instrument.port, laser={"interlock": "controller"}, controller=controller)


@pytest.fixture
def wired(board: FirmwareBoard) -> Iterator[BehindTheRelay]:
    instrument = BehindTheRelay(board)
    yield instrument
    instrument.close()


def test_the_relay_is_closed_before_the_laser_is_lit_and_opened_after(
    board: FirmwareBoard, wired: BehindTheRelay
) -> None:
    with Devices(behind_the_relay(board, wired)) as devices:
        assert devices.light() == "laser on"
        assert wired.emits
        # the relay alone: the controller's own output has no power
        assert board.outputs()["laser"] == [1, 0.0]
    assert not wired.on
    assert board.outputs()["laser"][0] == 0


@pytest.mark.parametrize("silent_s", [0.0, 0.6])
def test_an_interlock_that_is_not_wired_as_stated_is_found_before_it_is_lit(
    board: FirmwareBoard, silent_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the board's first status comes late: the laser was lit without a test of the wiring."""
    real, heard_from_s = ControlService.snapshot.fget, [0.0]  # type: ignore[attr-defined]

    def late(service: ControlService) -> ControlSnapshot:
        now: ControlSnapshot = real(service)
        return now if time.monotonic() > heard_from_s[0] else replace(now, status=None, status_time_ns=0)

    monkeypatch.setattr(ControlService, "snapshot", property(late))
    with closing(FakeObis()) as instrument:
        with Devices(behind_the_relay(board, instrument)) as devices:
            heard_from_s[0] = time.monotonic() + silent_s
            with pytest.raises(DeviceError, match="wire it through the relay"):
                devices.light()
        assert instrument.highest_lit == 0.0


@pytest.mark.slow
def test_without_the_relay_sigterm_darkens_it(board: FirmwareBoard, tmp_path: Path) -> None:
    record, said = tmp_path / "out" / "run-1.mcap", tmp_path / "said"
    with closing(FakeObis()) as instrument:
        keys = {
            "laser__kind": '"obis"',
            "laser__port": json.dumps(instrument.port),
            "laser__timeout_s": "2.0",
        }
        words = command(tmp_path / "out", board, **keys, controller__watchdog_s="5.0")
        with running(words, said) as process:

            def recorded() -> bool:
                return instrument.on and record.exists() and record.stat().st_size > 30_000

            until(lambda: process.poll() is not None or recorded())
            assert process.poll() is None, said.read_text()
            process.send_signal(signal.SIGTERM)
            process.wait(ENDED_WITHIN_S)
        assert not instrument.on


def test_nothing_is_lit_without_leave() -> None:
    """The first of the thousand that the benchmark makes."""
    found = run_sequences(40, 30)
    assert found["violations"] == []
    assert found["lit"] > 20
    assert found["acknowledged"] > 5


def test_lasers_of_their_own_go_dark_and_wait_for_a_person(tmp_path: Path) -> None:
    rows = [measured(*trial, tmp_path) for trial in TRIALS]
    assert [row for row in rows if row.violation or row.relit] == []
    # as documented: without the relay nothing darkens a laser whose program was killed
    lit = {row.fault for row in rows if row.dark_s is None}
    assert lit == {"program killed, interlock not wired"}
    assert max(row.dark_s for row in rows if row.dark_s is not None) < 2.5
