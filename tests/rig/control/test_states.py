"""States of laser and controller are values on the way to preflight and desk; their texts decide nothing."""

import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rig.control import (
    ControlState,
    LaserReport,
    LaserState,
    LatchedTrip,
    Light,
    Loop,
    SafetyNow,
    Trip,
    TripCause,
)
from rig.control.laser_service import LaserSnapshot
from rig.control.protocol import ControllerStatus, Latch
from rig.control.service import ControlSnapshot
from rig.desk.follower import RigFollower
from rig.devices.lit_devices import LitDevices
from rig.measure.preflight import frame_checks
from rig.settings import validate_configuration
from rig.terminal import plain_values


def status(**changed: Any) -> ControllerStatus:
    """Of a controller with its interlock closed and nothing switched on."""
    off = dict.fromkeys(("laser_on", "magnet_on", "starter_on", "clamp_closed", "brake_on"), False)
    known: dict[str, Any] = {**off, "uptime_ms": 1, "interlock_closed": True, "laser_power_w": 0.0}
    return ControllerStatus(**{**known, "errors_waiting": 0, **changed})


def opened(**changed: Any) -> SafetyNow:
    return SafetyNow(controller=ControlState.OPEN, status=status(**changed))


def test_preflight_judges_the_interlock_whatever_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SafetyNow, "devices_text", "THE INTERLOCK IS OPEN")
    closed = frame_checks.controller(opened(), configured=True)
    assert (closed.ok, closed.measured) == (True, "THE INTERLOCK IS OPEN")
    for now in (opened(interlock_closed=False), SafetyNow(controller=ControlState.LOST)):
        assert not frame_checks.controller(now, configured=True).ok


@pytest.mark.parametrize(
    "laser", [None, LaserReport(Light.ON, power_w=5e-4), LaserReport(Light.INTERLOCK_OPEN)]
)
def test_a_desk_gets_the_same_values(tmp_path: Path, laser: LaserReport | None) -> None:
    follower = RigFollower(tmp_path)
    trip = LatchedTrip(5, TripCause.INTERLOCK, "the interlock of the laser opened", lit=True)
    now = status(brake_on=True, latch=Latch(3, Trip.WATCHDOG, lit=True))
    safety = SafetyNow(trip, trip.text, Light.OFF, 0.1, laser=laser, controller=ControlState.OPEN, status=now)
    follower.news = json.loads(json.dumps(plain_values({"safety": asdict(safety)})))
    assert follower.safety == safety
    follower.news = {}
    assert follower.safety == SafetyNow()


def test_what_people_read_of_them() -> None:
    assert LaserReport(Light.ON, set_w=5e-4).text == "on, 0.5 mW"
    assert LaserReport(Light.ON, power_w=4.9937e-4, current_a=0.05).text == "on, 0.499 mW, 50 mA"
    assert LaserReport(Light.CONTROLLER_SILENT).text == "the controller does not answer"
    assert (
        SafetyNow(laser=LaserReport(Light.INTERLOCK_OPEN)).devices_text == "laser off, its interlock is open"
    )
    assert SafetyNow(controller=ControlState.LOST).devices_text == "lost"
    lit = replace(opened(magnet_on=True, interlock_closed=False), laser=LaserReport(Light.ON))
    assert lit.devices_text == "laser on, magnet, INTERLOCK OPEN"


@pytest.mark.parametrize(
    ("board_closed", "laser_age_s", "loop"),
    [
        (True, 0.1, Loop.CLOSED),
        (False, 0.1, Loop.OPEN),
        (True, 9.0, Loop.UNKNOWN),
        # a laser that is being switched on reports nothing meanwhile
        (False, 9.0, Loop.OPEN),
    ],
)
def test_an_open_loop_is_open_whatever_is_known_of_the_other(
    board_closed: bool, laser_age_s: float, loop: Loop
) -> None:
    tree = {
        "camera": {"driver": "simulated"},
        "controller": {"kind": "serial", "port": "x"},
        "laser": {"kind": "cobolt", "port": "y"},
    }
    devices: Any = LitDevices(validate_configuration(tree, "test"), None, "test")
    board, now_ns = status(interlock_closed=board_closed), time.monotonic_ns()
    laser_ns = now_ns - round(1e9 * laser_age_s)
    devices.control = SimpleNamespace(snapshot=ControlSnapshot(ControlState.OPEN, None, board, now_ns))
    devices.laser = SimpleNamespace(snapshot=LaserSnapshot(LaserState(False, True), laser_ns))
    assert devices.safety().interlock is loop
