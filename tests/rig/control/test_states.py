"""States of laser and controller are values on the way to preflight and desk; their texts decide nothing."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from rig.control import (
    ControlState,
    DevicesNow,
    LaserNow,
    LatchedTrip,
    Light,
    SafetyNow,
    Trip,
    TripCause,
)
from rig.control.protocol import ControllerStatus, Latch
from rig.desk.following import Following
from rig.measure.preflight import frame_checks
from rig.terminal import plain_values


def status(**changed: Any) -> ControllerStatus:
    """Of a controller with its interlock closed and nothing switched on."""
    off = dict.fromkeys(("laser_on", "magnet_on", "starter_on", "clamp_closed", "brake_on"), False)
    known: dict[str, Any] = {**off, "uptime_ms": 1, "interlock_closed": True, "laser_power_w": 0.0}
    return ControllerStatus(**{**known, "errors_waiting": 0, **changed})


def opened(**changed: Any) -> DevicesNow:
    return DevicesNow(None, ControlState.OPEN, status(**changed))


@pytest.mark.parametrize("words", ["interlock closed", "THE INTERLOCK IS OPEN", ""])
def test_preflight_judges_the_interlock_whatever_its_words(
    monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    monkeypatch.setattr(DevicesNow, "text", words)
    assert frame_checks.controller(opened(), wanted=True).ok
    assert not frame_checks.controller(opened(interlock_closed=False), wanted=True).ok
    assert not frame_checks.controller(DevicesNow(None, ControlState.LOST), wanted=True).ok
    assert frame_checks.controller(opened(), wanted=True).measured == words


@pytest.mark.parametrize("laser", [None, LaserNow(Light.ON, power_w=5e-4), LaserNow(Light.INTERLOCK_OPEN)])
def test_a_desk_gets_the_same_values(tmp_path: Path, laser: LaserNow | None) -> None:
    now = DevicesNow(laser, ControlState.OPEN, status(brake_on=True, latch=Latch(3, Trip.WATCHDOG, lit=True)))
    following = Following(tmp_path)
    trip = LatchedTrip(5, TripCause.INTERLOCK, "the interlock of the laser opened", lit=True)
    safety = SafetyNow(trip, trip.text, Light.OFF, 0.1)
    following.news = json.loads(json.dumps(plain_values({"devices": asdict(now), "safety": asdict(safety)})))
    assert following.devices == now
    assert following.safety == safety
    following.news = {}
    assert (following.devices, following.safety) == (DevicesNow(), SafetyNow())


def test_what_people_read_of_them() -> None:
    assert LaserNow(Light.ON, set_w=5e-4).text == "on, 0.5 mW"
    assert LaserNow(Light.ON, power_w=4.9937e-4, current_a=0.05).text == "on, 0.499 mW, 50 mA"
    assert LaserNow(Light.CONTROLLER_SILENT).text == "the controller does not answer"
    assert DevicesNow(LaserNow(Light.INTERLOCK_OPEN)).text == "laser off, its interlock is open"
    assert DevicesNow(None, ControlState.LOST).text == "lost"
    lit = DevicesNow(LaserNow(Light.ON), ControlState.OPEN, status(magnet_on=True, interlock_closed=False))
    assert lit.text == "laser on, magnet, INTERLOCK OPEN"
